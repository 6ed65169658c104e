"""The parameters that all formats of OpenCV's fisheye model share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from classical.camera.kannala_brandt import KannalaBrandt


def fisheye_parameters(camera: KannalaBrandt) -> tuple[list[float], list[float]]:
    """The lens as [fx, fy, cx, cy] and [k1, k2, k3, k4] of OpenCV, as plain floats."""
    K, D = camera.to_opencv()
    return [float(K[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2))], D.tolist()


def fisheye_camera(
    parameters: Sequence[float], coefficients: Sequence[float], size: tuple[int, int]
) -> KannalaBrandt:
    """The lens of [fx, fy, cx, cy] and [k1, k2, k3, k4] of OpenCV.

    Raises:
        ValueError: If the focal lengths are not positive or the numbers too large.
    """
    fx, fy, cx, cy = parameters
    if not (fx > 0 and fy > 0):
        raise ValueError(f"expected positive focal lengths, got {fx:g} and {fy:g}")
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    with np.errstate(all="ignore"):  # what overflows is not finite, and refused for that
        return KannalaBrandt.from_opencv(K, np.array(coefficients), *size)

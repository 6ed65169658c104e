"""What `rectify` and `calibrate` give back."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Shaped

from classical.camera import KannalaBrandt, Pinhole
from classical.fit import FittedCurve

Status = Literal["ok", "degraded", "failed"]


class RectificationError(RuntimeError):
    """The picture does not tell its lens; the message says why."""


@dataclass(frozen=True, eq=False)
class Quality:
    """How far a camera can be trusted.

    Attributes:
        rms_px: Root mean square distance of the inlier curves from pictures of straight lines, in
            pixels of the input; NaN without curves.
        n_curves: Curves that were found.
        n_inliers: Curves that the fit took for straight lines.
        covariance: Of (k1..k5, m_u, m_v, u0, v0), shape (9, 9).
        predicted_error_px: Expected error of rectified positions in pixels of a 320 pixel wide
            frame; NaN where it is not known.
        scale_source: What fixed the focal length, which straight lines leave open: "prior",
            "vanishing points", or empty where the method does not say.
        scale_deviation: Standard deviation of the logarithm of the focal length; NaN where it is
            not known.
    """

    rms_px: float = math.nan
    n_curves: int = 0
    n_inliers: int = 0
    covariance: Float[np.ndarray, "9 9"] = field(default_factory=lambda: np.zeros((9, 9)))
    predicted_error_px: float = math.nan
    scale_source: str = ""
    scale_deviation: float = math.nan


@dataclass(frozen=True, eq=False)
class Calibration:
    """What is known about the one lens of one or many pictures.

    Attributes:
        camera: The lens, or None where it cannot be told or nothing was estimated.
        curves: The curves of each picture, with their residuals.
        quality: How far to trust the camera.
        status: `ok`, `degraded` (use with care) or `failed`.
        reason: Why, in words.
        heatmaps: Where line perception sees lines in each picture, in [0, 1] and of any size; empty
            where the method has none.
    """

    camera: KannalaBrandt | None
    curves: tuple[tuple[FittedCurve, ...], ...]
    quality: Quality
    status: Status
    reason: str
    heatmaps: tuple[Float[np.ndarray, "_ _"], ...] = ()


@dataclass(frozen=True, eq=False)
class Rectification:
    """A straight picture and where it came from.

    Attributes:
        image: The rectified picture, dtype and channels of the input; the input itself if nothing
            was done.
        valid: True where `image` shows a pixel of the input, shape (height, width).
        camera: The fisheye camera of the input, or None.
        target: The pinhole camera of `image`, or None.
        curves: Polylines in the input with `residual_px` and `inlier`.
        quality: How far to trust the camera.
        status: `ok`, `degraded` (use with care) or `failed`.
        reason: Why, in words.
        heatmap: Where line perception sees lines in the input, in [0, 1] and of any size, or None
            where the method has none.
    """

    image: Shaped[np.ndarray, "..."]
    valid: Bool[np.ndarray, "height width"]
    camera: KannalaBrandt | None
    target: Pinhole | None
    curves: tuple[FittedCurve, ...]
    quality: Quality
    status: Status
    reason: str
    heatmap: Float[np.ndarray, "_ _"] | None = None

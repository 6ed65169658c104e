"""What a fit gives back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from classical.camera import KannalaBrandt

Status = Literal["ok", "degraded", "failed"]


@dataclass(frozen=True, eq=False)
class FittedCurve:
    """A curve with what the lens leaves of its bend.

    Attributes:
        points: Pixels in order along the curve, shape (n, 2).
        residuals: Signed distances to the nearest picture of a straight line, pixels, shape (n,).
        residual_px: Their root mean square, pixels.
        inlier: Whether the fit took the curve for the picture of a straight line.
    """

    points: Float[np.ndarray, "n 2"]
    residuals: Float[np.ndarray, " n"]
    residual_px: float
    inlier: bool


@dataclass(frozen=True, eq=False)
class LensFit:
    """A lens, how well it makes the curves straight, and how far to trust it.

    Attributes:
        camera: The lens in the gauge m_u = width / 2, or None where nothing could be estimated.
        covariance: Of (k1..k5, m_u, m_v, u0, v0), shape (9, 9); zero without a camera.
        status: `ok`, `degraded` (use with care) or `failed`.
        reason: Why, in words.
        curves: The curves of each picture.
        rms_px: Root mean square residual of all inlier curves, pixels; NaN without any.
        predicted_error_px: Expected error of rectified positions after the best similarity, in
            pixels of a 320 pixel wide frame with f = 160 px, over angles up to 60°; NaN without a
            camera.
        scale_source: What fixed the absolute scale, which straightness leaves open: "prior",
            "vanishing points", or the source of an observation.
        scale_deviation: Standard deviation of the logarithm of the focal length, NaN without a
            camera.
    """

    camera: KannalaBrandt | None
    covariance: Float[np.ndarray, "9 9"]
    status: Status
    reason: str
    curves: tuple[tuple[FittedCurve, ...], ...]
    rms_px: float
    predicted_error_px: float
    scale_source: str = "prior"
    scale_deviation: float = float("nan")

    @property
    def n_inliers(self) -> int:
        """Curves that the fit took for straight lines, in all pictures."""
        return sum(curve.inlier for picture in self.curves for curve in picture)

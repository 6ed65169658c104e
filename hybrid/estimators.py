"""The estimators that need no network."""

from __future__ import annotations

from collections.abc import Sequence

from jaxtyping import UInt8
from numpy import ndarray

from classical.fit import FitConfig, LensFit, VanishingConfig, fit_lens
from classical.lines import curves_from_image, find_image_circle
from hybrid.config import RectifyConfig
from hybrid.result import Calibration, Quality

_MIN_SIDE = 32  # pixels; a smaller picture has no room for a line


class IdentityEstimator:
    """Leaves every picture alone; the row to compare with."""

    def __init__(self, config: RectifyConfig) -> None:
        self._config = config

    def __call__(self, pictures: Sequence[UInt8[ndarray, "h w 3"]]) -> Calibration:
        """No camera and no curves."""
        return Calibration(None, tuple(() for _ in pictures), Quality(), "ok", "left as it is")


class ClassicalEstimator:
    """Edges of the pictures, joined into curves and made straight by one fit."""

    def __init__(self, config: RectifyConfig) -> None:
        self._config = config

    def __call__(self, pictures: Sequence[UInt8[ndarray, "h w 3"]]) -> Calibration:
        """One lens for all pictures."""
        height, width = pictures[0].shape[:2]
        if min(height, width) < _MIN_SIDE:
            reason = f"a picture of {width}x{height} pixels is too small to show lines"
            return Calibration(None, tuple(() for _ in pictures), Quality(), "failed", reason)
        curves = [curves_from_image(picture) for picture in pictures]
        settings = FitConfig(vanishing=VanishingConfig(seed=self._config.seed))
        fit = fit_lens(curves, width, height, config=settings)
        return estimate_from_fit(fit)


def estimate_from_fit(fit: LensFit) -> Calibration:
    """What a straightness fit says, in the terms of this package."""
    quality = Quality(
        rms_px=fit.rms_px,
        n_curves=sum(len(curves) for curves in fit.curves),
        n_inliers=fit.n_inliers,
        covariance=fit.covariance,
        predicted_error_px=fit.predicted_error_px,
        scale_source=fit.scale_source if fit.camera is not None else "",
        scale_deviation=fit.scale_deviation,
    )
    camera = None if fit.status == "failed" else fit.camera
    return Calibration(camera, fit.curves, quality, fit.status, fit.reason)

"""The estimators that need no network."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from classical.fit import (
    FitConfig,
    LensFit,
    Observation,
    ParallelsConfig,
    VanishingConfig,
    fit_lens,
    of_field,
    of_focal,
)
from classical.lines import ImageCircle, curves_from_image, find_image_circle, find_rim
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
        failure = too_small(pictures)
        if failure is not None:
            return failure
        height, width = pictures[0].shape[:2]
        circles = [find_image_circle(picture) for picture in pictures]
        seed = self._config.seed
        fit = fit_lens(
            [curves_from_image(picture) for picture in pictures],
            width,
            height,
            config=FitConfig(
                parallels=ParallelsConfig(seed=seed), vanishing=VanishingConfig(seed=seed)
            ),
            circles=circles,
            observations=given_by_user(self._config, circles, width),
            rims=[find_rim(picture) for picture in pictures],
            pictures=pictures,
        )
        return estimate_from_fit(fit)


def too_small(pictures: Sequence[UInt8[ndarray, "h w 3"]]) -> Calibration | None:
    """The answer where pictures have no room for a line, else None."""
    shorter = min(pictures[0].shape[:2])
    if shorter >= _MIN_SIDE:
        return None
    reason = f"a picture with a side of {shorter} pixels is too small to show lines"
    return Calibration(None, tuple(() for _ in pictures), Quality(), "failed", reason)


def given_by_user(
    config: RectifyConfig, circles: Sequence[ImageCircle | None], width: int
) -> list[Observation]:
    """What the user knows of the lens."""
    known = []
    if config.camera_focal is not None:
        known.append(of_focal(config.camera_focal, width))
    if config.camera_fov is not None:
        field = np.radians(config.camera_fov)
        known.append(of_field(field, width / 2, width, "the field of view given"))
    if config.circle_fov is not None:
        radii = [circle.radius for circle in circles if circle is not None]
        if not radii:
            raise ValueError("Expected an image circle for circle_fov, found none in the pictures.")
        field = np.radians(config.circle_fov)
        known.append(of_field(field, float(np.median(radii)), width, "the image circle's field"))
    return known


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

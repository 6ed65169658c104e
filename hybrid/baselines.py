"""The published methods as estimators."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from classical.baselines import aleman_flores, bukhari
from classical.camera import KannalaBrandt, nearest_kannala_brandt
from classical.fit import FittedCurve, fitted_curves
from classical.lines import Curve
from hybrid.config import RectifyConfig
from hybrid.result import Calibration, Quality

_CURVE_SIGMA = 1.0  # pixels; the baselines say nothing of it
_Estimate = Callable[[np.ndarray], "aleman_flores.AlemanFloresResult | bukhari.BukhariResult"]


def _variant(config: RectifyConfig) -> Literal["2014", "2016"]:
    return "2016" if config.variant == "2016" else "2014"


class AlemanFloresEstimator:
    """Alemán-Flores et al., IPOL 2014 or 2016 (`RectifyConfig.variant`)."""

    def __init__(self, config: RectifyConfig) -> None:
        settings = aleman_flores.AlemanFloresConfig.for_variant(_variant(config))
        self._estimate = partial(aleman_flores.estimate, config=settings)

    def __call__(self, pictures: Sequence[UInt8[ndarray, "h w 3"]]) -> Calibration:
        """The picture of middling distortion speaks for all of one lens."""
        return _estimated(self._estimate, pictures)


class BukhariEstimator:
    """Bukhari & Dailey, JMIV 2013, with a free centre."""

    def __init__(self, config: RectifyConfig) -> None:
        settings = bukhari.BukhariConfig(seed=config.seed)
        self._estimate = partial(bukhari.estimate, config=settings)

    def __call__(self, pictures: Sequence[UInt8[ndarray, "h w 3"]]) -> Calibration:
        """The picture of middling distortion speaks for all of one lens."""
        return _estimated(self._estimate, pictures)


def _estimated(estimate: _Estimate, pictures: Sequence[np.ndarray]) -> Calibration:
    results = [estimate(picture) for picture in pictures]
    curves = [_curves(result.curves()) for result in results]
    cameras, reasons = [], [result.reason for result in results if result.model is None]
    for result in results:
        if result.model is None:
            continue
        try:
            cameras.append(nearest_kannala_brandt(result.model))
        except ValueError as error:
            reasons.append(str(error))
    if not cameras:
        nothing: tuple[tuple[FittedCurve, ...], ...] = tuple(() for _ in pictures)
        return Calibration(None, nothing, Quality(), "failed", reasons[0])
    camera = _middling(cameras)
    fitted = tuple(fitted_curves(picture, camera) for picture in curves)
    inliers = [curve for picture in fitted for curve in picture if curve.inlier]
    squares = [np.mean(curve.residuals**2) for curve in inliers]
    quality = Quality(
        rms_px=float(np.sqrt(np.mean(squares))) if inliers else float("nan"),
        n_curves=sum(len(picture) for picture in fitted),
        n_inliers=len(inliers),
    )
    reason = "this method finds the shape of the distortion, no focal length and no expected error"
    return Calibration(camera, fitted, quality, "degraded", reason)


def _curves(polylines: Sequence[np.ndarray]) -> list[Curve]:
    return [Curve(points, _CURVE_SIGMA, 1.0) for points in polylines if len(points) >= 2]


def _middling(cameras: list[KannalaBrandt]) -> KannalaBrandt:
    """The camera of median angle at half the picture's width from its centre."""
    angles = [float(camera.theta(np.array([0.5]))[0][0]) for camera in cameras]
    return cameras[int(np.argsort(angles)[(len(angles) - 1) // 2])]

"""The networks as estimators; importing this module loads torch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from classical.camera import KannalaBrandt, nearest_kannala_brandt
from classical.fit import (
    FALLS_SHORT,
    LARGEST_ERROR,
    TAIL,
    LensPrior,
    fitted_curves,
    fused,
    generic_prior,
    predicted_error,
    straight_share,
    within_reach,
)
from classical.lines import curves_from_image, find_rim
from hybrid.config import RectifyConfig
from hybrid.result import Calibration, Quality
from learned.predictor import LensPrediction, Predictor, RongPredictor

_LEAST_STRAIGHT = 0.8  # share of the curves' length; a lens that is right straightens most of them


class LearnedEstimator:
    """LaRecNet without lines: its lens, fused over pictures of one lens.

    What holds for lenses in general is not heard: the network has learned more of them than that,
    and of lenses that bend next to nothing, too.
    """

    def __init__(self, config: RectifyConfig) -> None:
        self._predictor = Predictor.from_weights(config.weights)

    def __call__(self, pictures: Sequence[UInt8[ndarray, "h w 3"]]) -> Calibration:
        """One lens for all pictures, with the curves it leaves for a check."""
        predictions = [self._predictor.lens(picture) for picture in pictures]
        belief = network_belief(predictions)
        if belief is None:
            nothing = tuple(() for _ in pictures)
            return Calibration(None, nothing, Quality(), "failed", "the network gave no lens")
        height, width = pictures[0].shape[:2]
        rim = np.concatenate([find_rim(picture) for picture in pictures])
        estimate = belief.decode(np.zeros(8), width, height)
        camera, reaches = within_reach(estimate, belief.covariance, rim)
        curves = tuple(fitted_curves(curves_from_image(p), camera) for p in pictures)
        inliers = [curve for picture in curves for curve in picture if curve.inlier]
        error = predicted_error(camera, belief.covariance)
        quality = Quality(
            rms_px=float(np.sqrt(np.mean([c.residual_px**2 for c in inliers])))
            if inliers
            else float("nan"),
            n_curves=sum(len(picture) for picture in curves),
            n_inliers=len(inliers),
            covariance=belief.covariance,
            predicted_error_px=error,
        )
        heatmaps = tuple(p.lines.lineness for p in predictions if p.lines is not None)
        share = straight_share(curves)
        if TAIL * error > LARGEST_ERROR:
            reason = f"the network is unsure: the error may be {TAIL * error:.1f} px"
        elif not reaches:
            reason = FALLS_SHORT
        elif share < _LEAST_STRAIGHT:
            reason = f"the network is sure, but straightens {share:.0%} of the curves' length only"
        else:
            reason = "the network is sure, and curves become straight"
            return Calibration(camera, curves, quality, "ok", reason, heatmaps)
        return Calibration(camera, curves, quality, "degraded", reason, heatmaps)


class RongEstimator:
    """Rong et al., ACCV 2016: the division model as a class of a network."""

    def __init__(self, config: RectifyConfig) -> None:
        self._predictor = RongPredictor.from_weights(config.weights)

    def __call__(self, pictures: Sequence[UInt8[ndarray, "h w 3"]]) -> Calibration:
        """The picture of middling λ speaks for all of one lens."""
        models = [self._predictor.lens(picture) for picture in pictures]
        middle = sorted(models, key=lambda model: model.lambda_)[(len(models) - 1) // 2]
        nothing = tuple(() for _ in pictures)
        try:
            camera: KannalaBrandt = nearest_kannala_brandt(middle)
        except ValueError as error:
            return Calibration(None, nothing, Quality(), "failed", str(error))
        reason = "this method finds the shape of the distortion, no focal length"
        return Calibration(camera, nothing, Quality(), "degraded", reason)


def network_belief(predictions: Sequence[LensPrediction]) -> LensPrior | None:
    """What the network believes of the one lens of all pictures, or None without an estimate.

    Weights without a covariance head (the paper's network) are believed as far as lenses in general
    differ from one another.
    """
    beliefs = [
        LensPrior(camera.to_vector(), _spread(camera, prediction))
        for prediction in predictions
        if (camera := prediction.camera) is not None
    ]
    return fused(beliefs) if beliefs else None


def _spread(camera: KannalaBrandt, prediction: LensPrediction) -> Float[ndarray, "9 9"]:
    if prediction.covariance is not None:
        return prediction.covariance
    return generic_prior(float(camera.k[0]), camera.width, camera.height).covariance

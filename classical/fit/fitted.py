"""Curves as one lens leaves them: residuals of each, and which are straight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from classical.camera import KannalaBrandt
from classical.fit.result import FittedCurve
from classical.fit.samples import CurveSamples
from classical.fit.straightness import straightness
from classical.lines import Curve
from classical.lines.curve import REFERENCE_WIDTH

STRAIGHT_PX = 1.0  # RMS residual up to which a curve is straight, in a picture 1280 wide


def fitted_curves(
    curves: Sequence[Curve], camera: KannalaBrandt, *, tolerance: float | None = None
) -> tuple[FittedCurve, ...]:
    """Measure how straight a lens makes the curves of one picture.

    Args:
        curves: Curves in pixels of the camera's picture.
        camera: The lens.
        tolerance: RMS residual up to which a curve counts as straight, pixels; None means
            `STRAIGHT_PX` for the picture's width.
    """
    if not curves:
        return ()
    if tolerance is None:
        tolerance = STRAIGHT_PX * camera.width / REFERENCE_WIDTH
    counts = np.array([len(curve.points) for curve in curves])
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    points = np.concatenate([curve.points for curve in curves])
    samples = CurveSamples(points, starts, np.ones(len(points)))
    result = straightness(camera, samples)
    rms = samples.curve_rms(result.residuals)
    reached = samples.curve_sums(~result.reached) == 0
    parts = np.split(result.residuals, starts[1:])
    return tuple(
        FittedCurve(curve.points, part, float(value), bool(inside and value <= tolerance))
        for curve, part, value, inside in zip(curves, parts, rms, reached, strict=True)
    )

"""The plumb-line fit: from curves in one or many pictures to the lens that makes them straight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float, UInt8
from threadpoolctl import ThreadpoolController

from classical.camera import KannalaBrandt
from classical.fit.calibrated import calibrated
from classical.fit.candidate import (
    STRAIGHT,
    UNTOLD,
    Candidate,
    is_better_alone,
    is_open,
    to_rim,
    unless_straight,
    with_scale,
)
from classical.fit.config import FitConfig
from classical.fit.estimate import Estimate
from classical.fit.fitted import fitted_curves
from classical.fit.likelihood import curve_costs
from classical.fit.observations import Observation, of_circles
from classical.fit.parallels import ParallelsConfig
from classical.fit.quality import judge, predicted_error
from classical.fit.result import LensFit
from classical.fit.rounds import Known, Settled, settle
from classical.fit.samples import CurveSamples
from classical.fit.scale import held_scale, scale_source, scale_variance
from classical.fit.search import search
from classical.fit.straightness import straightness
from classical.lines import Curve, ImageCircle, join_curves, trace_further

# one thread: matrices of eight columns gain nothing from two, and the answer keeps its bits
_CONTROLLER = ThreadpoolController()
_CLEARLY = 3.5  # deviations off 1 at which an image circle proves that pixels are not square


def fit_lens(
    curve_sets: Sequence[Sequence[Curve]],
    width: int,
    height: int,
    *,
    config: FitConfig = FitConfig(),
    circles: Sequence[ImageCircle | None] = (),
    observations: Sequence[Observation] = (),
    estimate: Estimate | None = None,
    starts: Sequence[KannalaBrandt] = (),
    rims: Sequence[Float[np.ndarray, "_ 2"]] = (),
    pictures: Sequence[UInt8[np.ndarray, "..."]] = (),
) -> LensFit:
    """Find the lens under which the curves of all pictures are straight.

    Args:
        curve_sets: The curves of each picture; all pictures have one size and one lens.
        width: Picture width in pixels.
        height: Picture height in pixels.
        config: Tolerances and effort.
        circles: The image circle of each picture, None where it shows none.
        observations: What else is known of the lens; see `classical.fit.observations`. What holds
            for lenses in general (`generic_prior`) is always believed.
        estimate: Another estimate of the lens, which is believed as far as the curves agree with
            it, and begun with.
        starts: Lenses to begin with beside those of the global search.
        rims: The outermost pixels that each picture shows (`find_rim`), which the lens reaches.
        pictures: The pictures themselves, in which lines are followed beyond the ends of their
            curves; without them curves stay as long as they are.

    Returns:
        The fit. Straight lines stay straight when the rectified plane is scaled, so the scale
        comes from what was observed, from orthogonal vanishing points where a scene has them, or
        else from the prior.

    Raises:
        ValueError: If pictures are given, but not one for each set of curves.
    """
    if pictures and len(pictures) != len(curve_sets):
        raise ValueError(
            f"Expected a picture for each of {len(curve_sets)} sets of curves, got {len(pictures)}."
        )
    with _CONTROLLER.limit(limits=1, user_api="blas"):
        known = replace(_known(circles, observations, width), estimate=estimate)
        if estimate is not None:
            starts = [*starts, estimate.lens(width, height)]
        rim = np.concatenate([np.zeros((0, 2)), *rims])
        fit = partial(_fit, curve_sets, pictures, width, height, config=config, rim=rim)
        best, joined = fit(known=known, starts=starts)
        if best is None:
            return _failure(curve_sets, "no curve was found that could be a straight line")
        if known.has_estimate and is_open(best, config):
            alone, rejoined = fit(known=known.without_estimates, starts=())
            if alone is not None and is_better_alone(alone, best, config):
                best, joined = alone, rejoined
        return _report(best, joined, config=config)


def _known(
    circles: Sequence[ImageCircle | None], observations: Sequence[Observation], width: int
) -> Known:
    circle = of_circles(circles, width)
    if circle is None:
        return Known(observations)
    off = (float(circle.value[2]) / (width / 2) - 1) ** 2
    spread = float(circle.covariance[2, 2]) / (width / 2) ** 2
    return Known([circle, *observations], off > _CLEARLY**2 * spread)


def _fit(
    curve_sets: Sequence[Sequence[Curve]],
    pictures: Sequence[UInt8[np.ndarray, "..."]],
    width: int,
    height: int,
    *,
    config: FitConfig,
    known: Known,
    starts: Sequence[KannalaBrandt],
    rim: Float[np.ndarray, "n 2"],
) -> tuple[Candidate | None, Sequence[Sequence[Curve]]]:
    """The lens, None without any curve, and the curves as they were joined under it."""
    if not any(curve_sets):
        return None, curve_sets
    samples = config.samples(curve_sets, width)
    starts = [
        *(start.normalized() for start in starts),
        *search(samples, width, height, config=config.search),
    ]
    best = _best(samples, starts, known, config)
    best, joined = _joined(best, curve_sets, known, config)
    known = _weighed(best, joined, known, config)
    if pictures and config.tracings:
        lens = _candidate(best, curve_sets, joined, known, config).camera
        best, joined = _followed(best, lens, joined, pictures, known, config)
        curve_sets = joined
    best = _with_parallels(best, joined, known, config)
    candidate = _candidate(best, curve_sets, joined, known, config)
    if config.vanishing is not None:
        candidate = with_scale(candidate, joined, config)
    return to_rim(candidate, rim), joined


def _joined(
    best: Settled, curve_sets: Sequence[Sequence[Curve]], known: Known, config: FitConfig
) -> tuple[Settled, Sequence[Sequence[Curve]]]:
    """Settle again with pieces of one line joined."""
    joined = curve_sets
    for _ in range(config.joinings):
        joined = [join_curves(curves, best.camera) for curves in curve_sets]
        best = _best(config.samples(joined, best.camera.width), [best.camera], known, config.last)
    return best, joined


def _weighed(
    best: Settled, curve_sets: Sequence[Sequence[Curve]], known: Known, config: FitConfig
) -> Known:
    """The estimate believed as far as the curves agree with it."""
    if known.estimate is None:
        return known
    width, height = best.camera.width, best.camera.height
    fitted, estimated = curve_costs(
        best.camera,
        [known.estimate.lens(width, height)],
        config.samples(curve_sets, width),
        tolerance=config.tolerance(width),
        bend=config.bend,
    )
    return replace(known, loss=estimated - fitted)


def _followed(
    best: Settled,
    candidate: KannalaBrandt,
    curve_sets: Sequence[Sequence[Curve]],
    pictures: Sequence[UInt8[np.ndarray, "..."]],
    known: Known,
    config: FitConfig,
) -> tuple[Settled, Sequence[Sequence[Curve]]]:
    """Settle again with lines followed beyond the ends of their curves.

    They are followed under `candidate`, first; where that is a straight lens in place of the best
    one, the two compete on what is found.
    """
    starts = [candidate] if candidate is best.camera else [best.camera, candidate]
    for _ in range(config.tracings):
        traced = [
            trace_further(curves, starts[-1], picture, config=config.tracing)
            for curves, picture in zip(curve_sets, pictures, strict=True)
        ]
        curve_sets = [join_curves(curves, starts[-1]) for curves in traced]
        samples = config.samples(curve_sets, candidate.width)
        best = _best(samples, starts, known, config if len(starts) > 1 else config.last)
        starts = [best.camera]
    return best, curve_sets


def _candidate(
    best: Settled,
    curve_sets: Sequence[Sequence[Curve]],
    joined: Sequence[Sequence[Curve]],
    known: Known,
    config: FitConfig,
) -> Candidate:
    """What is to be made of a lens, but for its scale."""
    candidate = Candidate(best.camera, best.covariance, scale_source(best, known))
    if config.perspective is None:
        return candidate
    return unless_straight(candidate, curve_sets, joined, known, config)


def _best(
    samples: CurveSamples, starts: Sequence[KannalaBrandt], known: Known, config: FitConfig
) -> Settled:
    """Let the starts compete on the longest curves only; the winner settles on all of them."""
    if len(starts) > 1:
        few = samples.coarse(curves=config.search.curves, most=config.search.samples)
        short = replace(config, tolerances=config.tolerances[:2])
        trials = [_settled(few, lens, known, short).camera for lens in starts]
        starts = [min(trials, key=lambda lens: _final_cost(samples, lens, known, config))]
        config = replace(config, tolerances=config.tolerances[2:])
    return _settled(samples, starts[0], known, config)


def _settled(
    samples: CurveSamples,
    camera: KannalaBrandt,
    known: Known,
    config: FitConfig,
    parallels: ParallelsConfig | None = None,
) -> Settled:
    return settle(
        samples,
        camera,
        known,
        tolerances=config.tolerances,
        bend=config.bend,
        solver=config.solver,
        parallels=parallels,
    )


def _with_parallels(
    best: Settled, curve_sets: Sequence[Sequence[Curve]], known: Known, config: FitConfig
) -> Settled:
    """Settle once more with directions beside the bends.

    They tell no scale, so that is held; and how far lines of one direction err together is not
    known, so the lens is believed no more than by its bends.
    """
    if config.parallels is None:
        return best
    samples = config.samples(curve_sets, best.camera.width, most=config.parallels.max_curves)
    held = replace(known, observations=[*known.observations, held_scale(best.camera)])
    rounds = replace(config, tolerances=config.tolerances[-1:] * len(config.parallels.tolerances))
    second = _settled(samples, best.camera, held, rounds, config.parallels)
    return replace(best, camera=second.camera)


def _final_cost(
    samples: CurveSamples, camera: KannalaBrandt, known: Known, config: FitConfig
) -> float:
    """Length-weighted share of bent curves, by which starts compete; the prior breaks ties."""
    result = straightness(camera, samples)
    squared = (samples.curve_rms(result.residuals) / config.tolerance(camera.width)) ** 2
    lengths = samples.lengths
    z = known.belief(camera).encode(camera)
    return float((lengths * squared / (1 + squared)).sum() / lengths.sum() + 0.002 * (z @ z))


def _report(
    best: Candidate,
    curve_sets: Sequence[Sequence[Curve]],
    *,
    config: FitConfig,
) -> LensFit:
    """All curves under the final lens, and how far to trust it."""
    tolerance = config.tolerance(best.camera.width)
    curves = tuple(
        fitted_curves(picture, best.camera, tolerance=tolerance) for picture in curve_sets
    )
    inliers = [curve for picture in curves for curve in picture if curve.inlier]
    every = np.concatenate([curve.residuals for curve in inliers]) if inliers else np.array([])
    rms = float(np.sqrt((every**2).mean())) if inliers else float("nan")
    error, covariance = best.error, best.covariance
    if error is None:
        covariance = calibrated(best.camera, covariance)
        error = predicted_error(best.camera, covariance)
    status, reason = judge(curves, best.camera, error)
    if best.note and (status == "ok" or (status == "degraded" and best.note == UNTOLD)):
        status = "ok" if best.note == STRAIGHT else "degraded"
        reason = best.note
    deviation = float(np.sqrt(scale_variance(best.camera, covariance)))
    return LensFit(
        best.camera,
        covariance,
        status,
        reason,
        curves,
        rms,
        error,
        best.scale_source,
        deviation,
    )


def _failure(curve_sets: Sequence[Sequence[Curve]], reason: str) -> LensFit:
    nothing = tuple(() for _ in curve_sets)
    nan = float("nan")
    return LensFit(None, np.zeros((9, 9)), "failed", reason, nothing, nan, nan)

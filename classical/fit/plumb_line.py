"""The plumb-line fit: from curves in one or many pictures to the lens that makes them straight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Float
from threadpoolctl import ThreadpoolController

from classical.camera import KannalaBrandt
from classical.fit.bends import BendConfig
from classical.fit.calibrated import calibrated
from classical.fit.fitted import STRAIGHT_PX, fitted_curves
from classical.fit.observations import Observation, observed, of_circles
from classical.fit.parallels import ParallelsConfig
from classical.fit.perspective import (
    Perspective,
    PerspectiveConfig,
    bend_of,
    perspective_instead,
)
from classical.fit.prior import LensPrior
from classical.fit.quality import TAIL, disagreement, judge, predicted_error
from classical.fit.reach import reaching
from classical.fit.result import LensFit
from classical.fit.rounds import REFERENCE_WIDTH, Known, Settled, settle
from classical.fit.samples import CurveSamples, sample_curves
from classical.fit.scale import (
    fused_scale,
    held_scale,
    scale_source,
    scale_tangent,
    scale_variance,
    vanishing_scale,
)
from classical.fit.search import SearchConfig, search
from classical.fit.solve import SolverConfig
from classical.fit.straightness import straightness
from classical.fit.vanishing import VanishingConfig
from classical.lines import Curve, ImageCircle, join_curves

# one thread: matrices of eight columns gain nothing from two, and the answer keeps its bits
_CONTROLLER = ThreadpoolController()
_STRAIGHT = "the lines are straight already"
_PERHAPS_STRAIGHT = "the lines look straight already, but they could not tell a fisheye"
_UNTOLD = "the lines could not tell a fisheye from a straight picture; the lens is a guess"
_SHOWN = np.radians(75.0)  # no frame takes in more by itself
_FALLS_SHORT = "the lens found does not reach the rim of the picture"
_OPEN_SCALE = 0.5  # deviation of log focal length that straight lines leave to a straight picture
_CLEARLY = 3.5  # deviations off 1 at which an image circle proves that pixels are not square


@dataclass(frozen=True)
class FitConfig:
    """The plumb-line fit; lengths in pixels of a picture 1280 wide.

    Attributes:
        bend: How far straight lines look bent.
        tolerances: RMS residual at which a curve has lost most of its weight, one per round.
        inlier_tolerance: RMS residual up to which a curve is called straight.
        spacing: Distance between samples on a curve.
        max_curves: Longest curves used in each picture.
        joinings: How often pieces of one line are joined under the lens and the fit repeated.
        perspective: When a picture is taken for straight already; None means never.
        slight_bend: A lens that moves the picture by less than this, pixels of a 320 frame, is
            none of those that another estimate is made to tell apart.
        parallels: How lines of one direction help the bends; None leaves the lens to the bends.
        vanishing: How orthogonal vanishing points fix the scale; None leaves it to the prior.
        search: The global start.
        solver: The local solver.
    """

    bend: BendConfig = field(default_factory=BendConfig)
    tolerances: tuple[float, ...] = (3.0, 1.5, 1.0, 1.0)
    inlier_tolerance: float = STRAIGHT_PX
    spacing: float = 14.0
    max_curves: int = 120
    joinings: int = 1
    perspective: PerspectiveConfig | None = field(default_factory=PerspectiveConfig)
    slight_bend: float = 4.0
    parallels: ParallelsConfig | None = field(default_factory=ParallelsConfig)
    vanishing: VanishingConfig | None = field(default_factory=VanishingConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    solver: SolverConfig = field(default_factory=SolverConfig)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A lens that the rounds settled on."""

    camera: KannalaBrandt
    covariance: np.ndarray
    scale_source: str
    note: str = ""
    error: float | None = None  # expected, where the covariance does not tell


def fit_lens(
    curve_sets: Sequence[Sequence[Curve]],
    width: int,
    height: int,
    *,
    config: FitConfig = FitConfig(),
    circles: Sequence[ImageCircle | None] = (),
    observations: Sequence[Observation] = (),
    starts: Sequence[KannalaBrandt] = (),
    rims: Sequence[Float[np.ndarray, "_ 2"]] = (),
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
        starts: Lenses to begin with beside those of the global search.
        rims: The outermost pixels that each picture shows (`find_rim`), which the lens reaches.

    Returns:
        The fit. Straight lines stay straight when the rectified plane is scaled, so the scale
        comes from what was observed, from orthogonal vanishing points where a scene has them, or
        else from the prior.
    """
    with _CONTROLLER.limit(limits=1, user_api="blas"):
        known = _known(circles, observations, width)
        rim = np.concatenate([np.zeros((0, 2)), *rims])
        fit = partial(_fit, curve_sets, width, height, config=config, rim=rim)
        best, joined = fit(known=known, starts=starts)
        if best is None:
            return _failure(curve_sets, "no curve was found that could be a straight line")
        if known.has_estimate and not best.note and bend_of(best.camera) < 2 * config.slight_bend:
            alone, rejoined = fit(known=known.without_estimates, starts=())
            if alone is not None and _is_slight(alone, config.slight_bend):
                best, joined = alone, rejoined
        return _report(best, joined, config=config)


def _is_slight(found: _Candidate, most: float) -> bool:
    """Whether the curves by themselves tell that the picture is hardly bent, if at all.

    Networks learn from fisheye pictures and see a wide fisheye in every one. An almost straight
    picture through a wide lens is bent by a few pixels nonetheless, since next to no lens is wide
    and straight.
    """
    return found.note == _STRAIGHT or (not found.note and bend_of(found.camera) < most)


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
    width: int,
    height: int,
    *,
    config: FitConfig,
    known: Known,
    starts: Sequence[KannalaBrandt],
    rim: Float[np.ndarray, "n 2"],
) -> tuple[_Candidate | None, Sequence[Sequence[Curve]]]:
    """The lens, None without any curve, and the curves as they were joined under it."""
    pool = [_longest(curves, config.max_curves) for curves in curve_sets]
    if not any(pool):
        return None, curve_sets
    samples = _samples(pool, width, config)
    starts = [
        *(start.normalized() for start in starts),
        *search(samples, width, height, config=config.search),
    ]
    best = _best(samples, starts, known, config)
    joined = curve_sets
    for _ in range(config.joinings):
        joined = [join_curves(list(curves), best.camera) for curves in curve_sets]
        samples = _samples(
            [_longest(curves, config.max_curves) for curves in joined], width, config
        )
        final = replace(config, tolerances=config.tolerances[-1:])
        best = _settled(samples, best.camera, known, final)
    if config.parallels is not None:
        best = _with_parallels(best, joined, known, config)
    source = scale_source(best, known)
    candidate = _Candidate(best.camera, best.covariance, source)
    if config.perspective is not None:
        candidate = _unless_straight(candidate, curve_sets, joined, known, config)
    if config.vanishing is not None:
        candidate = _with_scale(candidate, joined, config)
    if len(rim) and not candidate.note and candidate.camera.theta_max < _SHOWN:
        candidate = _reaching(candidate, rim)
    return candidate, joined


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
    assert config.parallels is not None
    pool = [_longest(curves, config.parallels.max_curves) for curves in curve_sets]
    samples = _samples(pool, best.camera.width, config)
    held = replace(known, observations=[*known.observations, held_scale(best.camera)])
    rounds = replace(config, tolerances=config.tolerances[-1:] * len(config.parallels.tolerances))
    second = _settled(samples, best.camera, held, rounds, config.parallels)
    return replace(best, camera=second.camera)


def _samples(pool: Sequence[Sequence[Curve]], width: int, config: FitConfig) -> CurveSamples:
    curves = [curve for picture in pool for curve in picture]
    pictures = np.repeat(np.arange(len(pool)), [len(picture) for picture in pool])
    spacing = config.spacing * width / REFERENCE_WIDTH
    return sample_curves(curves, spacing=spacing, pictures=pictures)


def _longest(curves: Sequence[Curve], most: int) -> list[Curve]:
    return sorted(curves, key=lambda curve: -curve.length)[:most]


def _final_cost(
    samples: CurveSamples, camera: KannalaBrandt, known: Known, config: FitConfig
) -> float:
    """Length-weighted share of bent curves, by which starts compete; the prior breaks ties."""
    scale = camera.width / REFERENCE_WIDTH
    result = straightness(camera, samples)
    squared = (samples.curve_rms(result.residuals) / (config.inlier_tolerance * scale)) ** 2
    lengths = samples.lengths
    z = known.belief(camera).encode(camera)
    return float((lengths * squared / (1 + squared)).sum() / lengths.sum() + 0.002 * (z @ z))


def _report(
    best: _Candidate,
    curve_sets: Sequence[Sequence[Curve]],
    *,
    config: FitConfig,
) -> LensFit:
    """All curves under the final lens, and how far to trust it."""
    tolerance = config.inlier_tolerance * best.camera.width / REFERENCE_WIDTH
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
    if best.note and (status == "ok" or (status == "degraded" and best.note == _UNTOLD)):
        status = "ok" if best.note == _STRAIGHT else "degraded"
        reason = best.note
    deviation = float(np.sqrt(scale_variance(scale_tangent(best.camera), covariance)))
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


def _unless_straight(
    best: _Candidate,
    curve_sets: Sequence[Sequence[Curve]],
    joined: Sequence[Sequence[Curve]],
    known: Known,
    config: FitConfig,
) -> _Candidate:
    """The perspective lens where it does as well; its scale is then open.

    Line perception was made to find bent lines and finds some in every picture, so a bend is not
    believed where the curves that the picture shows by itself speak for straight lines. Where no
    curve speaks, another estimate of the lens is the better guess: most pictures that come here
    are bent.
    """
    straight = _perspective(best.camera, joined, known, config)
    own = [[curve for curve in curves if not curve.is_hinted] for curves in curve_sets]
    if straight is None and 0 < sum(map(len, own)) < sum(map(len, curve_sets)):
        alone = [join_curves(curves, best.camera) for curves in own]
        straight = _perspective(best.camera, alone, known, config)
        straight = straight if straight is not None and straight.proven else None
    if straight is None:
        return best
    if straight.untold and known.has_estimate:
        return replace(best, note=_UNTOLD)
    camera = straight.camera
    tangent = scale_tangent(camera) * _OPEN_SCALE
    sure = np.diag([*(camera.k[0] * np.full(5, 1e-4)), 0.0, *(1e-4 * camera.m_u * np.ones(3))]) ** 2
    covariance = sure + np.outer(tangent, tangent)
    note = _STRAIGHT if straight.proven else _PERHAPS_STRAIGHT
    error = disagreement(camera, best.camera) / TAIL  # at most what the bend would move
    return _Candidate(camera, covariance, best.scale_source, note, error)


def _perspective(
    camera: KannalaBrandt, curve_sets: Sequence[Sequence[Curve]], known: Known, config: FitConfig
) -> Perspective | None:
    """A perspective lens if it makes these curves about as straight as the fitted one."""
    assert config.perspective is not None
    pool = [_longest(curves, config.max_curves) for curves in curve_sets]
    return perspective_instead(
        camera,
        _samples(pool, camera.width, config),
        known,
        tolerance=config.inlier_tolerance * camera.width / REFERENCE_WIDTH,
        bend=config.bend,
        config=config.perspective,
    )


def _with_scale(
    best: _Candidate, curve_sets: Sequence[Sequence[Curve]], config: FitConfig
) -> _Candidate:
    """Fuse the fit's scale with those of each picture's vanishing points by their variances."""
    assert config.vanishing is not None
    width = best.camera.width
    most = config.vanishing.most_lines
    sets = [_samples([_longest(curves, most)], width, config) for curves in curve_sets if curves]
    tolerance = config.inlier_tolerance * width / REFERENCE_WIDTH
    found = [vanishing_scale(best.camera, samples, tolerance, config.vanishing) for samples in sets]
    fused = fused_scale(
        best.camera, best.covariance, [estimate for estimate in found if estimate is not None]
    )
    if fused is None:
        return best
    source = "vanishing points" if fused.gain > 0.5 else best.scale_source
    return replace(best, camera=fused.camera, covariance=fused.covariance, scale_source=source)


def _reaching(best: _Candidate, rim: Float[np.ndarray, "n 2"]) -> _Candidate:
    """The nearest lens that reaches all that the pictures show, or a word where none is near.

    The rim tells no scale, so that is held. It is for lenses that turn near their axis: one that
    turns far out, at the soft border of its image circle, loses nothing that a flat picture shows.
    """
    belief = LensPrior(best.camera.normalized().to_vector(), best.covariance)
    held = observed(belief, held_scale(best.camera)).covariance
    found = reaching(best.camera, held, rim)
    return replace(best, camera=found.camera, note="" if found.reaches else _FALLS_SHORT)


def _failure(curve_sets: Sequence[Sequence[Curve]], reason: str) -> LensFit:
    nothing = tuple(() for _ in curve_sets)
    nan = float("nan")
    return LensFit(None, np.zeros((9, 9)), "failed", reason, nothing, nan, nan)

"""The plumb-line fit: from curves in one or many pictures to the lens that makes them straight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from threadpoolctl import ThreadpoolController

from classical.camera import KannalaBrandt
from classical.fit.fitted import STRAIGHT_PX, fitted_curves
from classical.fit.perspective import PerspectiveConfig, perspective_instead
from classical.fit.prior import FREE, LensPrior, generic_prior
from classical.fit.quality import judge, predicted_error
from classical.fit.result import LensFit, ScaleSource
from classical.fit.samples import CurveSamples, sample_curves
from classical.fit.search import SearchConfig, search
from classical.fit.solve import SolverConfig, solve
from classical.fit.straightness import Straightness, straightness
from classical.fit.vanishing import (
    ScaleEstimate,
    VanishingConfig,
    rescaled,
    scale_from_directions,
)
from classical.lines import Curve, join_curves

# one thread: matrices of eight columns gain nothing from two, and the answer keeps its bits
_CONTROLLER = ThreadpoolController()
_STRAIGHT = "the lines are straight already"
_PERHAPS_STRAIGHT = "the lines look straight already, but they could not tell a fisheye"
_OPEN_SCALE = 0.5  # deviation of log focal length that straight lines leave to a straight picture
_REFERENCE_WIDTH = 1280  # tolerances are pixels of a picture this wide


@dataclass(frozen=True)
class FitConfig:
    """The plumb-line fit; lengths in pixels of a picture 1280 wide.

    Attributes:
        sigma_range: Least and greatest standard deviation of a sample across its line. In between
            it is measured in the picture: the median RMS residual of the curves.
        tolerances: RMS residual at which a curve has lost most of its weight, one per round.
        inlier_tolerance: RMS residual up to which a curve is called straight.
        spacing: Distance between samples on a curve.
        max_curves: Longest curves used in each picture.
        joinings: How often pieces of one line are joined under the lens and the fit repeated.
        covariance_redundancy: As `SolverConfig.redundancy`, for the covariance. The fit guards
            against curves that err together; what it reaches on average is better than that, and
            this value makes the predicted errors of held-out synthetic pictures come true.
        perspective: When a picture is taken for straight already; None means never.
        vanishing: How orthogonal vanishing points fix the scale; None leaves it to the prior.
        search: The global start.
        solver: The local solver.
    """

    sigma_range: tuple[float, float] = (0.2, 1.0)
    tolerances: tuple[float, ...] = (3.0, 1.5, 1.0, 1.0)
    inlier_tolerance: float = STRAIGHT_PX
    spacing: float = 14.0
    max_curves: int = 120
    joinings: int = 1
    covariance_redundancy: float = 6.0
    perspective: PerspectiveConfig | None = field(default_factory=PerspectiveConfig)
    vanishing: VanishingConfig | None = field(default_factory=VanishingConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    solver: SolverConfig = field(default_factory=SolverConfig)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A lens that the rounds settled on."""

    camera: KannalaBrandt
    covariance: np.ndarray
    scale_source: ScaleSource = "prior"
    note: str = ""


def fit_lens(
    curve_sets: Sequence[Sequence[Curve]],
    width: int,
    height: int,
    *,
    config: FitConfig = FitConfig(),
    prior: LensPrior | None = None,
    start: KannalaBrandt | None = None,
) -> LensFit:
    """Find the lens under which the curves of all pictures are straight.

    Args:
        curve_sets: The curves of each picture; all pictures have one size and one lens.
        width: Picture width in pixels.
        height: Picture height in pixels.
        config: Tolerances and effort.
        prior: A belief about the lens, for what the curves do not tell. None means what holds for
            lenses in general (`generic_prior`).
        start: A lens to begin with beside those of the global search; with a prior given, the
            search is left out.

    Returns:
        The fit. Straight lines stay straight when the rectified plane is scaled, so the scale
        comes from orthogonal vanishing points where a scene has them, else from the prior.
    """
    with _CONTROLLER.limit(limits=1, user_api="blas"):
        return _fit(curve_sets, width, height, config=config, prior=prior, start=start)


def _fit(
    curve_sets: Sequence[Sequence[Curve]],
    width: int,
    height: int,
    *,
    config: FitConfig,
    prior: LensPrior | None,
    start: KannalaBrandt | None,
) -> LensFit:
    pool = [_longest(curves, config.max_curves) for curves in curve_sets]
    if not any(pool):
        return _failure(curve_sets, "no curve was found that could be a straight line")
    samples = _samples(pool, width, config)
    if prior is None:
        starts = search(samples, width, height, config=config.search)
    else:
        starts = [prior.decode(np.zeros(8), width, height)]
    if start is not None:
        starts = [start.normalized(), *starts]
    best = _best(samples, starts, config=config, prior=prior)
    joined = curve_sets
    for _ in range(config.joinings):
        joined = [join_curves(list(curves), best.camera) for curves in curve_sets]
        samples = _samples(
            [_longest(curves, config.max_curves) for curves in joined], width, config
        )
        final = replace(config, tolerances=config.tolerances[-1:])
        best = _settle(samples, best.camera, config=final, prior=prior)
    if config.perspective is not None:
        best = _unless_straight(best, samples, config)
    if config.vanishing is not None:
        best = _with_scale(best, joined, config)
    return _report(best, joined, config=config)


def _best(
    samples: CurveSamples,
    starts: Sequence[KannalaBrandt],
    *,
    config: FitConfig,
    prior: LensPrior | None,
) -> _Candidate:
    """Let the starts compete on the longest curves only; the winner settles on all of them."""
    if len(starts) > 1:
        few = samples.coarse(curves=config.search.curves, most=config.search.samples)
        short = replace(config, tolerances=config.tolerances[:2])
        trials = [_settle(few, lens, config=short, prior=prior).camera for lens in starts]
        starts = [min(trials, key=lambda lens: _final_cost(samples, lens, config))]
        config = replace(config, tolerances=config.tolerances[2:])
    return _settle(samples, starts[0], config=config, prior=prior)


def _samples(pool: Sequence[Sequence[Curve]], width: int, config: FitConfig) -> CurveSamples:
    curves = [curve for picture in pool for curve in picture]
    return sample_curves(curves, spacing=config.spacing * width / _REFERENCE_WIDTH)


def _longest(curves: Sequence[Curve], most: int) -> list[Curve]:
    return sorted(curves, key=lambda curve: -curve.length)[:most]


def _settle(
    samples: CurveSamples,
    camera: KannalaBrandt,
    *,
    config: FitConfig,
    prior: LensPrior | None,
) -> _Candidate:
    """Solve in rounds; each re-weights curves by how straight the last lens made them."""
    scale = camera.width / _REFERENCE_WIDTH
    belief = prior
    information = np.eye(8)
    for tolerance in config.tolerances:
        belief = prior or generic_prior(float(camera.k[0]), camera.width, camera.height)
        shares, noise = _curve_weights(samples, camera, tolerance * scale)
        sigma = _sigma(noise, scale, config)
        problem = _Problem(samples, belief, np.sqrt(shares)[samples.owner] / sigma, camera)
        solution = solve(
            problem.residuals,
            problem.jacobian,
            belief.encode(camera),
            config=config.solver,
        )
        camera = belief.decode(solution.value, camera.width, camera.height)
        information = solution.information
    assert belief is not None
    data = (information - np.eye(8)) * config.solver.redundancy / config.covariance_redundancy
    spread = np.linalg.inv(data + np.eye(8))
    return _Candidate(camera, belief.factor @ spread @ belief.factor.T)


def _curve_weights(
    samples: CurveSamples, camera: KannalaBrandt, tolerance: float
) -> tuple[Float[np.ndarray, " curves"], float]:
    """Geman–McClure weights of whole curves, for a bent thing is no line anywhere along it.

    Also the length-weighted median of the curves' RMS residuals.
    """
    result = straightness(camera, samples)
    rms = samples.curve_rms(result.residuals)
    order = np.argsort(rms)
    length = np.cumsum(samples.lengths[order])
    median = rms[order][np.searchsorted(length, 0.5 * length[-1])]
    return 1 / (1 + (rms / tolerance) ** 2) ** 2, float(median)


def _final_cost(samples: CurveSamples, camera: KannalaBrandt, config: FitConfig) -> float:
    """Length-weighted share of bent curves, by which starts compete; a weak prior breaks ties."""
    scale = camera.width / _REFERENCE_WIDTH
    result = straightness(camera, samples)
    squared = (samples.curve_rms(result.residuals) / (config.inlier_tolerance * scale)) ** 2
    lengths = samples.lengths
    z = generic_prior(float(camera.k[0]), camera.width, camera.height).encode(camera)
    return float((lengths * squared / (1 + squared)).sum() / lengths.sum() + 0.002 * (z @ z))


@dataclass(frozen=True, eq=False)
class _Problem:
    """Weighted residuals as functions of the prior's coordinates."""

    samples: CurveSamples
    prior: LensPrior
    weights: np.ndarray  # of each residual: 1 / standard deviation
    frame: KannalaBrandt  # only its size is used
    last: dict[str, Any] = field(default_factory=dict)

    def _at(self, z: np.ndarray) -> Straightness:
        """The solver asks for the Jacobian where it has just asked for the residuals."""
        if self.last.get("z") != z.tobytes():
            camera = self.prior.decode(z, self.frame.width, self.frame.height)
            self.last.update(z=z.tobytes(), result=straightness(camera, self.samples))
        return self.last["result"]

    def residuals(self, z: np.ndarray) -> np.ndarray:
        return self._at(z).residuals * self.weights

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        return (self._at(z).jacobian @ self.prior.factor) * self.weights[:, None]


def _report(
    best: _Candidate, curve_sets: Sequence[Sequence[Curve]], *, config: FitConfig
) -> LensFit:
    """All curves under the final lens, and how far to trust it."""
    tolerance = config.inlier_tolerance * best.camera.width / _REFERENCE_WIDTH
    curves = tuple(
        fitted_curves(picture, best.camera, tolerance=tolerance) for picture in curve_sets
    )
    inliers = [curve for picture in curves for curve in picture if curve.inlier]
    every = np.concatenate([curve.residuals for curve in inliers]) if inliers else np.array([])
    rms = float(np.sqrt((every**2).mean())) if inliers else float("nan")
    error = predicted_error(best.camera, best.covariance)
    status, reason = judge(curves, best.camera, error)
    if best.note and status == "ok":
        status = "ok" if best.note == _STRAIGHT else "degraded"
        reason = best.note
    deviation = float(np.sqrt(_scale_variance(_scale_tangent(best.camera), best.covariance)))
    return LensFit(
        best.camera,
        best.covariance,
        status,
        reason,
        curves,
        rms,
        error,
        best.scale_source,
        deviation,
    )


def _unless_straight(best: _Candidate, samples: CurveSamples, config: FitConfig) -> _Candidate:
    """The perspective lens where it does as well; its scale is then open."""
    assert config.perspective is not None
    scale = best.camera.width / _REFERENCE_WIDTH
    _, noise = _curve_weights(samples, best.camera, config.tolerances[-1] * scale)
    straight = perspective_instead(
        best.camera,
        samples,
        sigma=_sigma(noise, scale, config),
        tolerance=config.inlier_tolerance * scale,
        redundancy=config.solver.redundancy,
        config=config.perspective,
    )
    if straight is None:
        return best
    camera = straight.camera
    tangent = _scale_tangent(camera) * _OPEN_SCALE
    sure = np.diag([*camera.k * 1e-4, 0.0, *(1e-4 * camera.m_u * np.ones(3))]) ** 2
    covariance = sure + np.outer(tangent, tangent)
    note = _STRAIGHT if straight.proven else _PERHAPS_STRAIGHT
    return _Candidate(camera, covariance, note=note)


def _sigma(noise: float, scale: float, config: FitConfig) -> float:
    """Standard deviation of a sample in pixels, from the curves' median RMS residual."""
    least, most = config.sigma_range
    return min(max(noise, least * scale), most * scale)


def _with_scale(
    best: _Candidate, curve_sets: Sequence[Sequence[Curve]], config: FitConfig
) -> _Candidate:
    """Fuse the fit's scale with those of each picture's vanishing points by their variances.

    One Kalman update along the only direction that lines leave open, ∂camera/∂log s.
    """
    width = best.camera.width
    sets = [_samples([curves], width, config) for curves in curve_sets if curves]
    found = [_vanishing_scale(best.camera, samples, config) for samples in sets]
    estimates = [estimate for estimate in found if estimate is not None]
    if not estimates:
        return best
    precisions = np.array([estimate.deviation**-2 for estimate in estimates])
    scales = np.array([estimate.log_scale for estimate in estimates])
    tangent = _scale_tangent(best.camera)
    variance = _scale_variance(tangent, best.covariance)
    gain = variance / (variance + 1 / precisions.sum())
    log_scale = float(precisions @ scales / precisions.sum())
    camera = rescaled(best.camera, float(np.exp(gain * log_scale)))
    covariance = best.covariance - np.outer(tangent, tangent) * variance * gain
    source: ScaleSource = "vanishing points" if gain > 0.5 else best.scale_source
    return replace(best, camera=camera, covariance=covariance, scale_source=source)


def _vanishing_scale(
    camera: KannalaBrandt, samples: CurveSamples, config: FitConfig
) -> ScaleEstimate | None:
    """Let the longest straight curves vote for the scale."""
    assert config.vanishing is not None
    scale = camera.width / _REFERENCE_WIDTH
    few = samples.coarse(curves=config.vanishing.most_lines, most=12)
    result = straightness(camera, few)
    good = few.curve_rms(result.residuals) <= config.inlier_tolerance * scale
    lengths = few.lengths[good]
    # a line of length L and noise σ turns by about 2 √3 σ / L, and by as much more as L subtends
    deviations = 2 * np.sqrt(3) * config.sigma_range[0] * scale / np.maximum(lengths, 1.0)
    return scale_from_directions(
        result.normals[good],
        lengths / camera.width,
        deviations,
        rng=np.random.default_rng(0),
        config=config.vanishing,
    )


def _scale_tangent(camera: KannalaBrandt) -> Float[np.ndarray, " 9"]:
    """∂camera/∂log s of (tan θ)' = s tan θ, by central differences."""
    step = 0.02
    ahead, behind = (rescaled(camera, float(np.exp(sign * step))) for sign in (1, -1))
    return (ahead.to_vector() - behind.to_vector()) / (2 * step)


def _scale_variance(tangent: np.ndarray, covariance: np.ndarray) -> float:
    """Variance of log s with everything else as the fit found it."""
    free = covariance[np.ix_(FREE, FREE)]
    return float(1 / (tangent[FREE] @ np.linalg.solve(free, tangent[FREE])))


def _failure(curve_sets: Sequence[Sequence[Curve]], reason: str) -> LensFit:
    nothing = tuple(() for _ in curve_sets)
    nan = float("nan")
    return LensFit(None, np.zeros((9, 9)), "failed", reason, nothing, nan, nan)

"""The plumb-line fit: from curves in one or many pictures to the lens that makes them straight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from classical.camera import KannalaBrandt
from classical.fit.prior import LensPrior, generic_prior
from classical.fit.quality import judge, predicted_error
from classical.fit.result import FittedCurve, LensFit
from classical.fit.samples import CurveSamples, sample_curves
from classical.fit.search import SearchConfig, search
from classical.fit.solve import SolverConfig, solve
from classical.fit.straightness import straightness
from classical.lines import Curve

_REFERENCE_WIDTH = 1280  # tolerances are pixels of a picture this wide


@dataclass(frozen=True)
class FitConfig:
    """The plumb-line fit; lengths in pixels of a picture 1280 wide.

    Attributes:
        sigma: Standard deviation of a sample across its line: edge noise, bends of real edges and
            what the lens model cannot follow.
        tolerances: RMS residual at which a curve has lost most of its weight, one per round.
        inlier_tolerance: RMS residual up to which a curve is called straight.
        spacing: Distance between samples on a curve.
        max_curves: Longest curves used in each picture.
        search: The global start.
        solver: The local solver.
    """

    sigma: float = 0.5
    tolerances: tuple[float, ...] = (3.0, 1.5, 1.0, 1.0)
    inlier_tolerance: float = 1.0
    spacing: float = 14.0
    max_curves: int = 120
    search: SearchConfig = field(default_factory=SearchConfig)
    solver: SolverConfig = field(default_factory=SolverConfig)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A lens that the rounds settled on."""

    camera: KannalaBrandt
    covariance: np.ndarray
    cost: float


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
        comes from the prior alone.
    """
    scale = width / _REFERENCE_WIDTH
    used = [_longest(curves, config.max_curves) for curves in curve_sets]
    pool = [curve for curves in used for curve in curves]
    if not pool:
        return _failure(curve_sets, "no curve was found that could be a straight line")
    samples = sample_curves(pool, spacing=config.spacing * scale)
    if prior is None:
        starts = search(samples, width, height, config=config.search)
    else:
        starts = [prior.decode(np.zeros(8), width, height)]
    if start is not None:
        starts = [start.normalized(), *starts]
    candidates = [_settle(samples, lens, config=config, prior=prior) for lens in starts]
    best = min(candidates, key=lambda candidate: candidate.cost)
    return _report(best, curve_sets, config=config)


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
    sigma = config.sigma * scale
    belief = prior
    information = np.eye(8)
    for tolerance in config.tolerances:
        belief = prior or generic_prior(float(camera.k[0]), camera.width, camera.height)
        shares = _curve_weights(samples, camera, tolerance * scale)
        problem = _Problem(samples, belief, np.sqrt(shares)[samples.owner] / sigma, camera)
        solution = solve(
            problem.residuals, problem.jacobian, belief.encode(camera), config=config.solver
        )
        camera = belief.decode(solution.value, camera.width, camera.height)
        information = solution.information
    assert belief is not None
    covariance = belief.factor @ np.linalg.inv(information) @ belief.factor.T
    return _Candidate(camera, covariance, _final_cost(samples, camera, config))


def _curve_weights(
    samples: CurveSamples, camera: KannalaBrandt, tolerance: float
) -> Float[np.ndarray, " curves"]:
    """Geman–McClure weights of whole curves: a bent thing is no line anywhere along it."""
    result = straightness(camera, samples, np.ones(len(samples.points)))
    rms = samples.curve_rms(result.residuals)
    return 1 / (1 + (rms / tolerance) ** 2) ** 2


def _final_cost(samples: CurveSamples, camera: KannalaBrandt, config: FitConfig) -> float:
    """Length-weighted share of bent curves, by which starts compete; a weak prior breaks ties."""
    scale = camera.width / _REFERENCE_WIDTH
    result = straightness(camera, samples, np.ones(len(samples.points)))
    squared = (samples.curve_rms(result.residuals) / (config.inlier_tolerance * scale)) ** 2
    lengths = samples.curve_sums(samples.spans)
    z = generic_prior(float(camera.k[0]), camera.width, camera.height).encode(camera)
    return float((lengths * squared / (1 + squared)).sum() / lengths.sum() + 0.002 * (z @ z))


@dataclass(frozen=True, eq=False)
class _Problem:
    """Weighted residuals as functions of the prior's coordinates."""

    samples: CurveSamples
    prior: LensPrior
    weights: np.ndarray  # of each residual: 1 / standard deviation
    frame: KannalaBrandt  # only its size is used

    def _camera(self, z: np.ndarray) -> KannalaBrandt:
        return self.prior.decode(z, self.frame.width, self.frame.height)

    def residuals(self, z: np.ndarray) -> np.ndarray:
        ones = np.ones(len(self.samples.points))
        return straightness(self._camera(z), self.samples, ones).residuals * self.weights

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        ones = np.ones(len(self.samples.points))
        result = straightness(self._camera(z), self.samples, ones, jacobian=True)
        assert result.jacobian is not None
        return (result.jacobian @ self.prior.factor) * self.weights[:, None]


def _report(
    best: _Candidate, curve_sets: Sequence[Sequence[Curve]], *, config: FitConfig
) -> LensFit:
    """All curves under the final lens, and how far to trust it."""
    tolerance = config.inlier_tolerance * best.camera.width / _REFERENCE_WIDTH
    curves = tuple(_fitted(picture, best.camera, tolerance) for picture in curve_sets)
    inliers = [curve for picture in curves for curve in picture if curve.inlier]
    every = np.concatenate([curve.residuals for curve in inliers]) if inliers else np.array([])
    rms = float(np.sqrt((every**2).mean())) if inliers else float("nan")
    error = predicted_error(best.camera, best.covariance)
    status, reason = judge(curves, best.camera, error)
    return LensFit(best.camera, best.covariance, status, reason, curves, rms, error)


def _fitted(
    curves: Sequence[Curve], camera: KannalaBrandt, tolerance: float
) -> tuple[FittedCurve, ...]:
    if not curves:
        return ()
    counts = np.array([len(curve.points) for curve in curves])
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    points = np.concatenate([curve.points for curve in curves])
    samples = CurveSamples(points, starts, np.ones(len(points)))
    result = straightness(camera, samples, np.ones(len(points)))
    rms = samples.curve_rms(result.residuals)
    reached: Bool[np.ndarray, " curves"] = samples.curve_sums(~result.reached) == 0
    parts = np.split(result.residuals, starts[1:])
    return tuple(
        FittedCurve(curve.points, part, float(value), bool(inside and value <= tolerance))
        for curve, part, value, inside in zip(curves, parts, rms, reached, strict=True)
    )


def _failure(curve_sets: Sequence[Sequence[Curve]], reason: str) -> LensFit:
    nothing = tuple(() for _ in curve_sets)
    nan = float("nan")
    return LensFit(None, np.zeros((9, 9)), "failed", reason, nothing, nan, nan)

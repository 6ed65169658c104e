"""Rounds of the fit: solve, look again at which curves are straight, solve again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.sparse import csc_array

from classical.camera import KannalaBrandt
from classical.fit.bends import BendConfig, Bends
from classical.fit.estimate import Estimate
from classical.fit.observations import Observation, observed
from classical.fit.parallels import Parallels, ParallelsConfig, find_parallels
from classical.fit.prior import LensPrior, generic_prior
from classical.fit.samples import CurveSamples
from classical.fit.solve import SolverConfig, solve
from classical.fit.straightness import Straightness, straightness


@dataclass(frozen=True, eq=False)
class Known:
    """What is known beside the curves.

    Attributes:
        observations: Of the lens.
        has_free_aspect: Whether the pixels are clearly not square.
        estimate: Another estimate of the lens …
        loss: … and what log likelihood the curves lose under it; see `Estimate.observations`.
    """

    observations: Sequence[Observation] = ()
    has_free_aspect: bool = False
    estimate: Estimate | None = None
    loss: float = math.inf

    @property
    def every(self) -> list[Observation]:
        """The observations, and those of the estimate."""
        told = [] if self.estimate is None else self.estimate.observations(self.loss)
        return [*self.observations, *told]

    @property
    def has_estimate(self) -> bool:
        """Whether another estimate of the lens is among them."""
        return not all(observation.is_sure for observation in self.every)

    @property
    def without_estimates(self) -> Known:
        """What is sure alone."""
        sure = [observation for observation in self.observations if observation.is_sure]
        return replace(self, observations=sure, estimate=None)

    def belief(self, camera: KannalaBrandt) -> LensPrior:
        """The prior near a camera, sharpened by all that was observed."""
        prior = generic_prior(
            float(camera.k[0]),
            camera.width,
            camera.height,
            has_free_aspect=self.has_free_aspect,
        )
        for observation in self.every:
            prior = observed(prior, observation.near(camera))
        return prior

    def sure_cost(self, camera: KannalaBrandt) -> float:
        """Negative log likelihood of what is sure, up to a constant."""
        sure = self.without_estimates.observations
        return 0.5 * sum(observation.surprise(camera) for observation in sure)


@dataclass(frozen=True, eq=False)
class Settled:
    """A lens that the rounds settled on, and its covariance (9, 9)."""

    camera: KannalaBrandt
    covariance: Float[np.ndarray, "9 9"]


def settle(
    samples: CurveSamples,
    camera: KannalaBrandt,
    known: Known,
    *,
    tolerances: Sequence[float],
    bend: BendConfig,
    solver: SolverConfig,
    parallels: ParallelsConfig | None = None,
) -> Settled:
    """Solve in rounds; each re-weights curves by how straight the last lens made them.

    Args:
        samples: Points of the curves.
        camera: Where to start.
        known: What is known beside them.
        tolerances: RMS residual at which a curve has lost most of its weight, one per round,
            pixels of a picture 1280 wide.
        bend: How far straight lines look bent.
        solver: The local solver.
        parallels: How lines of one direction hold the lens beside their bends; None leaves it to
            the bends.
    """
    bends = Bends.of(samples, camera.width, bend)
    belief = known.belief(camera)
    information = np.eye(8)
    directions = None
    for number, tolerance in enumerate(tolerances):
        belief = known.belief(camera)
        now = straightness(camera, samples)
        shares = curve_shares(samples, now.residuals, tolerance * bends.scale)
        deviation = bends.deviation(now.residuals, shares)
        if parallels is not None:
            directions = _directions(now, bends, shares, deviation, number, parallels)
        problem = _Problem(
            samples,
            belief,
            bends.operator(deviation, shares),
            np.sqrt(shares) / (deviation * bends.scale * samples.counts),
            camera,
            directions,
        )
        solution = solve(problem.residuals, problem.jacobian, belief.encode(camera), config=solver)
        camera = belief.decode(solution.value, camera.width, camera.height)
        information = solution.information
    return Settled(camera, belief.factor @ np.linalg.inv(information) @ belief.factor.T)


def _directions(
    now: Straightness,
    bends: Bends,
    shares: Float[np.ndarray, " curves"],
    deviation: float,
    number: int,
    config: ParallelsConfig,
) -> Parallels:
    """The directions of the curves in a round."""
    samples = bends.samples
    lengths = samples.lengths
    bows = deviation * bends.scale * bends.shapes[:, 0]
    return find_parallels(
        now.normals,
        lengths,
        shares,
        config.tilt * bows / (lengths / 2),
        np.zeros(samples.n_curves, int) if samples.pictures is None else samples.pictures,
        tolerance=config.tolerances[min(number, len(config.tolerances) - 1)],
        config=config,
    )


def curve_shares(
    samples: CurveSamples, residuals: Float[np.ndarray, " n"], tolerance: float
) -> Float[np.ndarray, " curves"]:
    """Geman–McClure weights of whole curves, for a bent thing is no line anywhere along it."""
    return 1 / (1 + (samples.curve_rms(residuals) / tolerance) ** 2) ** 2


@dataclass(frozen=True, eq=False)
class _Problem:
    """What the curves say, in standard deviations, as a function of the prior's coordinates.

    Bends first, then distances out of the lens's reach, then angles to the curves' directions.
    """

    samples: CurveSamples
    prior: LensPrior
    operator: csc_array
    outside: np.ndarray  # weight of each curve's samples out of the lens's reach
    frame: KannalaBrandt  # only its size is used
    directions: Parallels | None
    last: dict[str, Any] = field(default_factory=dict)

    def _at(self, z: np.ndarray) -> Straightness:
        """The solver asks for the Jacobian where it has just asked for the residuals."""
        if self.last.get("z") != z.tobytes():
            camera = self.prior.decode(z, self.frame.width, self.frame.height)
            self.last.update(z=z.tobytes(), result=straightness(camera, self.samples))
        return self.last["result"]

    def residuals(self, z: np.ndarray) -> np.ndarray:
        now = self._at(z)
        parts = [self.operator @ now.residuals, self._beyond(now, now.residuals)]
        if self.directions is not None:
            parts.append(self.directions.residuals(now.normals))
        return np.concatenate(parts)

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        now = self._at(z)
        J = now.jacobian
        parts = [self.operator @ J, self._beyond(now, J)]
        if self.directions is not None:
            parts.append(self.directions.jacobian(now.normals, now.normal_jacobian))
        return np.concatenate(parts) @ self.prior.factor

    def _beyond(self, now: Straightness, values: np.ndarray) -> np.ndarray:
        """Means over the samples out of reach, which a bend does not see if all of them are."""
        if now.reached.all():
            return np.zeros((self.samples.n_curves, *values.shape[1:]))
        weights = np.where(now.reached, 0.0, self.outside[self.samples.owner])
        return self.samples.curve_sums((values.T * weights).T)

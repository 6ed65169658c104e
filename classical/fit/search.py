"""A global start without a network: few numbers, searched widely.

The classical projections form one family, r = f sin(bθ)/b for b > 0, f θ for b = 0 and
f tan(|b|θ)/|b| for b < 0: orthographic at 1, equisolid at 1/2, equidistant at 0, stereographic at
−1/2 and perspective at −1. The division model is the stereographic member up to the scale
(tan θ)' = s tan θ, which no straight line can see, so the family covers it too.
"""

from __future__ import annotations

from dataclasses import dataclass

import nlopt
import numpy as np
from jaxtyping import Float

from classical.camera import KannalaBrandt
from classical.fit.prior import generic_prior
from classical.fit.samples import CurveSamples
from classical.fit.straightness import straightness

_PROJECTIONS = (-0.5, 0.0, 0.5)
_STRENGTHS = np.geomspace(0.4, 2.0, 6)  # f in half widths; 2.2 bends nothing visibly
_THETA = np.linspace(0.02, 1.0, 48)  # of the widest angle, where the polynomial meets the family
_BEYOND = 20.0  # cost a sample of a lens that does not reach it


@dataclass(frozen=True)
class SearchConfig:
    """The search for starts.

    Attributes:
        tolerance: Residual at which a curve starts to count as not straight, pixels of a picture
            1280 wide.
        evaluations: Of the objective by the local search, from each start.
        starts: Different lenses handed on.
        curves: Longest curves that the search looks at …
        samples: … and samples on each of them.
    """

    tolerance: float = 1.0
    evaluations: int = 16
    starts: int = 2
    curves: int = 50
    samples: int = 8


def projection(strength: float, b: float, width: int, height: int) -> KannalaBrandt:
    """The Kannala–Brandt lens nearest to r = f sin(bθ)/b (f tan(|b|θ)/|b| for b < 0).

    Args:
        strength: f in half picture widths.
        b: Member of the family, −0.9 to 1.
        width: Picture width in pixels.
        height: Picture height in pixels.
    """
    reach = min(1.5, 1.2 * np.hypot(1, height / width) / strength)
    if b > 0:
        reach = min(reach, 0.95 * np.pi / 2 / b)
    if b < 0:
        reach = min(reach, 0.85 * np.pi / 2 / -b)
    theta = reach * _THETA
    straight = abs(b) < 1e-6
    curved = np.sin if b > 0 else np.tan
    radius = theta if straight else curved(b * theta) / b
    powers = theta[:, None] ** (2 * np.arange(1, 5) + 1)
    ratios = np.linalg.lstsq(powers, radius - theta, rcond=1e-8)[0]
    return KannalaBrandt.centred(strength * np.array([1.0, *ratios]), width, height)


def search(
    samples: CurveSamples,
    width: int,
    height: int,
    *,
    config: SearchConfig = SearchConfig(),
) -> list[KannalaBrandt]:
    """Lenses that make many curves straight, best first.

    A grid over strength and projection, then NLopt's BOBYQA from the best places over strength,
    projection and principal point.

    Args:
        samples: Points of the curves.
        width: Picture width in pixels.
        height: Picture height in pixels.
        config: How long to search.
    """
    few = samples.coarse(curves=config.curves, most=config.samples)
    cost = _Consensus(few, width, height, config.tolerance * width / 1280)
    grid = [
        (cost(np.array([np.log(f), b, 0.0, 0.0])), i, j)
        for i, f in enumerate(_STRENGTHS)
        for j, b in enumerate(_PROJECTIONS)
    ]
    chosen: list[tuple[int, int]] = []
    for _, i, j in sorted(grid):
        if all(abs(i - a) > 1 or abs(j - c) > 1 for a, c in chosen):
            chosen.append((i, j))
        if len(chosen) == config.starts:
            break
    refined = [
        _refine(cost, np.array([np.log(_STRENGTHS[i]), _PROJECTIONS[j], 0.0, 0.0]), config)
        for i, j in chosen
    ]
    return [cost.camera(x) for _, x in sorted(refined, key=lambda pair: pair[0])]


@dataclass(frozen=True)
class _Consensus:
    """Length-weighted share of curves that a lens leaves bent (Geman–McClure), plus a prior."""

    samples: CurveSamples
    width: int
    height: int
    tolerance: float

    def camera(self, x: np.ndarray) -> KannalaBrandt:
        lens = projection(float(np.exp(x[0])), float(x[1]), self.width, self.height)
        half = self.width / 2
        return KannalaBrandt(
            lens.k,
            lens.m_u,
            lens.m_v,
            lens.u0 + half * x[2],
            lens.v0 + half * x[3],
            self.width,
            self.height,
        )

    def __call__(self, x: Float[np.ndarray, " 4"]) -> float:
        camera = self.camera(x)
        result = straightness(camera, self.samples)
        residuals = np.where(result.reached, result.residuals, _BEYOND * self.tolerance)
        squared = (self.samples.curve_rms(residuals) / self.tolerance) ** 2
        lengths = self.samples.lengths
        bent = float((lengths * squared / (1 + squared)).sum() / lengths.sum())
        z = generic_prior(float(np.exp(x[0])), self.width, self.height).encode(camera)
        return bent + 0.002 * float(z @ z)


def _refine(
    cost: _Consensus, start: Float[np.ndarray, " 4"], config: SearchConfig
) -> tuple[float, np.ndarray]:
    optimizer = nlopt.opt(nlopt.LN_BOBYQA, 4)
    optimizer.set_min_objective(lambda x, _gradient: cost(x))
    optimizer.set_lower_bounds([np.log(0.25), -0.9, -0.25, -0.25])
    optimizer.set_upper_bounds([np.log(4.0), 1.0, 0.25, 0.25])
    optimizer.set_initial_step([0.15, 0.25, 0.04, 0.04])
    optimizer.set_maxeval(config.evaluations)
    optimizer.set_ftol_rel(1e-4)
    best = optimizer.optimize(start)
    return float(optimizer.last_optimum_value()), np.asarray(best)

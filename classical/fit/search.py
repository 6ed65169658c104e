"""A global start without a network: few numbers, searched widely.

The classical projections form one family, r = f sin(bθ)/b for b > 0, f θ for b = 0 and
f tan(|b|θ)/|b| for b < 0: orthographic at 1, equisolid at 1/2, equidistant at 0, stereographic at
−1/2 and perspective at −1. The division model is the stereographic member up to the scale
(tan θ)' = s tan θ, which no straight line can see, so the family covers it too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import nlopt
import numpy as np
from jaxtyping import Bool, Float

from classical.camera import KannalaBrandt
from classical.camera.ray_field import RayField, plane_radius
from classical.fit.circles import best_circles, sampson_distances
from classical.fit.prior import generic_surprise
from classical.fit.samples import CurveSamples
from classical.lines.curve import REFERENCE_WIDTH

_PROJECTIONS = (-0.5, 0.0, 0.5)
_STRENGTHS = np.geomspace(0.4, 2.0, 6)  # f in half widths; 2.2 bends nothing visibly
_THETA = np.linspace(0.02, 1.0, 48)  # of the widest angle, where the polynomial meets the family
_BEYOND = 20.0  # cost a sample of a lens that does not reach it
_EQUIDISTANT = 1e-6  # |b| up to which bθ is as good as sin bθ
_WIDEST_SINE = float(np.sin(0.95 * np.pi / 2))  # of bθ, before r(θ) turns


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
    half_turn = b * reach * _THETA
    if abs(b) < _EQUIDISTANT:
        off = np.zeros_like(_THETA)
    else:
        off = (np.sin if b > 0 else np.tan)(half_turn) / (b * reach) - _THETA
    ratios = _inverse_powers() @ off / reach ** (2 * np.arange(1, 5))
    return KannalaBrandt.centred(strength * np.array([1.0, *ratios]), width, height)


@cache
def _inverse_powers() -> np.ndarray:
    """The least-squares fit of θ³ … θ⁹ over `_THETA` as a matrix, shape (4, 48)."""
    return np.linalg.pinv(_THETA[:, None] ** (2 * np.arange(1, 5) + 1))


def family_field(
    plane: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]],
    strength: float,
    b: float,
    scale: float,
) -> tuple[RayField, Bool[np.ndarray, " n"]]:
    """Rays of the family's exact member, and where it reaches the pixel.

    Args:
        plane: Pixels off the principal point, over `scale`.
        strength: f in units of `scale`.
        b: Member of the family.
        scale: Pixels; half the picture's width.
    """
    radius = plane_radius(*plane)
    value = (abs(b) / strength) * radius
    if abs(b) < _EQUIDISTANT:
        theta = radius / strength
        slope = np.full(len(radius), 1 / strength)
        reached = theta <= np.pi
    elif b > 0:
        reached = value <= _WIDEST_SINE
        value = np.minimum(value, _WIDEST_SINE)
        theta = np.arcsin(value) / b
        slope = 1 / (strength * np.sqrt(1 - value * value))
    else:
        theta = np.arctan(value) / -b
        slope = 1 / (strength * (1 + value * value))
        reached = theta <= np.pi
    return RayField.of_angles(plane, radius, theta, slope, (scale, scale)), np.asarray(reached)


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
    cost = _Consensus(few, width, height, config.tolerance * width / REFERENCE_WIDTH)
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
        half, strength, b = self.width / 2, float(np.exp(x[0])), float(x[1])
        plane = (
            (self.samples.u - (self.width - 1) / 2) / half - x[2],
            (self.samples.v - (self.height - 1) / 2) / half - x[3],
        )
        field, reached = family_field(plane, strength, b, half)
        every = bool(reached.all())
        circles = best_circles(field, self.samples, None if every else reached * 1.0)
        residuals = sampson_distances(field, circles.normals, self.samples).distance
        if not every:
            residuals = np.where(reached, residuals, _BEYOND * self.tolerance)
        squared = (self.samples.curve_rms(residuals) / self.tolerance) ** 2
        lengths = self.samples.lengths
        bent = float((lengths * squared / (1 + squared)).sum() / lengths.sum())
        ratios = projection(strength, b, self.width, self.height).k[1:] / strength
        return bent + 0.002 * generic_surprise(ratios, x[2:])


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

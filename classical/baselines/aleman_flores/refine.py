"""Refinement of p alone (2014): a damped Newton method in one unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from classical.baselines.aleman_flores.config import AlemanFloresConfig
from classical.baselines.aleman_flores.energy import LineEnergy

LARGEST_DAMPING = 1e12
"""No step that lowers the energy is expected beyond this damping."""


@dataclass(frozen=True)
class Refined:
    """What a refinement reached.

    Attributes:
        p: (p) for 2014, (p1, p2) for 2016: relative growth of the radius at R, and at R / 2.
        centre: Centre of distortion, px.
        energy: Mean squared distance of the points to their lines, px², undistorted plane.
        steps: Newton steps tried.
        converged: True if the change fell under the tolerance before the steps ran out.
    """

    p: tuple[float, ...]
    centre: tuple[float, float]
    energy: float
    steps: int
    converged: bool


def coefficient(p: float, radius: float) -> float:
    """Distortion k = −p / (R² (1 + p)) of the normalised parameter p, 1/px²."""
    return -p / (radius**2 * (1.0 + p))


def refine_p(
    points: Float[np.ndarray, "n 2"],
    labels: Int[np.ndarray, " n"],
    p: float,
    centre: tuple[float, float],
    radius: float,
    *,
    config: AlemanFloresConfig,
) -> Refined:
    """Minimise E(p) by p ← p − E′ / (E″ + γ).

    Derivatives are central differences. A step that does not lower E is not taken and multiplies γ
    by ten; one that does divides it by ten.

    Args:
        points: Distorted edge points, px.
        labels: Line of each point, −1 for none.
        p: Where to start.
        centre: Centre of distortion, px.
        radius: Radius R at which p is defined, px.
        config: Parameters of the method.
    """
    total = LineEnergy(points, labels)

    def energy(at: float) -> float:
        return total(coefficient(at, radius), 0.0, centre) if at > -1.0 else np.inf

    h, damping, current = config.newton_step, config.newton_damping, energy(p)
    steps, converged = 0, False
    while steps < config.newton_rounds and not converged and damping < LARGEST_DAMPING:
        steps += 1
        above, below = energy(p + h), energy(p - h)
        slope, curvature = (above - below) / (2 * h), (above - 2 * current + below) / h**2
        step = slope / (curvature + damping)
        trial = energy(p - step)
        converged = abs(step) <= config.newton_tolerance * max(abs(p), config.newton_step)
        if trial < current:
            p, current, damping = p - step, trial, damping / 10
        else:
            damping *= 10
    return Refined((p,), centre, current / max(len(total), 1), steps, converged)

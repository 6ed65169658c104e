"""Refinement of (p1, p2) and the centre (2016): Newton with a damped, differenced Hessian."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from classical.baselines.aleman_flores.config import AlemanFloresConfig
from classical.baselines.aleman_flores.energy import LineEnergy
from classical.baselines.aleman_flores.refine import LARGEST_DAMPING, Refined
from classical.baselines.two_parameter import farthest_corner, is_invertible

Energy = Callable[[np.ndarray], float]


def coefficients(p1: float, p2: float, radius: float) -> tuple[float, float]:
    """(k1, k2) of which the radius grows by 1 + p1 at R and by 1 + p2 at R / 2."""
    outer, inner = 1.0 / (1.0 + p1) - 1.0, 1.0 / (1.0 + p2) - 1.0
    return (16.0 * inner - outer) / (3.0 * radius**2), (4.0 * outer - 16.0 * inner) / (
        3.0 * radius**4
    )


def growths(k1: float, k2: float, radius: float) -> tuple[float, float]:
    """(p1, p2) of (k1, k2): the inverse of `coefficients`."""
    squared = np.array([radius, radius / 2]) ** 2
    grown = 1.0 / (1.0 + k1 * squared + k2 * squared**2) - 1.0
    return float(grown[0]), float(grown[1])


def refine_two(
    points: Float[np.ndarray, "n 2"],
    labels: Int[np.ndarray, " n"],
    start: Refined,
    size: tuple[int, int],
    *,
    config: AlemanFloresConfig,
) -> Refined:
    """Minimise the energy over (p1, p2), then over these and the centre.

    A step is taken only if the energy falls and the model stays invertible up to the farthest
    corner; it divides γ by ten, another multiplies it by ten. A centre that moved by more than the
    share of the picture allowed is given up for the one before.

    Args:
        points: Distorted edge points, px.
        labels: Line of each point, −1 for none.
        start: Where to start: `p` holds (p1, p2).
        size: Width and height of the picture, px.
        config: Parameters of the method.
    """
    total = LineEnergy(points, labels)
    count = max(len(total), 1)

    def energy(q: np.ndarray) -> float:
        k1, k2, radius = _model(q, size)
        if not is_invertible(k1, k2, radius):
            return np.inf
        return total(k1, k2, (float(q[2]), float(q[3])))

    q = np.array([*start.p, *start.centre])
    q, current, steps, converged = _newton(energy, q, 2, config)
    freed, lower, more, freed_converged = _newton(energy, q, 4, config)
    moved = np.abs(freed[2:] - np.array(size) / 2)
    if lower < current and (moved <= config.centre_share * np.array(size)).all():
        q, current, converged = freed, lower, freed_converged
    p, centre = (float(q[0]), float(q[1])), (float(q[2]), float(q[3]))
    return Refined(p, centre, current / count, steps + more, converged)


def _model(q: np.ndarray, size: tuple[int, int]) -> tuple[float, float, float]:
    """(k1, k2, R) of (p1, p2, u0, v0)."""
    radius = farthest_corner(float(q[2]), float(q[3]), *size)
    if min(q[0], q[1]) <= -1.0:
        return np.inf, np.inf, radius
    return *coefficients(float(q[0]), float(q[1]), radius), radius


def _newton(
    energy: Energy, q: np.ndarray, free: int, config: AlemanFloresConfig
) -> tuple[np.ndarray, float, int, bool]:
    """Lower the energy over the first `free` parameters; returns where, how low, steps, done."""
    h = np.array([config.newton_step] * 2 + [config.newton_centre_step] * 2)[:free]
    current, damping = energy(q), config.newton_damping
    steps, converged, derivatives = 0, False, None
    while steps < config.newton_rounds and not converged and damping < LARGEST_DAMPING:
        steps += 1
        if derivatives is None:
            derivatives = _differences(energy, q, current, h)
        gradient, hessian = derivatives
        trial = q.copy()
        trial[:free] -= _solved(hessian + damping * np.eye(free), gradient)
        lower = energy(trial)
        if lower < current:
            converged = current - lower <= config.newton_tolerance * current
            q, current, damping, derivatives = trial, lower, damping / 10, None
        else:
            damping *= 10
    return q, current, steps, converged


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution of a symmetric system; the gradient itself, scaled, where it is not definite."""
    if not np.isfinite(matrix).all() or np.linalg.eigvalsh(matrix)[0] <= 0:
        return right / max(float(np.abs(matrix[np.isfinite(matrix)]).max(initial=1.0)), 1.0)
    return np.linalg.solve(matrix, right)


def _differences(
    energy: Energy, q: np.ndarray, current: float, h: Float[np.ndarray, " m"]
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient and Hessian by central differences (the mixed ones from two diagonal points)."""
    m = len(h)
    steps = np.zeros((m, len(q)))
    steps[np.arange(m), np.arange(m)] = h
    above = np.array([energy(q + s) for s in steps])
    below = np.array([energy(q - s) for s in steps])
    hessian = np.diag((above - 2 * current + below) / h**2)
    for i in range(m):
        for j in range(i):
            pair = energy(q + steps[i] + steps[j]) + energy(q - steps[i] - steps[j])
            single = above[i] + below[i] + above[j] + below[j]
            hessian[i, j] = hessian[j, i] = (pair - single + 2 * current) / (2 * h[i] * h[j])
    return (above - below) / (2 * h), hessian

"""Levenberg–Marquardt over λ, the centre and one line an arc, in the distorted picture.

A line n · x_u = ρ about the centre c is seen as λ ρ r² − n · (x − c) + ρ = 0, a circle with
B² + C² − 4 A D = 1 − 4 λ ρ²; the residual is the distance of an observed point to it. Each line has
its own two unknowns, so that the normal equations are an arrow: the lines are eliminated first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from classical.baselines.bukhari.config import BukhariConfig

_START_DAMPING = 1e-3
_LARGEST_DAMPING = 1e8
_LEAST_SIZE = 1e-9


@dataclass(frozen=True)
class Solution:
    """A refined distortion with the line of each arc.

    Attributes:
        distortion: (λ, x0, y0) in the units of the points.
        lines: (direction φ of the normal in radians, distance ρ to the centre), shape (m, 2).
        cost: Sum of squared distances, in the units of the points, squared.
        steps: Steps tried.
        converged: True if the change of the cost fell under the tolerance.
    """

    distortion: Float[np.ndarray, " 3"]
    lines: Float[np.ndarray, "m 2"]
    cost: float
    steps: int
    converged: bool


def refine(
    points: Float[np.ndarray, "n 2"],
    starts: np.ndarray,
    distortion: Float[np.ndarray, " 3"],
    *,
    config: BukhariConfig,
) -> Solution:
    """Minimise the squared distances of all points to the circles of their lines.

    Args:
        points: Points of all arcs, arc after arc.
        starts: Index of the first point of each arc, shape (m,).
        distortion: (λ, x0, y0) to start from.
        config: Parameters; a fixed centre leaves λ alone free.
    """
    free = 1 if config.centre == "fixed" else 3
    arc = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(points))))
    q, lines = distortion.copy(), _initial_lines(points, starts, arc, distortion)
    residual, shared, own = residuals(points, arc, q, lines)
    cost, damping = float(residual @ residual), _START_DAMPING
    steps, converged = 0, False
    while steps < config.newton_rounds and not converged and damping < _LARGEST_DAMPING:
        steps += 1
        step, line_steps = _solve_arrow(residual, shared[:, :free], own, starts, damping)
        trial, trial_lines = q.copy(), lines - line_steps
        trial[:free] -= step
        update = residuals(points, arc, trial, trial_lines)
        lower = float(update[0] @ update[0]) if np.isfinite(update[0]).all() else np.inf
        if lower < cost:
            converged = cost - lower <= config.tolerance * cost
            q, lines, cost, damping = trial, trial_lines, lower, damping / 10
            residual, shared, own = update
        else:
            damping *= 10
    return Solution(q, lines, cost, steps, converged or damping >= _LARGEST_DAMPING)


def residuals(
    points: Float[np.ndarray, "n 2"],
    arc: np.ndarray,
    distortion: Float[np.ndarray, " 3"],
    lines: Float[np.ndarray, "m 2"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 2"]]:
    """Signed distances to the predicted circles, and their derivatives.

    Returns:
        residual: Distances; NaN where a line has no image.
        shared: Derivatives by (λ, x0, y0).
        own: Derivatives by (φ, ρ) of the point's line.
    """
    lam, centre = distortion[0], distortion[1:]
    rho = lines[arc, 1]
    cosine, sine = np.cos(lines[:, 0])[arc], np.sin(lines[:, 0])[arc]
    x, y = (points - centre).T
    squared = x * x + y * y
    along, across = cosine * x + sine * y, cosine * y - sine * x
    inner = 1 - 4 * lam * rho**2
    size = np.sqrt(np.where(inner > _LEAST_SIZE, inner, np.nan))
    a, power = lam * rho / size, (lam * rho * squared - along + rho) / size
    root = np.sqrt(np.maximum(1 + 4 * a * power, 1e-12))
    distance = 2 * power / (1 + root)
    # d + A d² = P gives ∂d = (∂P − d² ∂A) / √(1 + 4 A P), with ∂(1/size) = −∂size / size².
    size_lam, size_rho = -2 * rho**2 / size, -4 * lam * rho / size
    shrink_lam, shrink_rho = size_lam / size, size_rho / size

    def through(power_part: np.ndarray, a_part: np.ndarray | float) -> np.ndarray:
        return (power_part - distance**2 * a_part) / root

    by_lam = through(rho * squared / size - power * shrink_lam, rho / size - a * shrink_lam)
    by_x = through((cosine - 2 * lam * rho * x) / size, 0.0)
    by_y = through((sine - 2 * lam * rho * y) / size, 0.0)
    by_phi = through(-across / size, 0.0)
    by_rho = through((lam * squared + 1) / size - power * shrink_rho, lam / size - a * shrink_rho)
    return distance, np.stack([by_lam, by_x, by_y], axis=1), np.stack([by_phi, by_rho], axis=1)


def _initial_lines(
    points: np.ndarray, starts: np.ndarray, arc: np.ndarray, distortion: np.ndarray
) -> np.ndarray:
    """Total least squares of the undistorted points of each arc."""
    offset = points - distortion[1:]
    factor = 1 + distortion[0] * (offset**2).sum(axis=1)
    moved = offset / np.maximum(factor, 1e-6)[:, None]
    sizes = np.diff(np.append(starts, len(points)))[:, None]
    mean = np.add.reduceat(moved, starts, axis=0) / sizes
    x, y = (moved - mean[arc]).T
    xx, xy, yy = (np.add.reduceat(v, starts) for v in (x * x, x * y, y * y))
    angle = 0.5 * np.arctan2(2 * xy, xx - yy) + np.pi / 2
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.stack([angle, (normal * mean).sum(axis=1)], axis=1)


def _solve_arrow(
    residual: np.ndarray,
    shared: np.ndarray,
    own: np.ndarray,
    starts: np.ndarray,
    damping: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Damped Gauss–Newton step of the shared unknowns and of every line."""
    right_own = np.add.reduceat(own * residual[:, None], starts, axis=0)
    block = np.add.reduceat(own[:, :, None] * own[:, None, :], starts, axis=0)
    cross = np.add.reduceat(shared[:, :, None] * own[:, None, :], starts, axis=0)
    block = _damped(block, damping)
    whole = _damped((shared.T @ shared)[None], damping)[0]
    solved = np.linalg.solve(block, cross.transpose(0, 2, 1))  # (m, 2, s)
    reduced = whole - np.einsum("msk,mkt->st", cross, solved)
    right = shared.T @ residual - np.einsum("mks,mk->s", solved, right_own)
    step = np.linalg.solve(reduced, right)
    remaining = right_own - np.einsum("msk,s->mk", cross, step)
    return step, np.linalg.solve(block, remaining[:, :, None])[:, :, 0]


def _damped(matrices: np.ndarray, damping: float) -> np.ndarray:
    diagonal = np.einsum("mii->mi", matrices)
    return matrices + np.eye(matrices.shape[1]) * (damping * diagonal + 1e-15)[:, None, :]

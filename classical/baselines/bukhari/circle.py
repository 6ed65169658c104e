"""Circles and lines in one form, A (x² + y²) + B x + C y + D = 0 with B² + C² − 4 A D = 1.

A straight line is A = 0, so nothing breaks on flat arcs. The signed distance of a point to the
circle is d = 2 P / (1 + √(1 + 4 A P)), P the left side (Pratt 1987; Chernov, "Circular and Linear
Regression", 2010).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

_STEPS = 30
_TOLERANCE = 1e-10


def normalised(circles: Float[np.ndarray, "m 4"]) -> tuple[np.ndarray, np.ndarray]:
    """Scale to B² + C² − 4 A D = 1; the mask is False where that cannot be."""
    a, b, c, d = circles.T
    squared = b**2 + c**2 - 4 * a * d
    valid = np.isfinite(squared) & (squared > 0)
    return circles / np.sqrt(np.where(valid, squared, 1.0))[:, None], np.asarray(valid)


def shifted(circles: Float[np.ndarray, "m 4"], by: Float[np.ndarray, " 2"]) -> np.ndarray:
    """The same circles after their origin moved: points p become p + by. The scale stays."""
    a, b, c, d = circles.T
    return np.stack(
        [
            a,
            b - 2 * a * by[0],
            c - 2 * a * by[1],
            d - b * by[0] - c * by[1] + a * (by[0] ** 2 + by[1] ** 2),
        ],
        axis=1,
    )


def distances(
    circles: Float[np.ndarray, "m 4"], points: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "m n"]:
    """Signed distance of each point to each circle."""
    x, y = points.T
    basis = np.stack([x * x + y * y, x, y, np.ones(len(x))])
    power = circles @ basis
    root = np.sqrt(np.maximum(1 + 4 * circles[:, :1] * power, 0.0))
    return 2 * power / (1 + root)


def circles_through(
    triples: Float[np.ndarray, "m 3 2"],
) -> tuple[Float[np.ndarray, "m 4"], Bool[np.ndarray, " m"]]:
    """Circle through three points, for many at once; False where points coincide."""
    first = triples[:, 0]
    (x2, y2), (x3, y3) = (triples[:, 1] - first).T, (triples[:, 2] - first).T
    s2, s3 = x2**2 + y2**2, x3**2 + y3**2
    a, b, c = x2 * y3 - x3 * y2, s3 * y2 - s2 * y3, s2 * x3 - s3 * x2
    u, v = first.T
    circles = np.stack([a, b - 2 * a * u, c - 2 * a * v, a * (u**2 + v**2) - b * u - c * v], axis=1)
    scale = np.hypot(b, c)  # √(B² + C² − 4 A D) about the first point, where D = 0
    valid = scale > 1e-9
    return circles / np.where(valid, scale, 1.0)[:, None], np.asarray(valid)


def fit_taubin(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " 4"]:
    """Algebraic fit of Taubin (PAMI 1991): nearly without bias on short arcs, unlike Kåsa's.

    Minimises Σ P² / Σ |∇P|², by singular values (Chernov 2010, section 5.10).
    """
    mean = points.mean(axis=0)
    centred = points - mean
    spread = np.sqrt((centred**2).sum(axis=1).mean()) or 1.0
    centred = centred / spread
    squared = (centred**2).sum(axis=1)
    level = squared.mean()
    scaled = (squared - level) / (2 * np.sqrt(level))
    v = np.linalg.svd(np.column_stack([scaled, centred]), full_matrices=False)[2][-1]
    a = v[0] / (2 * np.sqrt(level))
    circle = np.array([a / spread**2, v[1] / spread, v[2] / spread, -level * a])
    return normalised(shifted(circle[None], mean))[0][0]


def fit_geometric(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " 4"]:
    """Least squares of the distances, by Levenberg–Marquardt from the fit of Taubin.

    The unknowns are A, D and the direction of (B, C), as in Chernov & Lesort (2005), with the
    points centred, so that the fit passes through A = 0 without harm.
    """
    mean = points.mean(axis=0)
    centred = points - mean
    spread = np.sqrt((centred**2).sum(axis=1).mean()) or 1.0
    x, y = (centred / spread).T
    a, b, c, d = fit_taubin(np.stack([x, y], axis=1))
    q = np.array([a, d, np.arctan2(c, b)])
    residual, jacobian = _distances_and_jacobian(q, x, y)
    cost, damping = residual @ residual, 1e-3
    for _ in range(_STEPS):
        normal = jacobian.T @ jacobian
        step = np.linalg.solve(
            normal + damping * np.diag(np.diag(normal) + 1e-12), jacobian.T @ residual
        )
        trial = q - step
        if 1 + 4 * trial[0] * trial[1] > 1e-9:
            residual_t, jacobian_t = _distances_and_jacobian(trial, x, y)
            cost_t = residual_t @ residual_t
            if cost_t <= cost:
                done = cost - cost_t <= _TOLERANCE * cost
                q, residual, jacobian, cost = trial, residual_t, jacobian_t, cost_t
                damping /= 10
                if done:
                    break
                continue
        damping *= 10
        if damping > 1e8:
            break
    size = np.sqrt(1 + 4 * q[0] * q[1])
    circle = np.array(
        [
            q[0] / spread**2,
            size * np.cos(q[2]) / spread,
            size * np.sin(q[2]) / spread,
            q[1],
        ]
    )
    return normalised(shifted(circle[None], mean))[0][0]


def _distances_and_jacobian(
    q: np.ndarray, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Signed distances and their derivatives by (A, D, direction), from P = d + A d²."""
    a, d, angle = q
    size = np.sqrt(1 + 4 * a * d)
    along = np.cos(angle) * x + np.sin(angle) * y
    across = np.cos(angle) * y - np.sin(angle) * x
    squared = x * x + y * y
    power = a * squared + size * along + d
    root = np.sqrt(np.maximum(1 + 4 * a * power, 1e-12))
    distance = 2 * power / (1 + root)
    jacobian = np.stack(
        [
            squared + (2 * d / size) * along - distance**2,
            1 + (2 * a / size) * along,
            size * across,
        ],
        axis=1,
    )
    return distance, jacobian / root[:, None]

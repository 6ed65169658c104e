"""Absolute scale from orthogonal vanishing points.

Straight lines stay straight under (tan θ)' = s tan θ, so they leave s open. In man-made scenes most
lines run along three orthogonal directions. Each line's great-circle normal n is orthogonal to its
direction d; under s a normal becomes n' ∝ (n_x, n_y, s n_z) and the frame of three directions fits
best where s is right. For two directions v1, v2 of a first solution, orthogonal in the scene,
s² = −v1z v2z / (v1x v2x + v1y v2y) in the sense (x, y, z) → (x, y, z / s); here all lines vote.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from classical.camera import KannalaBrandt, radial_coefficients

_HYPOTHESES = 160  # frames tried for each s
_REFINEMENTS = 3
_LEAST_DEVIATION = 0.03  # of log s: scenes are never quite orthogonal
_LEAST_ANGLE = np.radians(15.0)  # between normals that may define a direction


@dataclass(frozen=True)
class VanishingConfig:
    """The search for the scale.

    Attributes:
        scales: Smallest and largest s.
        steps: Values of s tried in between, evenly in log s.
        tolerance: Angle between a line and its direction beyond which it does not vote, radians.
        most_lines: Longest lines that vote.
        fewest_lines: Lines that the frame needs, and a third of it for its second direction.
        seed: Of the random frames.
    """

    scales: tuple[float, float] = (0.6, 1.7)
    steps: int = 19
    tolerance: float = 0.03
    most_lines: int = 80
    fewest_lines: int = 12
    seed: int = 0


@dataclass(frozen=True)
class ScaleEstimate:
    """The scale that makes the scene's directions orthogonal.

    Attributes:
        log_scale: log s; the rectified plane grows by s.
        deviation: Standard deviation of log s.
        frame: Three orthogonal directions as rows, under the scaled camera, shape (3, 3).
        support: Lines that follow each direction, the most first, shape (3,).
    """

    log_scale: float
    deviation: float
    frame: Float[np.ndarray, "3 3"]
    support: Float[np.ndarray, " 3"]


def scale_from_directions(
    normals: Float[np.ndarray, "n 3"],
    weights: Float[np.ndarray, " n"],
    deviations: Float[np.ndarray, " n"],
    *,
    rng: np.random.Generator,
    config: VanishingConfig = VanishingConfig(),
) -> ScaleEstimate | None:
    """Find s such that the lines fall into three orthogonal directions.

    Args:
        normals: Unit normals of the lines' great circles under the present camera, shape (n, 3).
        weights: How much each line may vote, shape (n,).
        deviations: Standard deviation of each normal, radians, shape (n,).
        rng: For the random frames; the same for every s, so that s alone decides.
        config: How to search.

    Returns:
        The estimate, or None where too few lines agree on two directions or s stays open.
    """
    if len(normals) < config.fewest_lines:
        return None
    triples = _draw(normals, weights, rng)
    least, most = np.log(config.scales)
    grid = np.linspace(least, most, config.steps)
    tolerance = np.hypot(config.tolerance, deviations)
    moved = _scaled(normals, np.exp(grid))
    frames = np.stack([_best_frame(lines, weights, tolerance, triples) for lines in moved])
    for _ in range(_REFINEMENTS):
        frames = _refined(moved, weights, tolerance, frames)
    score = _votes(moved, weights, tolerance, frames[:, None])[:, 0]
    best = int(np.argmax(score))
    if best in (0, len(grid) - 1):
        return None
    log_scale, deviation = _peak(grid, score, best, float((weights**2).sum() / weights.sum()))
    support = _support(moved[best], tolerance, frames[best])
    enough = support.sum() >= config.fewest_lines and support[1] >= config.fewest_lines / 3
    if not enough or not np.isfinite(deviation):
        return None
    return ScaleEstimate(log_scale, deviation, frames[best], support)


def rescaled(camera: KannalaBrandt, scale: float) -> KannalaBrandt:
    """The camera of (tan θ)' = s tan θ, as near as five coefficients come: r'(θ') = r(θ).

    Angles past 90° turn with the half angle: θ' = atan2(s sin θ, cos θ).
    """
    corners = np.array([[0.0, 0.0], [camera.width - 1.0, camera.height - 1.0]])
    rays, _ = camera.unproject(corners)
    widest = min(float(np.arccos(np.clip(rays[:, 2].min(), -1, 1))), camera.theta_max)
    theta = np.linspace(0.02, 1.0, 64) * widest
    moved = np.arctan2(scale * np.sin(theta), np.cos(theta))
    vector = camera.to_vector()
    vector[:5] = radial_coefficients(moved, camera.radius(theta))
    return KannalaBrandt.from_vector(vector, camera.width, camera.height)


def _scaled(
    normals: Float[np.ndarray, "n 3"], scales: Float[np.ndarray, " s"]
) -> Float[np.ndarray, "s n 3"]:
    """Normals of the circles after rays (x, y, z) became (x, y, z / s), for each s."""
    moved = np.repeat(normals[None], len(scales), axis=0)
    moved[:, :, 2] *= scales[:, None]
    return moved / np.linalg.norm(moved, axis=-1, keepdims=True)


def _draw(normals: np.ndarray, weights: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Triples of lines: two meet in the first direction, the third holds the second."""
    chance = weights / weights.sum()
    triples = rng.choice(len(normals), size=(4 * _HYPOTHESES, 3), p=chance)
    first, second = normals[triples[:, 0]], normals[triples[:, 1]]
    apart = np.linalg.norm(np.cross(first, second), axis=1) > np.sin(_LEAST_ANGLE) / 4
    distinct = (triples[:, 2] != triples[:, 0]) & (triples[:, 2] != triples[:, 1])
    return triples[apart & distinct][:_HYPOTHESES]


def _best_frame(
    lines: np.ndarray, weights: np.ndarray, tolerance: np.ndarray, triples: np.ndarray
) -> Float[np.ndarray, "3 3"]:
    """The frame of most votes among those that triples of lines span, for one s."""
    first, second, third = (lines[column] for column in triples.T)
    v1 = _unit(_cross(first, second))
    v2 = _unit(_cross(v1, third))
    frames = np.stack([v1, v2, _cross(v1, v2)], axis=1)
    return frames[int(np.argmax(_votes(lines, weights, tolerance, frames)))]


def _votes(
    lines: Float[np.ndarray, "*s n 3"],
    weights: Float[np.ndarray, " n"],
    tolerance: Float[np.ndarray, " n"],
    frames: Float[np.ndarray, "*s f 3 3"],
) -> Float[np.ndarray, "*s f"]:
    """Geman–McClure votes of all lines for each frame: Σ w / (1 + off²)²."""
    across = lines.swapaxes(-1, -2) / tolerance
    off = np.matmul(frames[..., 0, :], across)
    off *= off
    for axis in (1, 2):
        other = np.matmul(frames[..., axis, :], across)
        other *= other
        np.minimum(off, other, out=off)
    off += 1.0
    off *= off
    np.reciprocal(off, out=off)
    return off @ weights


def _refined(
    lines: Float[np.ndarray, "s n 3"],
    weights: Float[np.ndarray, " n"],
    tolerance: Float[np.ndarray, " n"],
    frames: Float[np.ndarray, "s 3 3"],
) -> Float[np.ndarray, "s 3 3"]:
    """One re-weighted step: each direction from its lines, then the nearest rotation."""
    products = np.abs(np.matmul(frames, lines.swapaxes(-1, -2)))
    nearest = products.argmin(axis=1)[:, None]
    off = products.min(axis=1) / tolerance
    pull = weights / (1 + off**2) ** 3 / tolerance**2
    mine = nearest == np.arange(3)[:, None]
    weighted = (mine * pull[:, None])[..., None] * lines[:, None]  # (s, 3, n, 3)
    values, vectors = np.linalg.eigh(np.matmul(lines.swapaxes(-1, -2)[:, None], weighted))
    rows = vectors[..., 0]
    rows = rows * np.where((rows * frames).sum(axis=-1, keepdims=True) < 0, -1.0, 1.0)
    known = mine.sum(axis=-1) >= 2
    rows = np.where(known[..., None], rows, frames)
    strength = np.where(known, values[..., 1], 0.0)
    strength += 1e-3 * strength.max(axis=1, keepdims=True) + 1e-9
    u, _, vt = np.linalg.svd((rows * strength[..., None]).swapaxes(-1, -2))
    vt[np.linalg.det(u) * np.linalg.det(vt) < 0, 2] *= -1.0
    return np.matmul(u, vt).swapaxes(-1, -2)


def _support(
    lines: Float[np.ndarray, "n 3"],
    tolerance: Float[np.ndarray, " n"],
    frame: Float[np.ndarray, "3 3"],
) -> Float[np.ndarray, " 3"]:
    off = np.abs(frame @ lines.T)
    owner, near = off.argmin(axis=0), off.min(axis=0) < tolerance
    return np.sort(np.bincount(owner[near], minlength=3))[::-1].astype(np.float64)


def _cross(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """`np.cross` without its overhead."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def _unit(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    length = np.sqrt((vectors * vectors).sum(axis=1, keepdims=True))
    return vectors / np.maximum(length, 1e-12)


def _peak(grid: np.ndarray, score: np.ndarray, best: int, unit: float) -> tuple[float, float]:
    """Position and width of the score's peak.

    The votes are read as a log likelihood in units of one line's weight; the width is where they
    have fallen by half a unit, which also tells a flat or a double peak from a sharp one.
    """
    likely = np.exp((score - score[best]) / unit)
    likely /= likely.sum()
    mean = float((likely * grid).sum())
    deviation = float(np.sqrt((likely * (grid - mean) ** 2).sum()))
    near = np.abs(grid - grid[best]) <= 2.5 * (grid[1] - grid[0])
    a, b, _ = np.polyfit(grid[near] - grid[best], score[near], 2)
    top = float(np.clip(-b / (2 * a), -0.03, 0.03)) if a < 0 else 0.0
    return float(grid[best]) + top, max(deviation, _LEAST_DEVIATION)

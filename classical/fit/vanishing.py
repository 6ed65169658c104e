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
    """

    scales: tuple[float, float] = (0.6, 1.7)
    steps: int = 19
    tolerance: float = 0.03
    most_lines: int = 80
    fewest_lines: int = 12


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
    votes, frames = zip(
        *(_best_frame(normals, weights, tolerance, triples, float(np.exp(g))) for g in grid),
        strict=True,
    )
    score = np.array(votes)
    best = int(np.argmax(score))
    if best in (0, len(grid) - 1):
        return None
    log_scale, deviation = _peak(grid, score, best, float((weights**2).sum() / weights.sum()))
    support = _support(normals, tolerance, frames[best], float(np.exp(grid[best])))
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


def _scaled(normals: np.ndarray, scale: float) -> np.ndarray:
    """Normals of the circles after rays (x, y, z) became (s x, s y, z)."""
    moved = normals * [1.0, 1.0, scale]
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
    normals: np.ndarray, weights: np.ndarray, tolerance: np.ndarray, triples: np.ndarray, s: float
) -> tuple[float, np.ndarray]:
    """Vote of the best frame for one s, refined on the lines that follow it."""
    moved = _scaled(normals, s)
    v1 = np.cross(moved[triples[:, 0]], moved[triples[:, 1]])
    v1 /= np.maximum(np.linalg.norm(v1, axis=1, keepdims=True), 1e-12)
    v2 = np.cross(v1, moved[triples[:, 2]])
    v2 /= np.maximum(np.linalg.norm(v2, axis=1, keepdims=True), 1e-12)
    frames = np.stack([v1, v2, np.cross(v1, v2)], axis=1)
    votes = _votes(moved, weights, tolerance, frames)
    frame = frames[int(np.argmax(votes))]
    for _ in range(3):
        frame = _refined(moved, weights, tolerance, frame)
    return float(_votes(moved, weights, tolerance, frame[None])[0]), frame


def _votes(
    moved: np.ndarray, weights: np.ndarray, tolerance: np.ndarray, frames: np.ndarray
) -> np.ndarray:
    """Geman–McClure votes of all lines for each frame, shape (frames,)."""
    off = np.abs(np.einsum("fai,ni->fan", frames, moved)).min(axis=1) / tolerance
    return (weights / (1 + off**2) ** 2).sum(axis=1)


def _refined(
    moved: np.ndarray, weights: np.ndarray, tolerance: np.ndarray, frame: np.ndarray
) -> np.ndarray:
    """One re-weighted step: each direction from its lines, then the nearest rotation."""
    products = frame @ moved.T
    owner = np.abs(products).argmin(axis=0)
    off = np.abs(products).min(axis=0) / tolerance
    pull = weights / (1 + off**2) ** 3 / tolerance**2
    rows, strength = frame.copy(), np.zeros(3)
    for axis in range(3):
        mine = owner == axis
        if mine.sum() >= 2:
            scatter = (moved[mine] * pull[mine, None]).T @ moved[mine]
            values, vectors = np.linalg.eigh(scatter)
            row = vectors[:, 0]
            rows[axis] = row * np.sign(row @ frame[axis] or 1.0)
            strength[axis] = values[1]
    u, _, vt = np.linalg.svd((rows * (strength[:, None] + 1e-3 * strength.max() + 1e-9)).T)
    rotation = (u @ vt).T
    return rotation if np.linalg.det(rotation) > 0 else (u @ np.diag([1, 1, -1.0]) @ vt).T


def _support(normals: np.ndarray, tolerance: np.ndarray, frame: np.ndarray, s: float) -> np.ndarray:
    off = np.abs(frame @ _scaled(normals, s).T)
    owner, near = off.argmin(axis=0), off.min(axis=0) < tolerance
    return np.sort(np.bincount(owner[near], minlength=3))[::-1].astype(np.float64)


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

"""Parallel lines meet: the great circles of lines of one direction d all pass through d.

Their normals are then orthogonal to it, n_c·d = 0. A short line hardly shows a bend, but it shows
where it points; seen together, parallel lines far from one another hold a lens that bends alone
leave loose, its principal point above all. The directions are whatever the picture shows, at right
angles or not, and, like the normals, functions of the lens: variable projection again, so that

    ∂(n_c·d) = d·∂n_c, freed of what a turn of d takes up (Kaufman 1975).

Concurrent lines stay concurrent under (tan θ)' = s tan θ, so nothing here tells the scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

_LEAST_SHARE = 0.25  # weight below which a curve is no line to look for directions with
_LEAST_ANGLE = 0.06  # radians between the normals of two lines that propose a direction
_REFINEMENTS = 4


@dataclass(frozen=True)
class ParallelsConfig:
    """The search for directions, and how sure their lines are.

    Attributes:
        tolerances: Angle between a line and its direction beyond which it is not one of its lines,
            radians; one per round of the fit.
        deviation: Standard deviation of that angle for lines built to be parallel, radians.
        tilt: A line may point as much aside as this multiple of its bow's deviation, at its ends.
        most_directions: In each picture.
        fewest_lines: Of a direction.
        max_curves: Longest curves used in each picture.
        hypotheses: Pairs of lines tried for each direction.
        seed: Of these pairs.
    """

    tolerances: tuple[float, ...] = (0.045, 0.02, 0.02)
    deviation: float = 0.008
    tilt: float = 3.0
    most_directions: int = 5
    fewest_lines: int = 6
    max_curves: int = 240
    hypotheses: int = 400
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Parallels:
    """Groups of lines that point in one direction each.

    Attributes:
        groups: Indices of each direction's curves, shape (lines,) each.
        weights: One over the standard deviation of n_c·d for each of these, times the root of the
            curve's share.
    """

    groups: Sequence[Int[np.ndarray, "..."]]
    weights: Sequence[Float[np.ndarray, "..."]]

    def residuals(self, normals: Float[np.ndarray, "curves 3"]) -> Float[np.ndarray, " all"]:
        """n_c·d in standard deviations, direction by direction."""
        found = [np.zeros(0)]
        for lines in self._weighted(normals):
            found.append(lines @ _axes(lines)[:, 0])
        return np.concatenate(found)

    def jacobian(
        self,
        normals: Float[np.ndarray, "curves 3"],
        derivatives: Float[np.ndarray, "3 p curves"],
    ) -> Float[np.ndarray, "all p"]:
        """Derivatives of the residuals by what `derivatives` of the normals are by."""
        found = [np.zeros((0, derivatives.shape[1]))]
        weighted = self._weighted(normals)
        for index, weight, lines in zip(self.groups, self.weights, weighted, strict=True):
            vectors = _axes(lines)
            held = np.einsum("i,ipc->cp", vectors[:, 0], derivatives[:, :, index])
            held *= weight[:, None]
            turns = np.linalg.qr(lines @ vectors[:, 1:])[0]
            found.append(held - turns @ (turns.T @ held))
        return np.concatenate(found)

    def _weighted(self, normals: np.ndarray) -> list[np.ndarray]:
        pairs = zip(self.groups, self.weights, strict=True)
        return [weight[:, None] * normals[index] for index, weight in pairs]


def find_parallels(
    normals: Float[np.ndarray, "curves 3"],
    lengths: Float[np.ndarray, " curves"],
    shares: Float[np.ndarray, " curves"],
    tilts: Float[np.ndarray, " curves"],
    pictures: Int[np.ndarray, " curves"],
    *,
    tolerance: float,
    config: ParallelsConfig,
) -> Parallels:
    """Find the directions of each picture, the one of most lines first.

    Pictures of one lens tend to show one scene, whose lines err alike in all of them: together
    their directions count for no more than those of one picture.

    Args:
        normals: Unit normals of the curves' great circles.
        lengths: Of the curves, pixels.
        shares: Weight of each curve, 0 to 1.
        tilts: Standard deviation of where each points, radians.
        pictures: Which picture each lies in; pictures share no direction.
        tolerance: As in `ParallelsConfig.tolerances`.
        config: The search.
    """
    rng = np.random.default_rng(config.seed)
    numbers = np.unique(pictures)
    votes = np.where(shares >= _LEAST_SHARE, np.sqrt(lengths / lengths.max()) * shares, 0.0)
    off = np.hypot(tolerance, tilts)
    groups = [
        group
        for picture in numbers
        for group in _groups(normals, votes * (pictures == picture), off, rng, config)
    ]
    deviations = np.hypot(config.deviation, tilts) * np.sqrt(len(numbers))
    return Parallels(groups, [np.sqrt(shares[group]) / deviations[group] for group in groups])


def _groups(
    normals: np.ndarray,
    votes: np.ndarray,
    off: np.ndarray,
    rng: np.random.Generator,
    config: ParallelsConfig,
) -> list[np.ndarray]:
    """One direction after another, each of the lines that those before have left."""
    left = np.flatnonzero(votes)
    groups = []
    while len(groups) < config.most_directions and len(left) >= config.fewest_lines:
        lines, weights, limits = normals[left], votes[left], off[left]
        direction = _direction(lines, weights, limits, rng, config.hypotheses)
        if direction is None:
            break
        mine = np.abs(lines @ direction) < limits
        if mine.sum() < config.fewest_lines:
            break
        groups.append(left[mine])
        left = left[~mine]
    return groups


def _direction(
    lines: np.ndarray,
    weights: np.ndarray,
    limits: np.ndarray,
    rng: np.random.Generator,
    hypotheses: int,
) -> np.ndarray | None:
    """The direction of most Geman–McClure votes among those that pairs of lines propose."""
    pairs = rng.choice(len(lines), size=(hypotheses, 2), p=weights / weights.sum())
    proposed = np.cross(lines[pairs[:, 0]], lines[pairs[:, 1]])
    lengths = np.linalg.norm(proposed, axis=1)
    apart = lengths > _LEAST_ANGLE
    if not apart.any():
        return None
    proposed = proposed[apart] / lengths[apart, None]
    votes = (1 / (1 + (proposed @ lines.T / limits) ** 2) ** 2) @ weights
    best = proposed[int(np.argmax(votes))]
    for _ in range(_REFINEMENTS):
        pull = weights / (1 + (lines @ best / limits) ** 2) ** 3 / limits**2
        best = _axes(np.sqrt(pull)[:, None] * lines)[:, 0]
    return best


def _axes(lines: np.ndarray) -> np.ndarray:
    """Eigenvectors of Σ n nᵀ as columns: first what is most orthogonal to all the normals."""
    return np.linalg.eigh(lines.T @ lines)[1]

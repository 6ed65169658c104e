"""The Hough space (distance, angle, p), one slice of constant p after another.

Exactly the voting of the articles, arranged for speed: a point votes once for each angle, in whole
numbers, and the five distance bins of weight 1 / (1 + |n|), n = −2 … 2, are summed afterwards where
a maximum is possible. Only one slice a worker is in memory at a time. A first look at every fifth
angle tells which slices can be the best. Of 56 searches (drawn, photographed, bent and straight
pictures, both variants) one went to another slice than a search of all in full: 0.5 for 0.8, in a
straight photograph where both are wrong.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from classical.baselines.aleman_flores.config import AlemanFloresConfig

SCORE_UNIT = 6
"""Slices hold six times the score, so that 1, 1/2 and 1/3 are whole numbers."""

_BLOCK_BINS = 1 << 16  # bins worked on together, so that they stay in the cache
_FIRST_BAND, _BAND = 0.9, 0.75  # where bands of candidates end, relative to the last pick and band
_MARGIN = 6  # empty distance bins at each side of a slice

Picked = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Maxima of a slice: angles or rows, distances or columns, and scores."""


@dataclass(frozen=True)
class HoughMaxima:
    """Maxima of the best slice, in the order in which they were picked.

    A line is cos(angle) x + sin(angle) y = distance in the undistorted plane about the centre.

    Attributes:
        p: Normalised distortion of the slice.
        angles: Angle of the normal, radians in [0, π), shape (m,).
        distances: Distance to the centre with its sign, px, shape (m,).
        scores: Votes, shape (m,).
        slice_p: Values of p searched at every angle, shape (s,).
        slice_scores: Sum of the picked maxima in each slice, shape (s,).
    """

    p: float
    angles: Float[np.ndarray, " m"]
    distances: Float[np.ndarray, " m"]
    scores: Float[np.ndarray, " m"]
    slice_p: Float[np.ndarray, " s"]
    slice_scores: Float[np.ndarray, " s"]


def hough_search(
    points: Float[np.ndarray, "n 2"],
    normals: Float[np.ndarray, "n 2"],
    radius: float,
    p_values: Float[np.ndarray, " s"],
    *,
    config: AlemanFloresConfig,
) -> HoughMaxima:
    """Find the slice whose picked maxima have the largest sum; the first one on ties.

    Lines farther from the centre than `distance_range` times the radius are not looked for.

    Args:
        points: Edge points relative to the centre of distortion, px.
        normals: Unit normals of the edges at the points.
        radius: Half the diagonal R, at which p is defined: k = −p / (R² (1 + p)).
        p_values: Slices to search.
        config: Parameters of the method.
    """
    if not len(p_values):
        raise ValueError("Expected at least one value of p, got none.")

    coarse = config.coarse_angles
    if len(p_values) > 1 and coarse > 1 and config.n_angles % coarse == 0:
        look = replace(config, angle_step_deg=config.angle_step_deg * coarse)
        slices = _search(points, normals, radius, p_values, look)
        scores = np.array([picked[2].sum() for picked in slices])
        promising = scores >= (1.0 - config.coarse_margin) * scores.max()
        best = int(np.argmax(scores))
        # The sharpest peaks fall between the angles: at the true p, above all if that is 0.
        promising[max(best - 1, 0) : best + 2] = True
        promising |= p_values == 0.0
        p_values = p_values[promising]
    slices = _search(points, normals, radius, p_values, config)
    scores = np.array([picked[2].sum() for picked in slices])
    best = int(np.argmax(scores))  # the first one on ties
    return HoughMaxima(
        float(p_values[best]), *slices[best], np.asarray(p_values, np.float64), scores
    )


def _search(
    points: np.ndarray,
    normals: np.ndarray,
    radius: float,
    p_values: np.ndarray,
    config: AlemanFloresConfig,
) -> list[Picked]:
    """The picked maxima of each slice, slices shared out among the workers."""
    farthest = config.distance_range * radius

    def search(worker: int) -> list[Picked]:
        accumulator = _Accumulator(config)
        return [
            accumulator.maxima(
                *undistort_edges(points, normals, -p / (radius**2 * (1 + p))), farthest
            )
            for p in p_values[worker::workers]
        ]

    workers = min(config.workers, len(p_values))
    if workers == 1:
        return search(0)
    with ThreadPoolExecutor(workers) as pool:
        shares = list(pool.map(search, range(workers)))
    return [shares[i % workers][i // workers] for i in range(len(p_values))]


def undistort_edges(
    points: Float[np.ndarray, "n 2"],
    normals: Float[np.ndarray, "n 2"],
    k1: float,
    k2: float = 0.0,
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Move points by x / (1 + k1 r² + k2 r⁴) and carry their normals along.

    The tangent t becomes J t with J = s I − s² (2 k1 + 4 k2 r²) x xᵀ, s the factor of the point;
    the normal stays at right angles to it, on the same side.
    """
    x, y = np.ascontiguousarray(points.T)
    normal_x, normal_y = np.ascontiguousarray(normals.T)
    squared = x * x + y * y
    scale = 1.0 / (1.0 + squared * (k1 + k2 * squared))
    radial = scale * (2.0 * k1 + 4.0 * k2 * squared) * (y * normal_x - x * normal_y)
    tangent_x, tangent_y = -normal_y - x * radial, normal_x - y * radial  # J t / s
    length = np.maximum(np.sqrt(tangent_x**2 + tangent_y**2), 1e-12)
    moved = np.stack([x * scale, y * scale])
    return moved.T, np.stack([tangent_y / length, -tangent_x / length]).T


class _Accumulator:
    """One slice of the Hough space, its memory used again for each p."""

    def __init__(self, config: AlemanFloresConfig) -> None:
        self.config = config
        self.step = np.deg2rad(config.angle_step_deg)
        self.footprint = _footprint(config)
        self.angles = np.arange(config.n_angles) * self.step
        self.votes = np.zeros(0, np.uint16)
        self.scores = np.zeros(0, np.uint16)
        self.used = np.zeros(0, bool)
        self.last_pick = 0  # where the search for candidates of the next slice begins

    def maxima(self, points: np.ndarray, normals: np.ndarray, farthest: float) -> Picked:
        """The picked maxima of the slice of these points, none beyond the farthest distance."""
        reached = np.sqrt((points**2).sum(axis=1).max(initial=0.0))
        centre = int(min(reached, farthest)) + 1 + _MARGIN
        picked = self._pick(self._fold(self._vote(points, normals, centre)))
        rows, columns, values = np.array(picked, np.int64).reshape(-1, 3).T
        self.last_pick = int(values[-1]) if len(values) else 0
        return rows * self.step, (columns - centre).astype(np.float64), values / SCORE_UNIT

    def _vote(self, points: np.ndarray, normals: np.ndarray, centre: int) -> np.ndarray:
        """Count votes; rows are angles from −reach to 180° + reach, columns are distances."""
        config, reach = self.config, self.config.angle_reach
        n_rows, n_columns = config.n_angles + 2 * reach, 2 * centre + 1
        if self.votes.size < n_rows * n_columns:
            self.votes = np.zeros(n_rows * n_columns, np.uint16)
        votes = self.votes[: n_rows * n_columns]
        votes.fill(0)
        angle = np.arctan2(normals[:, 1], normals[:, 0])
        row = np.rint(angle / self.step).astype(np.intp) % config.n_angles
        order = np.argsort(
            row.astype(np.uint16), kind="stable"
        )  # near in memory, one after another
        row, x, y = row[order], points[:, 0][order], points[:, 1][order]
        cosine, sine = np.cos(self.angles)[row], np.sin(self.angles)[row]
        across, along = x * cosine + y * sine, y * cosine - x * sine
        # Flat bin (row + j) * columns + centre + round(across cos jδ + along sin jδ) as a product.
        base = row * n_columns + centre + 0.5
        left = np.stack([across, along, base, np.ones(len(row))], axis=1)
        turn = np.arange(2 * reach + 1)
        delta = (turn - reach) * self.step
        right = np.stack([np.cos(delta), np.sin(delta), np.ones(len(turn)), turn * n_columns])
        end = centre - _MARGIN + 1.0  # votes from here on are gathered here, then dropped
        within = across**2 + along**2 < end**2
        self._count(votes, left[within], right, None)
        self._count(votes, left[~within], right, end)
        table = votes.reshape(n_rows, n_columns)
        table[:, [_MARGIN - 1, -_MARGIN]] = 0
        return table

    def _count(
        self, votes: np.ndarray, left: np.ndarray, right: np.ndarray, end: float | None
    ) -> None:
        """Count the flat bins of a product; with `end` the distances in it stop there."""
        n_turns = right.shape[1]
        block = max(_BLOCK_BINS // n_turns, 1)
        product, bins = np.empty((block, n_turns)), np.empty((block, n_turns), np.intp)
        whole = np.empty((block, n_turns), np.int32)  # on the way: twice as fast as to intp at once
        one = np.uint16(1)
        for start in range(0, len(left), block):
            part = left[start : start + block]
            flat, index = product[: len(part)], bins[: len(part)]
            if end is None:
                np.matmul(part, right, out=flat)
            else:
                np.matmul(part[:, :2], right[:2], out=flat)
                np.clip(flat, -end, end, out=flat)
                flat += part[:, 2:3]
                flat += right[3]
            np.copyto(whole[: len(part)], flat, casting="unsafe")  # positive: this rounds down
            np.copyto(index, whole[: len(part)])
            np.add.at(votes, index.ravel(), one)

    def _fold(self, votes: np.ndarray) -> np.ndarray:
        """Add rows outside [0°, 180°) where they belong: 180° further on and mirrored."""
        reach, n_angles = self.config.angle_reach, self.config.n_angles
        inside = votes[reach : reach + n_angles]
        inside[n_angles - reach :] += votes[:reach, ::-1]
        inside[:reach] += votes[reach + n_angles :, ::-1]
        return inside

    def _pick(self, votes: np.ndarray) -> list[tuple[int, int, int]]:
        """Row, column and score of the largest local maxima, each clearing its neighbourhood."""
        if self.scores.size < votes.size:
            self.scores = np.zeros(votes.size, np.uint16)
        scores = self.scores[: votes.size].reshape(votes.shape)
        _score(votes.reshape(-1), scores.reshape(-1))
        half_rows, half_columns = self.footprint.shape[0] // 2, self.footprint.shape[1] // 2
        shape = (len(votes) + 2 * half_rows, votes.shape[1] + 2 * half_columns)
        if self.used.size < shape[0] * shape[1]:
            self.used = np.zeros(shape[0] * shape[1], bool)
        used = self.used[: shape[0] * shape[1]].reshape(shape)
        used.fill(False)
        picked: list[tuple[int, int, int]] = []
        for rows, columns, values in _candidates(scores, int(_FIRST_BAND * self.last_pick)):
            free = ~used[rows + half_rows, columns + half_columns]
            for row, column, value in np.stack([rows, columns, values], axis=1)[free].tolist():
                if used[row + half_rows, column + half_columns]:
                    continue
                picked.append((row, column, value))
                if len(picked) == self.config.maxima:
                    return picked
                self._clear(used, row, column, votes.shape)
        return picked

    def _clear(self, used: np.ndarray, row: int, column: int, shape: tuple[int, ...]) -> None:
        """Mark the footprint of a pick: at it, and mirrored across 0° = 180°."""
        height, width = self.footprint.shape
        used[row : row + height, column : column + width] |= self.footprint
        mirrored = shape[1] - 1 - column
        if row < height:
            used[row + shape[0] :, mirrored : mirrored + width] |= self.footprint[
                : len(used) - row - shape[0]
            ]
        if row > shape[0] - height:
            first = shape[0] - row
            used[: height - first, mirrored : mirrored + width] |= self.footprint[first:]


def _score(votes: np.ndarray, scores: np.ndarray) -> None:
    """Write six times the sum of votes weighted 1 / (1 + |n|) over distances n = −2 … 2.

    Both arrays are flat; the empty margin of each row of the slice keeps its rows apart.
    """
    scores[:2] = scores[-2:] = 0
    sides = np.empty(_BLOCK_BINS, np.uint16)
    for start in range(2, votes.size - 2, _BLOCK_BINS):
        stop = min(start + _BLOCK_BINS, votes.size - 2)
        value, side = scores[start:stop], sides[: stop - start]
        # 6 c + 3 (l + r) + 2 (ll + rr) = 2 (3 c + (l + r) + (ll + rr)) + (l + r)
        np.add(votes[start - 1 : stop - 1], votes[start + 1 : stop + 1], out=side)
        np.multiply(votes[start:stop], 3, out=value)
        value += votes[start - 2 : stop - 2]
        value += votes[start + 2 : stop + 2]
        value += side
        value *= 2
        value += side


def _candidates(scores: np.ndarray, guess: int) -> Iterator[Picked]:
    """Rows, columns and scores of local 3x3 maxima of a slice, largest first, band after band.

    `guess` is where the first band of falling scores may end, which changes the work and never the
    order.
    """
    flat = scores.reshape(-1)
    upper = int(flat.max(initial=0)) + 1
    lower = guess if 0 < guess < upper else upper // 2
    while upper > 1:
        lower = max(lower, 1)
        bins = np.flatnonzero(flat >= lower)
        values = flat[bins]
        bins, values = bins[values < upper], values[values < upper]
        bins, values = _local_maxima(scores, bins, values)
        values = values.astype(np.intp)
        order = np.argsort(-values, kind="stable")
        yield *np.divmod(bins[order], scores.shape[1]), values[order]
        upper, lower = lower, int(_BAND * lower)


def _local_maxima(
    scores: np.ndarray, bins: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Flat bins, and their scores, that none of their eight neighbours exceeds."""
    n_columns, flat = scores.shape[1], scores.reshape(-1)
    for down in (0, -1, 1):  # the neighbours in the same row discard most
        for right in (-1, 1) if down == 0 else (0, -1, 1):
            beside = bins + (down * n_columns + right)
            if down:  # beyond 0° and 180° the rows go on mirrored
                low, high = beside < 0, beside >= flat.size
                beside[low] = flat.size - 1 - n_columns - beside[low]
                beside[high] = flat.size - 1 + n_columns - beside[high]
            keep = values >= flat[beside]
            bins, values = bins[keep], values[keep]
    return bins, values


def _footprint(config: AlemanFloresConfig) -> np.ndarray:
    """Neighbourhood of a maximum: a rectangle (2014) or the butterfly of a line's votes (2016)."""
    if config.variant == "2014":
        rows = round(config.clear_angle_deg / config.angle_step_deg)
        return np.ones((2 * rows + 1, 2 * config.clear_distance + 1), bool)
    rows = config.angle_reach
    angle = np.abs(np.arange(-rows, rows + 1)) * config.angle_step_deg
    half_width = np.maximum(5.0, 5.0 * angle)
    columns = int(half_width.max())
    return np.abs(np.arange(-columns, columns + 1)) <= half_width[:, None]

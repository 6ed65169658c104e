"""Pieces of one line joined without knowing the lens: by smooth continuation over small gaps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from classical.lines.pieces import fit_arcs, fit_by_length, gather_ranges
from classical.lines.smooth import counter_bend

_END_POINTS = 30  # points from which the direction of an end is taken


@dataclass(frozen=True)
class ContinuationConfig:
    """When two arcs are taken for one without knowing the lens; lengths in working pixels.

    Attributes:
        max_gap: Widest gap, pixels …
        max_gap_share: … and as a share of the shorter arc's length.
        min_alignment: Smallest cosine between the end tangents, and to the gap.
        max_rms: Largest root mean square distance from the common polynomial.
        max_counter_bend: As in `SmoothConfig`.
        rounds: Of pairwise joining.
    """

    max_gap: float = 40.0
    max_gap_share: float = 0.7
    min_alignment: float = 0.985
    max_rms: float = 0.3
    max_counter_bend: float = 0.5
    rounds: int = 5


def continue_arcs(
    points: Float[np.ndarray, "m 2"],
    offsets: Int[np.ndarray, " p1"],
    *,
    config: ContinuationConfig = ContinuationConfig(),
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " q1"]]:
    """Join arcs that continue each other smoothly across small gaps.

    Args:
        points: Points in order along arcs, shape (m, 2).
        offsets: Arc p is points[offsets[p] : offsets[p + 1]], shape (p + 1,).
        config: When arcs are taken for one.

    Returns:
        selected: Indices of all points, in order along the joined arcs, shape (m,).
        offsets: Offsets of the joined arcs, shape (q + 1,).
    """
    order = np.arange(len(points))
    outward = _outward(points, offsets[:-1], offsets[1:])
    fresh = np.ones(len(offsets) - 1, dtype=bool)  # arcs whose pairs were not tried yet
    for _ in range(config.rounds):
        pairs = _disjoint(_continuing_pairs(points, offsets, outward, fresh, config))
        if not len(pairs.first):
            break
        left = np.delete(np.arange(len(fresh)), pairs.second)
        selected, offsets = _joined(offsets, pairs, left)
        order, points = order[selected], points[selected]
        fresh = np.isin(left, pairs.first)
        outward = outward[:, left]
        outward[:, fresh] = _outward(points, offsets[:-1][fresh], offsets[1:][fresh])
    return order, offsets


class _Pairs(NamedTuple):
    """Arcs to be joined at one end of each, 0 its start and 1 its stop; shape (k,) each."""

    first: np.ndarray
    first_end: np.ndarray
    second: np.ndarray
    second_end: np.ndarray

    def chosen(self, keep: np.ndarray) -> _Pairs:
        return _Pairs(*(column[keep] for column in self))


def _disjoint(pairs: _Pairs) -> _Pairs:
    """Pairs of which no arc is in an earlier one that is kept."""
    taken: set[int] = set()
    keep = []
    for number, (a, b) in enumerate(zip(pairs.first.tolist(), pairs.second.tolist(), strict=True)):
        if a not in taken and b not in taken:
            taken |= {a, b}
            keep.append(number)
    return pairs.chosen(np.array(keep, dtype=np.int64))


def _joined(offsets: np.ndarray, pairs: _Pairs, left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices along the arcs `left`, each followed by the second of its pair, and offsets."""
    partner = np.full(len(offsets) - 1, -1)
    partner[pairs.first] = pairs.second
    forward = np.ones((len(offsets) - 1, 2), dtype=bool)
    forward[pairs.first] = np.stack([pairs.first_end == 1, pairs.second_end == 0], axis=1)
    runs = np.stack([left, partner[left]], axis=1).ravel()
    there = runs >= 0
    selected, stops = _runs(offsets, runs[there], forward[left].ravel()[there])
    is_first = np.arange(len(runs))[there] % 2 == 0
    return selected, np.append(stops[:-1][is_first], stops[-1])


def _runs(
    offsets: np.ndarray, arcs: np.ndarray, forward: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Indices along some arcs, each forward or backward, one after another, and their offsets."""
    starts, stops = offsets[arcs], offsets[arcs + 1]
    runs = np.concatenate([[0], np.cumsum(stops - starts)]).astype(np.int64)
    step = np.where(forward, 1, -1)
    begin = np.where(forward, starts, stops - 1) - step * runs[:-1]
    lengths = stops - starts
    return np.repeat(begin, lengths) + np.repeat(step, lengths) * np.arange(runs[-1]), runs


def _continuing_pairs(
    points: np.ndarray,
    offsets: np.ndarray,
    outward: np.ndarray,
    fresh: np.ndarray,
    config: ContinuationConfig,
) -> _Pairs:
    """Pairs of arcs that may be joined, one of them fresh, the best first."""
    count = len(fresh)
    if count < 2:
        return _Pairs(*np.empty((4, 0), dtype=np.int64))
    place = points[np.concatenate([offsets[:-1], offsets[1:] - 1])]
    outward = outward.reshape(-1, 2)
    i, j = KDTree(place).query_pairs(config.max_gap, output_type="ndarray").T
    tried = (i % count != j % count) & (fresh[i % count] | fresh[j % count])
    i, j = i[tried], j[tried]
    lengths = np.diff(offsets)
    gap = place[j] - place[i]
    distance = np.hypot(*gap.T)
    room = config.max_gap_share * np.minimum(lengths[i % count], lengths[j % count])
    opposite = -(outward[i] * outward[j]).sum(axis=1)
    slack = 1.5  # pixels: the direction of a tiny gap means nothing
    ahead = np.minimum((outward[i] * gap).sum(axis=1), -(outward[j] * gap).sum(axis=1))
    fits = (distance <= room) & (opposite > config.min_alignment)
    fits &= ahead + slack > config.min_alignment * distance
    distance = distance[fits]
    pairs = _Pairs(i[fits] % count, i[fits] // count, j[fits] % count, j[fits] // count)
    if not len(distance):
        return pairs
    rms, rise = _common_fit(points, offsets, pairs)
    good = (rms <= config.max_rms) & (rise <= config.max_counter_bend)
    cost = distance / config.max_gap + rms / config.max_rms
    return pairs.chosen(np.flatnonzero(good)[np.argsort(cost[good], kind="stable")])


def _common_fit(
    points: np.ndarray, offsets: np.ndarray, pairs: _Pairs
) -> tuple[np.ndarray, np.ndarray]:
    """Root mean square distance and counter-bend of one polynomial through each pair of arcs."""
    arcs = np.stack([pairs.first, pairs.second], axis=1).ravel()
    forward = np.stack([pairs.first_end == 1, pairs.second_end == 0], axis=1).ravel()
    selected, runs = _runs(offsets, arcs, forward)
    fit = fit_by_length(points[selected], runs[::2])
    return fit.rms, counter_bend(fit)[0]


def _outward(points: np.ndarray, starts: np.ndarray, stops: np.ndarray) -> np.ndarray:
    """Unit tangents out of arcs at their starts and at their stops, shape (2, p, 2)."""
    beginnings, offsets = gather_ranges(starts, np.minimum(starts + _END_POINTS, stops))
    into, _ = fit_arcs(points[beginnings], offsets, degree=2).end_tangents
    endings, offsets = gather_ranges(np.maximum(stops - _END_POINTS, starts), stops)
    _, out = fit_arcs(points[endings], offsets, degree=2).end_tangents
    return np.stack([-into, out])

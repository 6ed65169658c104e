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
    outward = _outward(points, order, offsets[:-1], offsets[1:])
    near = _near_ends(points, offsets, config.max_gap)
    fresh = np.ones(len(offsets) - 1, dtype=bool)  # arcs whose pairs were not tried yet
    for _ in range(config.rounds):
        tried = near[:, np.logical_or(*np.tile(fresh, 2)[near])]
        pairs = _disjoint(_continuing_pairs(points, order, offsets, outward, tried, config))
        if not len(pairs.first):
            break
        left = np.delete(np.arange(len(fresh)), pairs.second)
        near = _free_ends(near, pairs, left)
        selected, offsets = _joined(offsets, pairs, left)
        order = order[selected]
        fresh = np.isin(left, pairs.first)
        outward = outward[:, left]
        outward[:, fresh] = _outward(points, order, offsets[:-1][fresh], offsets[1:][fresh])
    return order, offsets


class _Pairs(NamedTuple):
    """Arcs to be joined at one end of each, 0 its start and 1 its stop; shape (k,) each."""

    first: np.ndarray
    first_end: np.ndarray
    second: np.ndarray
    second_end: np.ndarray

    def chosen(self, keep: np.ndarray) -> _Pairs:
        return _Pairs(*(column[keep] for column in self))


def _near_ends(points: np.ndarray, offsets: np.ndarray, reach: float) -> np.ndarray:
    """All pairs of ends no farther apart: those of arc a are a and, its stop, a + p; (2, k)."""
    if len(offsets) < 2:
        return np.empty((2, 0), dtype=np.int64)
    ends = points[np.concatenate([offsets[:-1], offsets[1:] - 1])]
    return np.ascontiguousarray(KDTree(ends).query_pairs(reach, output_type="ndarray").T)


def _free_ends(near: np.ndarray, pairs: _Pairs, left: np.ndarray) -> np.ndarray:
    """The pairs of ends of which none was joined, as ends of the arcs that are left."""
    count = len(left)
    end = np.full((2, count + len(pairs.second)), -1)
    end[:, left] = np.arange(2 * count).reshape(2, count)
    joined = end[0, pairs.first]
    end[:, pairs.first] = -1
    end[1 - pairs.first_end, pairs.first] = joined
    end[1 - pairs.second_end, pairs.second] = joined + count
    i, j = end.ravel()[near]
    free = (i >= 0) & (j >= 0)
    i, j = i[free], j[free]
    return np.stack([np.minimum(i, j), np.maximum(i, j)])


def _continuing_pairs(
    points: np.ndarray,
    order: np.ndarray,
    offsets: np.ndarray,
    outward: np.ndarray,
    near: np.ndarray,
    config: ContinuationConfig,
) -> _Pairs:
    """The pairs of ends at which arcs may be joined, the best first."""
    lengths = np.diff(offsets)
    count = len(lengths)
    place_u, place_v = points[order[np.concatenate([offsets[:-1], offsets[1:] - 1])]].T
    out_u, out_v = outward.reshape(-1, 2).T
    i, j = near
    room = config.max_gap_share * np.minimum(lengths[i % count], lengths[j % count])
    gap_u, gap_v = place_u[j] - place_u[i], place_v[j] - place_v[i]
    distance = np.hypot(gap_u, gap_v)
    opposite = -(out_u[i] * out_u[j] + out_v[i] * out_v[j])
    slack = 1.5  # pixels: the direction of a tiny gap means nothing
    ahead = np.minimum(out_u[i] * gap_u + out_v[i] * gap_v, -(out_u[j] * gap_u + out_v[j] * gap_v))
    fits = (i % count != j % count) & (distance <= room) & (opposite > config.min_alignment)
    fits &= ahead + slack > config.min_alignment * distance
    i, j, distance = i[fits], j[fits], distance[fits]
    pairs = _Pairs(i % count, i // count, j % count, j // count)
    if not len(distance):
        return pairs
    rms, rise = _common_fit(points, order, offsets, pairs)
    good = (rms <= config.max_rms) & (rise <= config.max_counter_bend)
    cost = distance / config.max_gap + rms / config.max_rms
    return pairs.chosen(np.flatnonzero(good)[np.argsort(cost[good], kind="stable")])


def _common_fit(
    points: np.ndarray, order: np.ndarray, offsets: np.ndarray, pairs: _Pairs
) -> tuple[np.ndarray, np.ndarray]:
    """Root mean square distance and counter-bend of one polynomial through each pair of arcs."""
    arcs = np.stack([pairs.first, pairs.second], axis=1).ravel()
    forward = np.stack([pairs.first_end == 1, pairs.second_end == 0], axis=1).ravel()
    selected, runs = _runs(offsets, arcs, forward)
    fit = fit_by_length(points.take(order[selected], axis=0), runs[::2])
    return fit.rms, counter_bend(fit)[0]


def _outward(
    points: np.ndarray, order: np.ndarray, starts: np.ndarray, stops: np.ndarray
) -> np.ndarray:
    """Unit tangents out of arcs at their starts and at their stops, shape (2, p, 2)."""
    beginnings, offsets = gather_ranges(starts, np.minimum(starts + _END_POINTS, stops))
    into, _ = fit_arcs(points[order[beginnings]], offsets, degree=2).end_tangents
    endings, offsets = gather_ranges(np.maximum(stops - _END_POINTS, starts), stops)
    _, out = fit_arcs(points[order[endings]], offsets, degree=2).end_tangents
    return np.stack([-into, out])


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
    lengths = stops - starts
    runs = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    step = np.where(forward, 1, -1)
    begin = np.where(forward, starts, stops - 1) - step * runs[:-1]
    return np.repeat(begin, lengths) + np.repeat(step, lengths) * np.arange(runs[-1]), runs

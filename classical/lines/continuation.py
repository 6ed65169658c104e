"""Pieces of one line joined without knowing the lens: by smooth continuation over small gaps."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from classical.lines.smooth import counter_bend, fit_arcs, fit_by_length

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
    arcs = [np.arange(a, b) for a, b in itertools.pairwise(offsets)]
    fresh = np.ones(len(arcs), dtype=bool)  # arcs whose pairs were not tried yet
    for _ in range(config.rounds):
        pairs = _continuing_pairs(points, arcs, fresh, config)
        if not len(pairs):
            break
        taken: set[int] = set()
        fresh[:] = False
        for first, first_end, second, second_end in pairs:
            if first in taken or second in taken:
                continue
            taken |= {first, second}
            arcs[first] = _concatenated(arcs[first], first_end, arcs[second], second_end)
            arcs[second] = np.empty(0, dtype=np.int64)
            fresh[first] = True
        fresh = fresh[[len(arc) > 0 for arc in arcs]]
        arcs = [arc for arc in arcs if len(arc)]
    lengths = np.array([len(arc) for arc in arcs], dtype=np.int64)
    joined = np.concatenate(arcs) if arcs else np.empty(0, dtype=np.int64)
    return joined, np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)


def _concatenated(first: np.ndarray, first_end: int, second: np.ndarray, end: int) -> np.ndarray:
    """First up to its end (0 start, 1 stop), then second from its end."""
    return np.concatenate([first if first_end else first[::-1], second[::-1] if end else second])


def _continuing_pairs(
    points: np.ndarray, arcs: list[np.ndarray], fresh: np.ndarray, config: ContinuationConfig
) -> list[tuple[int, int, int, int]]:
    """Pairs (arc, its end, arc, its end) that may be joined, one of them fresh, the best first."""
    if len(arcs) < 2:
        return []
    lengths = np.array([len(arc) for arc in arcs])
    place, outward = _ends(points, arcs)
    pairs = KDTree(place).query_pairs(config.max_gap, output_type="ndarray")
    i, j = pairs.T
    count = len(arcs)
    gap = place[j] - place[i]
    distance = np.hypot(*gap.T)
    room = config.max_gap_share * np.minimum(lengths[i % count], lengths[j % count])
    opposite = -(outward[i] * outward[j]).sum(axis=1)
    slack = 1.5  # pixels: the direction of a tiny gap means nothing
    ahead = np.minimum((outward[i] * gap).sum(axis=1), -(outward[j] * gap).sum(axis=1))
    fits = (i % count != j % count) & (distance <= room) & (opposite > config.min_alignment)
    fits &= ahead + slack > config.min_alignment * distance
    fits &= fresh[i % count] | fresh[j % count]
    i, j, distance = i[fits], j[fits], distance[fits]
    if not len(i):
        return []
    trial = [
        _concatenated(arcs[a % count], a // count, arcs[b % count], b // count)
        for a, b in zip(i.tolist(), j.tolist(), strict=True)
    ]
    rms, counter = _common_fit(points, trial)
    good = (rms <= config.max_rms) & (counter <= config.max_counter_bend)
    cost = distance / config.max_gap + rms / config.max_rms
    order = np.flatnonzero(good)[np.argsort(cost[good], kind="stable")]
    return [
        (int(i[k] % count), int(i[k] // count), int(j[k] % count), int(j[k] // count))
        for k in order
    ]


def _ends(points: np.ndarray, arcs: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Places of all starts, then of all stops, and unit tangents out of the arcs there."""
    pieces = [arc[:_END_POINTS] for arc in arcs] + [arc[-_END_POINTS:] for arc in arcs]
    offsets = np.concatenate([[0], np.cumsum([len(piece) for piece in pieces])])
    packed = points[np.concatenate(pieces)]
    tangents = fit_arcs(packed, offsets, degree=2).tangents
    count = len(arcs)
    at = np.concatenate([offsets[:count], offsets[count + 1 :] - 1])
    sign = np.repeat([-1.0, 1.0], count)
    return packed[at], tangents[at] * sign[:, None]


def _common_fit(points: np.ndarray, arcs: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Root mean square distance and counter-bend of one polynomial through each arc."""
    offsets = np.concatenate([[0], np.cumsum([len(arc) for arc in arcs])])
    fit = fit_by_length(points[np.concatenate(arcs)], offsets)
    return fit.rms, counter_bend(fit, offsets)[0]

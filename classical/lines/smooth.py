"""Chains cut into smooth arcs: at corners, at wiggles and where the bend changes its side.

The image of a straight line under a lens is smooth and bends to one side only. Each piece is
therefore fitted by a low-order polynomial in its arc length; a piece whose points leave the
polynomial, or that bends both ways, is cut in two and tried again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from classical.lines.pieces import ArcFit, fit_by_length, gather_ranges, ranked

_ROUNDS = 9


@dataclass(frozen=True)
class SmoothConfig:
    """What counts as a smooth arc; lengths in pixels of the picture that is worked on.

    Attributes:
        min_points: Pieces with fewer points are dropped.
        corner_reach: Points on either side from which a corner is measured.
        corner_angle: Turns above this are corners, radians.
        trim: Points dropped on both sides of every cut and at the ends, where a crossing or a
            corner bends the edge.
        max_rms: Largest root mean square distance from the polynomial.
        max_distance: Largest single distance from the polynomial.
        max_counter_bend: Largest rise of a part that bends against the rest.
    """

    min_points: int = 12
    corner_reach: int = 6
    corner_angle: float = 0.35
    trim: int = 2
    max_rms: float = 0.35
    max_distance: float = 1.2
    max_counter_bend: float = 0.6


def smooth_arcs(
    points: Float[np.ndarray, "m 2"], offsets: Int[np.ndarray, " c1"], *, config: SmoothConfig
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " p1"]]:
    """Cut chains into smooth arcs that bend to one side.

    Args:
        points: Points in order along chains, shape (m, 2).
        offsets: Chain c is points[offsets[c] : offsets[c + 1]], shape (c + 1,).
        config: What counts as smooth.

    Returns:
        selected: Indices of the points of all arcs, in order, shape (k,).
        offsets: Arc a is selected[offsets[a] : offsets[a + 1]], shape (p + 1,).
    """
    starts, stops = offsets[:-1], offsets[1:]
    starts, stops = _cut_at_corners(points, starts, stops, config)
    done: list[tuple[np.ndarray, np.ndarray]] = []
    for _ in range(_ROUNDS):
        long_enough = stops - starts >= config.min_points
        starts, stops = starts[long_enough], stops[long_enough]
        if not len(starts):
            break
        good, cut = _judge(points, starts, stops, config)
        done.append((starts[good], stops[good]))
        bad_starts, bad_stops, cut = starts[~good], stops[~good], cut[~good]
        starts = np.concatenate([bad_starts, cut + config.trim])
        stops = np.concatenate([cut - config.trim, bad_stops])
    starts = np.concatenate([s for s, _ in done] or [np.empty(0, dtype=np.int64)])
    stops = np.concatenate([s for _, s in done] or [np.empty(0, dtype=np.int64)])
    order = np.argsort(starts)
    return gather_ranges(starts[order], stops[order])


def inliers(
    points: Float[np.ndarray, "m 2"],
    offsets: Int[np.ndarray, " p1"],
    *,
    floor: float,
    factor: float = 5.0,
    rounds: int = 2,
) -> Bool[np.ndarray, " m"]:
    """True for points near the polynomial of their piece; false where something crosses it.

    Args:
        points: Points in order along pieces, shape (m, 2).
        offsets: Piece p is points[offsets[p] : offsets[p + 1]], shape (p + 1,).
        floor: Distances up to this are always near, pixels.
        factor: Distances up to this many medians of the piece's distances are near.
        rounds: Of fitting without the points that were found to be far.
    """
    keep = np.ones(len(points), dtype=bool)
    changed = np.arange(len(offsets) - 1)  # pieces whose polynomial is not known yet
    for _ in range(rounds):
        selected, _ = gather_ranges(offsets[changed], offsets[changed + 1])
        selected = selected[keep[selected]]
        local = np.searchsorted(selected, np.append(offsets[changed], len(points)))
        distance = np.abs(fit_by_length(points.take(selected, axis=0), local).distance)
        counts = np.diff(local)
        limit = np.maximum(floor, factor * ranked(distance, local, counts // 2))
        far = distance > np.repeat(limit, counts)
        keep[selected[far]] = False
        changed = changed[np.logical_or.reduceat(far, local[:-1])]
        if not len(changed):
            break
    return keep


def _judge(
    points: np.ndarray, starts: np.ndarray, stops: np.ndarray, config: SmoothConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Which pieces are smooth arcs, and where to cut each that is not."""
    selected, offsets = gather_ranges(starts, stops)
    fit = fit_by_length(points.take(selected, axis=0), offsets)
    rise, against = counter_bend(fit)
    near = (fit.rms <= config.max_rms) & (fit.largest <= config.max_distance)
    good = near & (rise <= config.max_counter_bend)
    cut = starts.copy()
    for pieces, place, quantity in (
        (np.flatnonzero(near & ~good), _turning_point, against),
        (np.flatnonzero(~near), _kink, fit.distance),
    ):
        if len(pieces):
            inside, local = gather_ranges(offsets[pieces], offsets[pieces + 1])
            cut[pieces] += place(quantity[inside], local)
    return good, cut


def counter_bend(fit: ArcFit) -> tuple[Float[np.ndarray, " p"], Bool[np.ndarray, " m"]]:
    """Rise of the part of each piece that bends the other way, and which points are in it.

    A part of length L that turns by α rises about L α / 8 above its chord.
    """
    first, lengths, curvature = fit.offsets[:-1], np.diff(fit.offsets), fit.curvature
    left = np.add.reduceat(np.maximum(curvature, 0), first)
    right = -np.add.reduceat(np.minimum(curvature, 0), first)
    side = np.where(left >= right, 1.0, -1.0)
    against = curvature * np.repeat(side, lengths) < 0
    count = np.add.reduceat(against, first, dtype=np.int64)
    return np.minimum(left, right) * count * fit.spacing**2 / 8, against


def _turning_point(against: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Where the bend changes its side nearest to the middle, as an index into each piece."""
    lengths = np.diff(offsets)
    change = np.zeros(len(against), dtype=bool)
    change[1:] = against[1:] != against[:-1]
    change[offsets[:-1]] = False
    from_middle = np.arange(len(against)) - np.repeat(offsets[:-1] + lengths // 2, lengths)
    return _arg_first_min(np.where(change, np.abs(from_middle), len(against)), offsets)


def _kink(distance: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Where the points leave their polynomial most sharply, as an index into each piece."""
    lengths = np.diff(offsets)
    reach = np.repeat(np.maximum(4, lengths // 8), lengths)
    here = np.arange(len(distance))
    low, high = np.repeat(offsets[:-1], lengths), np.repeat(offsets[1:] - 1, lengths)
    before, after = np.maximum(here - reach, low), np.minimum(here + reach, high)
    sharp = np.abs(distance[before] - 2 * distance + distance[after])
    inside = (here - low >= reach) & (high - here >= reach)
    return _arg_first_min(np.where(inside, -sharp, 1.0), offsets)


def _arg_first_min(values: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Index into each piece of its first smallest value."""
    first = offsets[:-1]
    smallest = np.minimum.reduceat(values, first)
    hits = np.flatnonzero(values == np.repeat(smallest, np.diff(offsets)))
    return hits[np.searchsorted(hits, first)] - first


def _cut_at_corners(
    points: np.ndarray, starts: np.ndarray, stops: np.ndarray, config: SmoothConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Cut chains where they turn sharply, and trim all ends."""
    reach = config.corner_reach
    long_enough = stops - starts >= config.min_points
    selected, offsets = gather_ranges(starts[long_enough], stops[long_enough])
    if not len(selected):
        return starts[:0], stops[:0]
    turn = _turning(points[selected], offsets, reach, config.corner_angle)
    peak = turn > config.corner_angle
    peak[1:] &= turn[1:] > turn[:-1]
    peak[:-1] &= turn[:-1] >= turn[1:]
    cuts = selected[peak]
    chain_starts, chain_stops = starts[long_enough], stops[long_enough]
    trim = np.full(len(cuts), config.trim + 1)
    new_starts = np.concatenate([chain_starts + config.trim, cuts + trim])
    new_stops = np.concatenate([chain_stops - config.trim, cuts - trim])
    return np.sort(new_starts), np.sort(new_stops)


def _turning(points: np.ndarray, offsets: np.ndarray, reach: int, least: float) -> np.ndarray:
    """Angle between the chords to the points `reach` before and after.

    It is 0 near the ends, and where it is below `least`, which needs no arctangent to tell.
    """
    lengths = np.diff(offsets)
    here = np.arange(len(points))
    low, high = np.repeat(offsets[:-1], lengths), np.repeat(offsets[1:] - 1, lengths)
    before, after = np.maximum(here - reach, low), np.minimum(here + reach, high)
    u, v = np.array(points.T, order="C")
    a_u, a_v, b_u, b_v = u - u[before], v - v[before], u[after] - u, v[after] - v
    across, along = np.abs(a_u * b_v - a_v * b_u), a_u * b_u + a_v * b_v
    sharp = np.cos(least) * across >= np.sin(least) * along
    sharp &= (here - low >= reach // 2) & (high - here >= reach // 2)
    turn = np.zeros(len(points))
    turn[sharp] = np.arctan2(across[sharp], along[sharp])
    return turn

"""Chains cut into smooth arcs: at corners, at wiggles and where the bend changes its side.

The image of a straight line under a lens is smooth and bends to one side only. Each piece is
therefore fitted by a low-order polynomial in its arc length; a piece whose points leave the
polynomial, or that bends both ways, is cut in two and tried again. All pieces are fitted at once:
the sums of the normal equations are taken by `np.add.reduceat` over one long array of points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.polynomial import legendre

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


@dataclass(frozen=True)
class ArcFit:
    """Polynomials through pieces of points.

    Attributes:
        distance: Signed distance of each point across its polynomial, shape (m,).
        tangents: Unit tangents of the polynomial, shape (m, 2).
        curvature: Signed curvature of the polynomial, 1 / pixels, shape (m,).
        spacing: Arc length that each point stands for, pixels, shape (m,).
        rms: Root mean square distance of each piece, shape (p,).
        largest: Largest distance of each piece, shape (p,).
    """

    distance: Float[np.ndarray, " m"]
    tangents: Float[np.ndarray, "m 2"]
    curvature: Float[np.ndarray, " m"]
    spacing: Float[np.ndarray, " m"]
    rms: Float[np.ndarray, " p"]
    largest: Float[np.ndarray, " p"]


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


def gather_ranges(starts: np.ndarray, stops: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of all ranges one after another, and the offsets of the ranges in them."""
    lengths = stops - starts
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    selected = np.arange(offsets[-1]) + np.repeat(starts - offsets[:-1], lengths)
    return selected, offsets


def fit_arcs(
    points: Float[np.ndarray, "m 2"], offsets: Int[np.ndarray, " p1"], *, degree: int
) -> ArcFit:
    """Fit each piece by a polynomial in its arc length, all at once.

    Args:
        points: Points in order along pieces of at least degree + 1 points, shape (m, 2).
        offsets: Piece p is points[offsets[p] : offsets[p + 1]], shape (p + 1,).
        degree: Degree of the polynomials u(s), v(s).
    """
    first, lengths = offsets[:-1], np.diff(offsets)
    label = np.repeat(np.arange(len(first)), lengths)
    position, total = arc_length(points, offsets)
    local = 2 * position / np.maximum(total, 1e-9)[label] - 1
    centred = points - points[first][label]
    basis = legendre.legvander(local, degree)
    slope = legendre.legvander(local, degree - 1) @ legendre.legder(np.eye(degree + 1))
    normal = np.add.reduceat(basis[:, :, None] * basis[:, None, :], first)
    right = np.add.reduceat(basis[:, :, None] * centred[:, None, :], first)
    normal += 1e-9 * lengths[:, None, None] * np.eye(degree + 1)
    coefficients = np.linalg.solve(normal, right)[label]
    fitted = np.einsum("mi,mij->mj", basis, coefficients)
    first_derivative = np.einsum("mi,mij->mj", slope, coefficients)
    speed = np.maximum(np.hypot(*first_derivative.T), 1e-9)
    tangents = first_derivative / speed[:, None]
    gap = centred - fitted
    distance = tangents[:, 0] * gap[:, 1] - tangents[:, 1] * gap[:, 0]
    if degree > 1:
        bend = legendre.legvander(local, degree - 2) @ legendre.legder(np.eye(degree + 1), 2)
        second = np.einsum("mi,mij->mj", bend, coefficients)
        turned = first_derivative[:, 0] * second[:, 1] - first_derivative[:, 1] * second[:, 0]
        curvature = turned / speed**3
    else:
        curvature = np.zeros(len(points))
    rms = np.sqrt(np.add.reduceat(distance**2, first) / np.maximum(lengths - degree - 1, 1))
    largest = np.maximum.reduceat(np.abs(distance), first)
    spacing = (total / np.maximum(lengths - 1, 1))[label]
    return ArcFit(distance, tangents, curvature, spacing, rms, largest)


def fit_by_length(points: Float[np.ndarray, "m 2"], offsets: Int[np.ndarray, " p1"]) -> ArcFit:
    """Fit each piece by the polynomial that its number of points allows; see `fit_arcs`."""
    lengths = np.diff(offsets)
    degrees = polynomial_degrees(lengths)
    m, p = len(points), len(lengths)
    fit = ArcFit(np.zeros(m), np.zeros((m, 2)), np.zeros(m), np.zeros(m), np.zeros(p), np.zeros(p))
    for degree in np.unique(degrees):
        chosen = np.flatnonzero(degrees == degree)
        selected, local = gather_ranges(offsets[chosen], offsets[chosen + 1])
        part = fit_arcs(points[selected], local, degree=int(degree))
        fit.distance[selected], fit.tangents[selected] = part.distance, part.tangents
        fit.curvature[selected], fit.spacing[selected] = part.curvature, part.spacing
        fit.rms[chosen], fit.largest[chosen] = part.rms, part.largest
    return fit


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
    label = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    keep = np.ones(len(points), dtype=bool)
    for _ in range(rounds):
        counts = np.bincount(label[keep], minlength=len(offsets) - 1)
        local = np.concatenate([[0], np.cumsum(counts)])
        distance = np.abs(fit_by_length(points[keep], local).distance)
        order = np.lexsort((distance, label[keep]))
        median = distance[order][local[:-1] + counts // 2]
        near = distance <= np.maximum(floor, factor * median)[label[keep]]
        keep[np.flatnonzero(keep)[~near]] = False
    return keep


def arc_length(points: np.ndarray, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Arc length from the start of each piece at each point, and of each piece as a whole."""
    steps = np.zeros(len(points))
    steps[1:] = np.hypot(*np.diff(points, axis=0).T)
    steps[offsets[:-1]] = 0.0
    running = np.cumsum(steps)
    position = running - np.repeat(running[offsets[:-1]], np.diff(offsets))
    return position, position[offsets[1:] - 1]


def polynomial_degrees(lengths: np.ndarray) -> np.ndarray:
    """Degree of the polynomial for pieces of so many points."""
    return np.select([lengths < 24, lengths < 120], [2, 3], 5)


def _judge(
    points: np.ndarray, starts: np.ndarray, stops: np.ndarray, config: SmoothConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Which pieces are smooth arcs, and where to cut each that is not."""
    selected, offsets = gather_ranges(starts, stops)
    fit = fit_by_length(points[selected], offsets)
    counter, turning_point = counter_bend(fit, offsets)
    near = (fit.rms <= config.max_rms) & (fit.largest <= config.max_distance)
    cut = starts + np.where(near, turning_point, _kink(fit.distance, offsets))
    return near & (counter <= config.max_counter_bend), cut


def counter_bend(fit: ArcFit, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rise of the part of each piece that bends the other way, and where the bend changes.

    A part of length L that turns by α rises about L α / 8 above its chord.
    """
    first = offsets[:-1]
    turn = fit.curvature * fit.spacing
    left = np.add.reduceat(np.maximum(turn, 0), first)
    right = np.add.reduceat(np.maximum(-turn, 0), first)
    side = np.where(left >= right, 1.0, -1.0)
    label = np.repeat(np.arange(len(first)), np.diff(offsets))
    against = fit.curvature * side[label] < 0
    length = np.add.reduceat(np.where(against, fit.spacing, 0.0), first)
    rise = np.minimum(left, right) * length / 8
    # change of side nearest to the middle of the piece
    change = np.zeros(len(against), dtype=bool)
    change[1:] = against[1:] != against[:-1]
    change[first] = False
    index = np.arange(len(against)) - first[label]
    middle = (np.diff(offsets) // 2)[label]
    key = np.where(change, np.abs(index - middle), len(against))
    nearest = _arg_first_min(key, offsets)
    return rise, nearest


def _kink(distance: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Where the points leave their polynomial most sharply, as an index into each piece."""
    lengths = np.diff(offsets)
    label = np.repeat(np.arange(len(lengths)), lengths)
    reach = np.maximum(4, lengths // 8)[label]
    here = np.arange(len(distance))
    low, high = offsets[:-1][label], offsets[1:][label] - 1
    before, after = np.maximum(here - reach, low), np.minimum(here + reach, high)
    sharp = np.abs(distance[before] - 2 * distance + distance[after])
    inside = (here - low >= reach) & (high - here >= reach)
    return _arg_first_min(np.where(inside, -sharp, 1.0), offsets)


def _arg_first_min(values: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Index into each piece of its first smallest value."""
    first = offsets[:-1]
    label = np.repeat(np.arange(len(first)), np.diff(offsets))
    smallest = np.minimum.reduceat(values, first)
    hits = np.flatnonzero(values == smallest[label])
    unique_label, position = np.unique(label[hits], return_index=True)
    out = np.zeros(len(first), dtype=np.int64)
    out[unique_label] = hits[position] - first[unique_label]
    return out


def _cut_at_corners(
    points: np.ndarray, starts: np.ndarray, stops: np.ndarray, config: SmoothConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Cut chains where they turn sharply, and trim all ends."""
    reach = config.corner_reach
    long_enough = stops - starts >= config.min_points
    selected, offsets = gather_ranges(starts[long_enough], stops[long_enough])
    if not len(selected):
        return starts[:0], stops[:0]
    turn = _turning(points[selected], offsets, reach)
    peak = turn > config.corner_angle
    peak[1:] &= turn[1:] > turn[:-1]
    peak[:-1] &= turn[:-1] >= turn[1:]
    cuts = selected[peak]
    chain_starts, chain_stops = starts[long_enough], stops[long_enough]
    trim = np.full(len(cuts), config.trim + 1)
    new_starts = np.concatenate([chain_starts + config.trim, cuts + trim])
    new_stops = np.concatenate([chain_stops - config.trim, cuts - trim])
    return np.sort(new_starts), np.sort(new_stops)


def _turning(points: np.ndarray, offsets: np.ndarray, reach: int) -> np.ndarray:
    """Angle between the chords to the points `reach` before and after; 0 near the ends."""
    lengths = np.diff(offsets)
    label = np.repeat(np.arange(len(lengths)), lengths)
    here = np.arange(len(points))
    low, high = offsets[:-1][label], offsets[1:][label] - 1
    before, after = np.maximum(here - reach, low), np.minimum(here + reach, high)
    a, b = points - points[before], points[after] - points
    turn = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1))
    near_end = (here - low < reach // 2) | (high - here < reach // 2)
    return np.where(near_end, 0.0, np.abs(turn))

"""From Hough maxima to lines with their points, fitted by total least squares.

All geometry here is in the undistorted plane about the centre of distortion. A set of lines over n
points is a table of lines and one label a point; −1 is a point of no line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from classical.baselines.aleman_flores.config import AlemanFloresConfig
from classical.baselines.aleman_flores.hough import HoughMaxima

MERGE_GAP = 10.0
MERGE_FARTHEST = 15.0
MERGE_MEAN = 20.0
MERGE_COSINE = 0.95
"""Merging of the 2016 article: least gap, farthest point and mean distance in px, and the least
cosine of the angle of two lines."""

_NO_LINE = 1e9
_CHUNK = 1 << 16  # pairs of a point and a line worked on together, so that they stay in the cache


@dataclass(frozen=True)
class LineSet:
    """Lines n · x = d and the points that belong to them.

    Attributes:
        normals: Unit normals, shape (m, 2).
        distances: Signed distances to the centre, px, shape (m,).
        labels: Line of each edge point, −1 for none, shape (n,).
    """

    normals: Float[np.ndarray, "m 2"]
    distances: Float[np.ndarray, " m"]
    labels: Int[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.distances)

    @property
    def counts(self) -> Int[np.ndarray, " m"]:
        """Number of points of each line."""
        return np.bincount(self.labels[self.labels >= 0], minlength=len(self))


def lines_from_maxima(
    points: Float[np.ndarray, "n 2"],
    normals: Float[np.ndarray, "n 2"],
    maxima: HoughMaxima,
    *,
    config: AlemanFloresConfig,
) -> LineSet:
    """Collect the points of each maximum, fit, merge, fit, and collect again.

    Args:
        points: Edge points relative to the centre, undistorted with the p of the maxima.
        normals: Their undistorted unit normals.
        maxima: Maxima in the order of picking; a point joins the first line that takes it.
        config: Parameters of the method.
    """
    table = np.stack([np.cos(maxima.angles), np.sin(maxima.angles)], axis=1)
    first = config.line_distance + config.collect_slack
    lines = _collect(points, normals, table, maxima.distances, first, config)
    lines = _kept(points, normals, lines, config)
    lines = _merge_2014(points, lines, config) if config.variant == "2014" else lines
    if config.variant == "2016":
        return _merge_2016(points, normals, lines, config)
    lines = _collect(points, normals, lines.normals, lines.distances, config.line_distance, config)
    return _kept(points, normals, lines, config)


def fit_lines(
    points: Float[np.ndarray, "n 2"], labels: Int[np.ndarray, " n"], count: int
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Total least squares for every line at once.

    Returns:
        normals: Unit normals, shape (m, 2).
        distances: n · x of the points' mean, px.
        errors: Sum of squared distances of a line's points, px².
    """
    member = labels >= 0
    labels, points = labels[member], points[member]
    size = np.maximum(np.bincount(labels, minlength=count), 1)
    mean = np.stack(
        [np.bincount(labels, points[:, i], minlength=count) / size for i in (0, 1)], axis=1
    )
    offset = points - mean[labels]
    xx, xy, yy = (
        np.bincount(labels, offset[:, i] * offset[:, j], minlength=count)
        for i, j in ((0, 0), (0, 1), (1, 1))
    )
    angle = 0.5 * np.arctan2(2 * xy, xx - yy) + np.pi / 2
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    errors = 0.5 * (xx + yy - np.hypot(xx - yy, 2 * xy))
    return normals, (normals * mean).sum(axis=1), np.maximum(errors, 0.0)


def _collect(
    points: np.ndarray,
    normals: np.ndarray,
    line_normals: np.ndarray,
    line_distances: np.ndarray,
    reach: float,
    config: AlemanFloresConfig,
) -> LineSet:
    """Give each point to the first line within the distance and the angle allowed."""
    labels = np.full(len(points), -1, np.intp)
    least = np.cos(np.deg2rad(config.angle_max_deg))
    if len(line_distances):
        chunk = max(_CHUNK // len(line_distances), 1)
        for start in range(0, len(points), chunk):
            part = slice(start, start + chunk)
            near = np.abs(points[part] @ line_normals.T - line_distances) < reach
            row, line = np.divmod(np.flatnonzero(near), len(line_distances))
            agree = np.abs((normals[part][row] * line_normals[line]).sum(axis=1)) > least
            row, line = row[agree][::-1], line[agree][::-1]
            labels[part][row] = line  # written backwards: the first line is written last
    return LineSet(line_normals, line_distances, labels)


def _kept(
    points: np.ndarray, normals: np.ndarray, lines: LineSet, config: AlemanFloresConfig
) -> LineSet:
    """Drop points of the minority polarity (2016), drop weak lines, fit the others."""
    labels = lines.labels.copy()
    if config.variant == "2016" and len(lines):
        labels[_minority(normals, lines)] = -1
    counts = np.bincount(labels[labels >= 0], minlength=len(lines))
    least = max(config.least_points, config.least_share * counts.max(initial=0))
    keep = counts >= least
    return _refitted(points, _renumbered(labels, keep), int(keep.sum()))


def _minority(normals: np.ndarray, lines: LineSet) -> np.ndarray:
    """Points whose edge runs from bright to dark where most of their line's run the other way."""
    member = lines.labels >= 0
    side = np.zeros(len(normals))
    line = lines.labels[member]
    side[member] = np.sign((normals[member] * lines.normals[line]).sum(axis=1))
    balance = np.bincount(line, side[member], minlength=len(lines))
    majority = np.where(balance >= 0, 1.0, -1.0)
    wrong = np.zeros(len(normals), bool)
    wrong[member] = side[member] != majority[line]
    return wrong


def _renumbered(labels: np.ndarray, keep: np.ndarray) -> np.ndarray:
    """Labels after dropping the lines that are not kept."""
    number = np.append(np.where(keep, np.cumsum(keep) - 1, -1), -1)
    return number[labels]


def _refitted(points: np.ndarray, labels: np.ndarray, count: int) -> LineSet:
    normals, distances, _ = fit_lines(points, labels, count)
    return LineSet(normals, distances, labels)


def _merge_2014(points: np.ndarray, lines: LineSet, config: AlemanFloresConfig) -> LineSet:
    """Merge a line into an earlier one that its points lie near to on average."""
    labels, count = lines.labels.copy(), len(lines)
    normals, distances = lines.normals.copy(), lines.distances.copy()
    least = np.cos(np.deg2rad(2 * config.angle_max_deg))
    alive = np.ones(count, bool)
    for k in range(count):
        if not alive[k]:
            continue
        member = np.flatnonzero(labels >= 0)
        gap = np.abs(points[member] @ normals[k] - distances[k])
        size = np.maximum(np.bincount(labels[member], minlength=count), 1)
        mean = np.bincount(labels[member], gap, minlength=count) / size
        into = alive & (np.abs(normals @ normals[k]) > least) & (mean < config.merge_distance)
        into[: k + 1] = False
        if into.any():
            labels[np.append(into, False)[labels]] = k
            alive &= ~into
            merged = np.where(labels == k, 0, -1)
            fitted = fit_lines(points, merged, 1)
            normals[k], distances[k] = fitted[0][0], fitted[1][0]
    return _refitted(points, _renumbered(labels, alive), int(alive.sum()))


def _merge_2016(
    points: np.ndarray, normals: np.ndarray, lines: LineSet, config: AlemanFloresConfig
) -> LineSet:
    """Merge a line into an earlier one that it continues beyond a gap, with the same polarity."""
    count, labels = len(lines), lines.labels.copy()
    if count < 2:
        return lines
    members = [np.flatnonzero(labels == i) for i in range(count)]
    facing = _facing(normals, lines)
    least = max(MERGE_COSINE, np.cos(np.deg2rad(2 * config.angle_max_deg)))
    alive = np.ones(count, bool)
    ends = np.stack([_ends(points[own], lines.normals[i]) for i, own in enumerate(members)])
    for k in range(count):
        if not alive[k]:
            continue
        normal, distance = lines.normals[k], lines.distances[k]
        alike = np.flatnonzero(alive & (facing @ facing[k] > least))
        other: int | None = k
        while other is not None:
            near = (np.abs(ends[alike] @ normal - distance) <= MERGE_FARTHEST).all(axis=1)
            other = next(
                (
                    int(i)
                    for i in alike[near & (alike > other)]
                    if _continues(points[members[k]], points[members[i]], normal, distance)
                ),
                None,
            )
            if other is not None:
                members[k] = np.concatenate([members[k], members[other]])
                labels[members[other]] = k
                alive[other] = False
                fitted = fit_lines(points[members[k]], np.zeros(len(members[k]), np.intp), 1)
                normal, distance = fitted[0][0], fitted[1][0]
    return _refitted(points, _renumbered(labels, alive), int(alive.sum()))


def _facing(normals: np.ndarray, lines: LineSet) -> np.ndarray:
    """Normals of the lines, turned to the side to which their edges grow brighter."""
    member = lines.labels >= 0
    line = lines.labels[member]
    balance = np.bincount(
        line, (normals[member] * lines.normals[line]).sum(axis=1), minlength=len(lines)
    )
    return lines.normals * np.where(balance >= 0, 1.0, -1.0)[:, None]


def _ends(points: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The first and the last point along a line."""
    along = points @ np.array([-normal[1], normal[0]])
    return points[[np.argmin(along), np.argmax(along)]]


def _continues(first: np.ndarray, second: np.ndarray, normal: np.ndarray, distance: float) -> bool:
    """Whether the second line's points lie along the first line, with a gap between the two."""
    off = np.abs(second @ normal - distance)
    if off.max() > MERGE_FARTHEST or off.mean() > MERGE_MEAN:
        return False
    along = np.array([-normal[1], normal[0]])
    a, b = first @ along, second @ along
    return bool(max(b.min() - a.max(), a.min() - b.max()) > MERGE_GAP)

"""Lines that chance alignments of edge points do not explain.

The authors' programs answer for any picture, noise included. Along a chance alignment the points
come from many short edges and break off after a few pixels; along an image of a line they follow
one another. Counted is what unbroken runs of at least 5 % of the longer side cover of a line
together: for the fourth best line this was at most 7 % of the longer side in white, blurred, pink
and two-valued noise, and at least 11 % in drawn grids and bent street and room photographs.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from classical.baselines.aleman_flores.config import AlemanFloresConfig
from classical.baselines.aleman_flores.edges import EdgePoints
from classical.baselines.aleman_flores.lines import LineSet

ANGLE_DEG = 10.0
GAP = {"2014": 3.0, "2016": 7.0}
"""Largest difference of direction of a point on a run, and largest step along it in px; the points
of 2016 are thinned to one in three."""


def significant_lines(
    edges: EdgePoints,
    points: Float[np.ndarray, "n 2"],
    normals: Float[np.ndarray, "n 2"],
    lines: LineSet,
    longer_side: int,
    *,
    config: AlemanFloresConfig,
) -> int:
    """Count the lines of which long unbroken runs of edge points cover enough.

    Args:
        edges: Edge points as seen, where the run is measured.
        points: The same points undistorted, where the lines are straight.
        normals: Their undistorted normals.
        lines: Lines in the undistorted plane.
        longer_side: Longer side of the working picture, px.
        config: Parameters of the method.
    """
    least = config.least_run * longer_side
    cosine = np.cos(np.deg2rad(ANGLE_DEG))
    count = 0
    for normal, distance in zip(lines.normals, lines.distances, strict=True):
        near = np.flatnonzero(np.abs(points @ normal - distance) < config.line_distance)
        near = near[np.abs(normals[near] @ normal) > cosine]
        along = points[near] @ np.array([-normal[1], normal[0]])
        seen = edges.points[near[np.argsort(along)]]
        runs = run_lengths(seen, GAP[config.variant])
        count += int(runs[runs >= least].sum() >= config.least_cover * longer_side)
    return count


def run_lengths(points: Float[np.ndarray, "n 2"], gap: float) -> Float[np.ndarray, " r"]:
    """Distances between the ends of the runs of a sequence of points without a step over `gap`."""
    if len(points) < 2:
        return np.zeros(0)
    breaks = np.flatnonzero(np.hypot(*np.diff(points, axis=0).T) > gap)
    first, last = np.append(0, breaks + 1), np.append(breaks, len(points) - 1)
    return np.hypot(*(points[last] - points[first]).T)

"""Lines that chance alignments of edge points do not explain.

The authors' programs answer for any picture, noise included. Along a chance alignment the points
come from many short edges and break off after a few pixels; along an image of a line they follow
one another. Measured on pictures of 640 px: the fourth longest unbroken run is under 45 px in
white, blurred, pink and two-valued noise, and over 80 px in bent street and room photographs.
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
    """Count the lines along which edge points follow one another for long enough.

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
        count += longest_run(seen, GAP[config.variant]) >= least
    return count


def longest_run(points: Float[np.ndarray, "n 2"], gap: float) -> float:
    """Greatest distance between the ends of a sequence of points without a step over `gap`, px."""
    if len(points) < 2:
        return 0.0
    steps = np.hypot(*np.diff(points, axis=0).T)
    breaks = np.flatnonzero(steps > gap)
    first, last = np.append(0, breaks + 1), np.append(breaks, len(points) - 1)
    return float(np.hypot(*(points[last] - points[first]).T).max())

"""The border of an image circle, told by arcs that share one circle around the picture's middle.

A line's image has its centre of curvature away from the distortion centre, unless the line is seen
at 90° from the axis. So arcs of one circle around the middle of the picture that cover much of it
are the border of the image circle, the rim of the lens or a reflection of either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int


@dataclass(frozen=True)
class CircleConfig:
    """What counts as the border of an image circle.

    Attributes:
        max_offset: Largest distance of its centre from the picture's, as a share of the shorter
            side.
        min_radius: Smallest radius, as a share of the shorter side.
        min_extent: Arcs that turn less do not propose a circle, radians.
        min_support: Sum of the angles of arcs on one circle that makes it a border, radians.
        width: Points this near to the circle are on it, as a share of its radius.
    """

    max_offset: float = 0.05
    min_radius: float = 0.3
    min_extent: float = 0.35
    min_support: float = 1.5
    width: float = 0.01


def on_border_circle(
    points: Float[np.ndarray, "m 2"],
    offsets: Int[np.ndarray, " p1"],
    width: int,
    height: int,
    *,
    config: CircleConfig,
) -> Bool[np.ndarray, " p"]:
    """True for curves on a circle that arcs around the picture's middle agree on.

    Args:
        points: Points in order along curves, shape (m, 2).
        offsets: Curve p is points[offsets[p] : offsets[p + 1]], shape (p + 1,).
        width: Picture width, pixels.
        height: Picture height, pixels.
        config: What counts as a border.
    """
    side = min(width, height)
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    centres, radii = fit_circles(points, offsets)
    ends = points[offsets[:-1]], points[offsets[1:] - 1]
    chords = np.hypot(*(ends[1] - ends[0]).T)
    extents = 2 * np.arcsin(np.clip(chords / (2 * radii), 0, 1))
    near = np.hypot(*(centres - middle).T) < config.max_offset * side
    near &= (radii > config.min_radius * side) & (extents > config.min_extent)
    reject = np.zeros(len(offsets) - 1, dtype=bool)
    for k in np.flatnonzero(near):
        distance = np.hypot(*(points - centres[k]).T) - radii[k]
        margin = config.width * radii[k]
        on_it = _mostly(np.abs(distance) < margin, offsets)
        if extents[on_it & near].sum() >= config.min_support:
            reject |= on_it
    return reject


def fit_circles(
    points: Float[np.ndarray, "m 2"], offsets: Int[np.ndarray, " p1"]
) -> tuple[Float[np.ndarray, "p 2"], Float[np.ndarray, " p"]]:
    """Algebraic circle through each curve (Kåsa): centres and radii; huge for straight curves.

    Kåsa's fit draws short arcs inwards; over 20° and more with edges good to a fraction of a pixel
    the error is below a hundredth of the radius.
    """
    first, counts = offsets[:-1], np.diff(offsets)
    x, y = np.array(points.T, order="C")
    middle_x, middle_y = (np.add.reduceat(row, first) / counts for row in (x, y))
    x -= np.repeat(middle_x, counts)
    y -= np.repeat(middle_y, counts)
    squared = x * x + y * y
    size = np.add.reduceat(squared, first) / counts  # x and y are in units of its root
    # x and y sum to zero, so two of the three equations have two unknowns; straight curves make
    # them singular; a little regularisation sends their radius far away
    xx, xy = (np.add.reduceat(x * row, first) / size for row in (x, y))
    yy = counts - xx + 1e-9 * counts
    xx = xx + 1e-9 * counts
    right_x, right_y = (np.add.reduceat(row * squared, first) / size**1.5 for row in (x, y))
    determinant = 2 * (xx * yy - xy * xy)
    centre_x = (right_x * yy - right_y * xy) / determinant
    centre_y = (right_y * xx - right_x * xy) / determinant
    offset = 1 / (1 + 1e-9)
    radius = np.sqrt(np.maximum(offset + centre_x * centre_x + centre_y * centre_y, 1e-12))
    scale = np.sqrt(size)
    centres = np.stack([middle_x + centre_x * scale, middle_y + centre_y * scale], axis=1)
    return centres, radius * scale


def _mostly(flags: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """True for curves of which more than half the points are flagged."""
    return np.add.reduceat(flags.astype(float), offsets[:-1]) > 0.5 * np.diff(offsets)

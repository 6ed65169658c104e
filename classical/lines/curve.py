"""The one type of curve: an ordered polyline of sub-pixel points, from whatever source."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

REFERENCE_WIDTH = 1280  # most tolerances are pixels of a picture this wide


@dataclass(frozen=True, eq=False)
class Curve:
    """A smooth curve in a picture that may be the image of a straight line.

    Attributes:
        points: Pixels (u, v) in order along the curve, top-left pixel's centre = (0, 0), shape
            (n, 2). Steps need not be equal; joined curves have gaps.
        sigma: Standard deviation of a point across the curve, pixels.
        strength: How surely this is an image of a line, in [0, 1].
        is_hinted: Whether it was taken for a line only because a heatmap is hot there.
    """

    points: Float[np.ndarray, "n 2"]
    sigma: float
    strength: float
    is_hinted: bool = False

    def __post_init__(self) -> None:
        points = np.array(self.points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2:
            raise ValueError(f"Expected points of shape (n >= 2, 2), got {points.shape}.")
        if not np.isfinite(points).all():
            raise ValueError("Expected finite points, got a NaN or an infinity.")
        if not self.sigma > 0 or not 0 <= self.strength <= 1:
            raise ValueError(
                "Expected sigma > 0 and strength in [0, 1], "
                f"got sigma={self.sigma:g} and strength={self.strength:g}."
            )
        points.setflags(write=False)
        object.__setattr__(self, "points", points)

    @cached_property
    def arc_length(self) -> Float[np.ndarray, " n"]:
        """Length along the polyline from its start to each point, gaps included, pixels."""
        step = self.points[1:] - self.points[:-1]
        length = np.zeros(len(self.points))
        np.hypot(step[:, 0], step[:, 1], out=length[1:])
        return np.cumsum(length, out=length)

    @property
    def length(self) -> float:
        """Length along the polyline, gaps included, pixels."""
        return float(self.arc_length[-1])

    @property
    def chord(self) -> float:
        """Distance between the two ends, pixels."""
        return float(np.hypot(*(self.points[-1] - self.points[0])))

    def thinned(self, spacing: float) -> Float[np.ndarray, "_ 2"]:
        """Points about `spacing` pixels apart, each the mean of its neighbours on the curve.

        The curve is cut into stretches of equal length and the points of a stretch are averaged,
        which keeps what they know; stretches without points (gaps) give none. On a bend of radius
        R the mean lies spacing² / 24 R inside, a hundredth of a pixel for 5 px and R = 100 px.

        Args:
            spacing: Distance between points, pixels.

        Returns:
            The points, in order; all of them where they are that sparse already.
        """
        return thinned_curves([self], [spacing])[0]


def thinned_curves(
    curves: Sequence[Curve], spacings: Sequence[float]
) -> tuple[Float[np.ndarray, "m 2"], Int[np.ndarray, " c"]]:
    """What `Curve.thinned` gives of each curve: the points, one curve after another, and counts.

    Args:
        curves: At least one curve.
        spacings: Distance between the points of each, pixels.
    """
    if not all(spacing > 0 for spacing in spacings):
        raise ValueError(f"Expected spacing > 0, got {min(spacings):g}.")
    sizes = np.array([len(curve.points) for curve in curves])
    lengths = np.array([curve.length for curve in curves])
    number = np.maximum(np.round(lengths / spacings), 1).astype(np.int64)
    kept = (number < 2) | (number >= sizes)  # curves that stay as they are
    scale = np.where(kept, 0.0, number / np.where(kept, 1.0, lengths))
    cell = np.concatenate([curve.arc_length for curve in curves]) * np.repeat(scale, sizes)
    cell = np.minimum(cell.astype(np.int64), np.repeat(number - 1, sizes))
    first = np.cumsum(sizes) - sizes
    is_start = np.repeat(kept, sizes)
    is_start[1:] |= cell[1:] != cell[:-1]
    is_start[first] = True
    starts = np.flatnonzero(is_start)
    members = np.diff(starts, append=len(cell))
    points = np.add.reduceat(np.concatenate([curve.points for curve in curves]), starts)
    return points / members[:, None], np.add.reduceat(is_start, first, dtype=np.int64)

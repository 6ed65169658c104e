"""Points of many curves in flat arrays, the form in which the fit reads them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from classical.lines import Curve
from classical.lines.curve import thinned_curves


@dataclass(frozen=True)
class CurveSamples:
    """Evenly thinned points of C curves, one after the other.

    Attributes:
        points: Pixels of all curves, shape (n, 2).
        starts: Index of each curve's first point, shape (C,).
        spans: Length in pixels that each point stands for, shape (n,).
        pictures: Number of the picture each curve lies in, shape (C,); None where all lie in one.
    """

    points: Float[np.ndarray, "n 2"]
    starts: Int[np.ndarray, " curves"]
    spans: Float[np.ndarray, " n"]
    pictures: Int[np.ndarray, " curves"] | None = None

    @property
    def n_curves(self) -> int:
        """Number of curves."""
        return len(self.starts)

    @cached_property
    def counts(self) -> Int[np.ndarray, " curves"]:
        """Points a curve, shape (C,)."""
        return np.diff(np.append(self.starts, len(self.points)))

    @cached_property
    def u(self) -> Float[np.ndarray, " n"]:
        """First coordinate of all points."""
        return np.ascontiguousarray(self.points[:, 0])

    @cached_property
    def v(self) -> Float[np.ndarray, " n"]:
        """Second coordinate of all points."""
        return np.ascontiguousarray(self.points[:, 1])

    @cached_property
    def lengths(self) -> Float[np.ndarray, " curves"]:
        """Length of each curve in pixels."""
        return self.curve_sums(self.spans)

    @cached_property
    def owner(self) -> Int[np.ndarray, " n"]:
        """Index of the curve that each point belongs to, shape (n,)."""
        return np.repeat(np.arange(self.n_curves), self.counts)

    def curve_sums(self, values: np.ndarray) -> np.ndarray:
        """Sum `values` (n, …) over each curve: shape (C, …)."""
        return np.add.reduceat(values, self.starts, axis=0)

    def curve_rms(self, residuals: Float[np.ndarray, " n"]) -> Float[np.ndarray, " curves"]:
        """Root mean square of the residuals of each curve."""
        return np.sqrt(self.curve_sums(residuals**2) / self.counts)

    def coarse(self, *, curves: int, most: int) -> CurveSamples:
        """The longest `curves` curves with about `most` of their samples each, evenly picked."""
        lengths = self.lengths
        chosen = np.sort(np.argsort(-lengths, kind="stable")[:curves])
        picks = []
        for first, count in zip(self.starts[chosen], self.counts[chosen], strict=True):
            kept = min(int(count), most)
            picks.append(first + np.round(np.linspace(0, count - 1, kept)).astype(int))
        counts = np.array([len(pick) for pick in picks])
        starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
        spans = np.repeat(lengths[chosen] / counts, counts)
        pictures = None if self.pictures is None else self.pictures[chosen]
        return CurveSamples(self.points[np.concatenate(picks)], starts, spans, pictures)


def sample_curves(
    curves: Sequence[Curve],
    *,
    spacing: float,
    least: int = 6,
    most: int = 24,
    pictures: Int[np.ndarray, " curves"] | None = None,
) -> CurveSamples:
    """Thin each curve to points about `spacing` pixels apart.

    A sample is the mean of the points around it (`Curve.thinned`), so that the noise of
    neighbouring edge points is averaged and not thrown away.

    Args:
        curves: At least one curve.
        spacing: Wanted distance between samples, pixels.
        least: Fewest samples a curve.
        most: Most samples a curve.
        pictures: Number of the picture each curve lies in.

    Raises:
        ValueError: If there is no curve.
    """
    if not curves:
        raise ValueError("Expected at least one curve, got none.")
    lengths = np.array([curve.length for curve in curves])
    wanted = np.clip(np.round(lengths / spacing), least, most)
    points, counts = thinned_curves(curves, (lengths / wanted).tolist())
    starts = np.cumsum(counts) - counts
    spans = np.repeat(lengths / counts, counts)
    return CurveSamples(points, starts, spans, pictures)

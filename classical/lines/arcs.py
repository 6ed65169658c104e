"""Arcs: pieces of points on their way from edges or ridges to curves.

What follows the detection of points is one and the same for pictures and heatmaps: points are
linked to chains, chains are cut into smooth arcs, arcs are joined, what no lens could have made of
a line is dropped, and positions are refined on the full picture.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from classical.lines.chains import link_points
from classical.lines.circle import on_border_circle
from classical.lines.continuation import ContinuationConfig, continue_arcs
from classical.lines.curve import Curve
from classical.lines.edges import EdgePoints
from classical.lines.pieces import fit_by_length, ranked
from classical.lines.rejection import (
    RejectionConfig,
    Surround,
    beside_frame,
    beside_surround,
    impossible_bend,
)
from classical.lines.smooth import SmoothConfig, inliers, smooth_arcs
from classical.lines.snap import SnapConfig, snap_to_edges

_MIN_SIGMA = 0.05  # pixels; no edge is placed better
_OUTLIER_FLOOR = 0.25  # working pixels; points nearer to their arc than this are never dropped
_HALF_CONTRAST = 20.0  # grey levels at which an edge has strength 1/2


@dataclass(frozen=True)
class Arcs:
    """Pieces of points in order.

    Attributes:
        points: Pixels (u, v), one piece after another, shape (m, 2).
        contrast: Height of the edge, or heat of the ridge, at each point, shape (m,).
        offsets: Piece p is points[offsets[p] : offsets[p + 1]], shape (p + 1,).
    """

    points: Float[np.ndarray, "m 2"]
    contrast: Float[np.ndarray, " m"]
    offsets: Int[np.ndarray, " p1"]

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def taken(self, selected: Int[np.ndarray, " k"], offsets: Int[np.ndarray, " q1"]) -> Arcs:
        """Other pieces, made of the points `selected`."""
        return Arcs(self.points.take(selected, axis=0), self.contrast[selected], offsets)

    def chosen(self, keep: Bool[np.ndarray, " p"]) -> Arcs:
        """The pieces for which `keep` holds."""
        lengths = np.diff(self.offsets)
        inside = np.repeat(keep, lengths)
        offsets = np.concatenate([[0], np.cumsum(lengths[keep])]).astype(np.int64)
        return Arcs(self.points[inside], self.contrast[inside], offsets)

    def only(self, inside: Bool[np.ndarray, " m"]) -> Arcs:
        """All pieces with those of their points for which `inside` holds, at least one in each."""
        counts = np.add.reduceat(inside.astype(np.int64), self.offsets[:-1])
        offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        return Arcs(self.points[inside], self.contrast[inside], offsets)

    def share(self, flags: Bool[np.ndarray, " m"]) -> Float[np.ndarray, " p"]:
        """Share of the points of each piece for which `flags` holds."""
        if not len(self):
            return np.empty(0)
        return np.add.reduceat(flags.astype(float), self.offsets[:-1]) / np.diff(self.offsets)

    def chords(self) -> Float[np.ndarray, " p"]:
        """Distance between the ends of each piece, pixels."""
        return np.hypot(*(self.points[self.offsets[1:] - 1] - self.points[self.offsets[:-1]]).T)


def link_arcs(
    source: EdgePoints, *, directed: bool, smooth: SmoothConfig, continuation: ContinuationConfig
) -> Arcs:
    """Points linked, cut into smooth arcs and joined."""
    chains = link_points(source, directed=directed, min_points=smooth.min_points)
    arcs = Arcs(
        source.points.take(chains.order, axis=0), source.contrast[chains.order], chains.offsets
    )
    arcs = arcs.taken(*smooth_arcs(arcs.points, arcs.offsets, config=smooth))
    return arcs.taken(*continue_arcs(arcs.points, arcs.offsets, config=continuation))


def plausible_arcs(arcs: Arcs, surround: Surround, config: RejectionConfig) -> Arcs:
    """Arcs that a lens could have made of lines."""
    if not len(arcs):
        return arcs
    width, height = surround.width, surround.height
    reject = beside_surround(arcs.points, arcs.offsets, surround, config=config)
    reject |= beside_frame(arcs.points, arcs.offsets, width, height, config=config)
    reject |= on_border_circle(arcs.points, arcs.offsets, width, height, config=config.circle)
    reject |= impossible_bend(
        arcs.points, arcs.offsets, width, height, surround.radius, config=config
    )
    return arcs.chosen(~reject)


def longest_arcs(arcs: Arcs, most: int) -> Arcs:
    """The longest arcs, in the order in which they came."""
    if len(arcs) <= most:
        return arcs
    chords = arcs.chords()
    return arcs.chosen(chords >= np.sort(chords)[-most])


def finish_curves(
    arcs: Arcs, full: np.ndarray, scale: np.ndarray, refinement: SnapConfig
) -> list[Curve]:
    """Curves of the full picture from arcs of the working picture."""
    if not len(arcs):
        return []
    arcs = Arcs((arcs.points + 0.5) / scale - 0.5, arcs.contrast, arcs.offsets)
    pixels = 1 / float(scale.mean())  # of the full picture per working pixel
    if pixels > 1:
        arcs = _refined(arcs, full, 1.5 * pixels, refinement)
    near = inliers(arcs.points, arcs.offsets, floor=_OUTLIER_FLOOR * pixels)
    arcs = arcs.only(near)
    sigma = np.maximum(fit_by_length(arcs.points, arcs.offsets).rms, _MIN_SIGMA)
    counts = np.diff(arcs.offsets)
    low, high = (ranked(arcs.contrast, arcs.offsets, k // 2) for k in (counts - 1, counts))
    level = (low + high) / 2
    strength = level / (level + _HALF_CONTRAST)
    pieces = zip(itertools.pairwise(arcs.offsets.tolist()), sigma, strength, strict=True)
    curves = [Curve(arcs.points[a:b], float(s), float(t)) for (a, b), s, t in pieces]
    return sorted(curves, key=lambda curve: -curve.length)


def contrast_of_strength(strength: float) -> float:
    """The contrast in grey levels behind a curve's strength."""
    return _HALF_CONTRAST * strength / max(1 - strength, 1e-6)


def _refined(arcs: Arcs, full: np.ndarray, reach: float, config: SnapConfig) -> Arcs:
    """Points placed again on the full picture; curves along which that finds little stay."""
    snapped = snap_to_edges(full, arcs.points, arcs.offsets, reach=reach, config=config)
    moved = Arcs(snapped.points, snapped.contrast, snapped.offsets)
    well = moved.share(snapped.found) >= 0.5
    moved = moved.chosen(well)
    if well.any():
        moved = moved.only(snapped.found[np.repeat(well, np.diff(snapped.offsets))])
    left = arcs.chosen(~well)
    return Arcs(
        np.concatenate([moved.points, left.points]),
        np.concatenate([moved.contrast, left.contrast]),
        np.concatenate([moved.offsets, moved.offsets[-1] + left.offsets[1:]]),
    )

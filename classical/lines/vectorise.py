"""The vectoriser: from a picture, or from a heatmap beside it, to curves.

Both sources give points (edges of the picture, ridges of the heatmap), and all that follows is the
same: points are linked to chains, chains are cut into smooth arcs, arcs are joined, what no lens
could have made of a line is dropped, and positions are refined on the full picture.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from classical.lines.chains import link_points
from classical.lines.circle import on_border_circle
from classical.lines.continuation import ContinuationConfig, continue_arcs
from classical.lines.curve import Curve
from classical.lines.edges import EdgeConfig, EdgePoints, detect_edges
from classical.lines.rejection import (
    RejectionConfig,
    beside_frame,
    beside_surround,
    find_surround,
    impossible_bend,
)
from classical.lines.ridges import RidgeConfig, detect_ridges
from classical.lines.smooth import SmoothConfig, fit_by_length, inliers, smooth_arcs
from classical.lines.snap import SnapConfig, snap_to_edges

_MIN_SIGMA = 0.05  # pixels; no edge is placed better
_OUTLIER_FLOOR = 0.25  # working pixels; points nearer to their arc than this are never dropped
_SNAP_FLOOR = 0.6  # the same after snapping, where the path may still follow two edges
_HALF_CONTRAST = 20.0  # grey levels at which an edge has strength 1/2


@dataclass(frozen=True)
class ImageCurvesConfig:
    """How curves are taken from a picture.

    Attributes:
        max_size: Larger pictures are reduced to this longest side first, and positions refined on
            the full picture afterwards, pixels.
        min_size: Smaller pictures are enlarged to this longest side first, but at most twice;
            measured on real pictures, the fitted lens then errs by a third less.
        min_length: Shortest curve, pixels of the picture that is worked on …
        min_length_share: … and as a share of its longest side; the larger counts.
        max_curves: At most so many curves are returned, the longest ones.
        edges: What counts as an edge.
        smooth: What counts as a smooth arc.
        continuation: When arcs are joined.
        rejection: What no lens could have made.
        refinement: How positions are refined when the picture was reduced.
    """

    max_size: int = 1600
    min_size: int = 1400
    min_length: float = 24.0
    min_length_share: float = 0.03
    max_curves: int = 300
    edges: EdgeConfig = field(default_factory=EdgeConfig)
    smooth: SmoothConfig = field(default_factory=SmoothConfig)
    continuation: ContinuationConfig = field(default_factory=ContinuationConfig)
    rejection: RejectionConfig = field(default_factory=RejectionConfig)
    refinement: SnapConfig = field(default_factory=lambda: SnapConfig(spacing=2.0, sigma=1.6))


@dataclass(frozen=True)
class HeatmapCurvesConfig:
    """How curves are taken from a heatmap.

    Attributes:
        max_size: Larger pictures are reduced to this longest side for snapping, pixels; positions
            are refined on the full picture afterwards.
        reach: Edges are sought this far beside a centre line, pixels of the heatmap.
        min_length: Shortest curve, pixels of the heatmap.
        min_found: Curves along which a smaller share of points has an edge stay on their centre
            line, with the larger uncertainty of it.
        centre_sigma: Standard deviation of such a centre line, pixels of the heatmap.
        max_curves: At most so many curves are returned, the longest ones.
        ridges: What counts as a ridge.
        smooth: What counts as a smooth arc of the heatmap.
        continuation: When arcs of the heatmap are joined.
        snapping: How edges beside a centre line are found.
        snapped: What counts as a smooth arc of edges.
        rejection: What no lens could have made.
        refinement: How positions are refined when the picture was reduced.
    """

    max_size: int = 1600
    reach: float = 1.5
    min_length: float = 10.0
    min_found: float = 0.4
    centre_sigma: float = 0.4
    max_curves: int = 300
    ridges: RidgeConfig = field(default_factory=RidgeConfig)
    smooth: SmoothConfig = field(
        default_factory=lambda: SmoothConfig(
            min_points=5, corner_reach=4, corner_angle=0.5, trim=1, max_rms=0.4
        )
    )
    continuation: ContinuationConfig = field(
        default_factory=lambda: ContinuationConfig(max_gap=16.0, max_gap_share=1.0, max_rms=0.4)
    )
    snapping: SnapConfig = field(default_factory=SnapConfig)
    snapped: SmoothConfig = field(
        default_factory=lambda: SmoothConfig(trim=2, corner_angle=0.5, max_rms=0.4)
    )
    rejection: RejectionConfig = field(default_factory=RejectionConfig)
    refinement: SnapConfig = field(default_factory=lambda: SnapConfig(spacing=2.0, sigma=1.6))


@dataclass(frozen=True)
class _Arcs:
    """Pieces of points in order; one value of `contrast` a point."""

    points: Float[np.ndarray, "m 2"]
    contrast: Float[np.ndarray, " m"]
    offsets: np.ndarray

    def taken(self, selected: np.ndarray, offsets: np.ndarray) -> _Arcs:
        return _Arcs(self.points[selected], self.contrast[selected], offsets)

    def chosen(self, keep: np.ndarray) -> _Arcs:
        """The pieces for which `keep` holds."""
        lengths = np.diff(self.offsets)
        inside = np.repeat(keep, lengths)
        offsets = np.concatenate([[0], np.cumsum(lengths[keep])])
        return _Arcs(self.points[inside], self.contrast[inside], offsets)

    def only(self, inside: np.ndarray) -> _Arcs:
        """All pieces with those of their points for which `inside` holds."""
        counts = np.add.reduceat(inside.astype(np.int64), self.offsets[:-1])
        offsets = np.concatenate([[0], np.cumsum(counts)])
        return _Arcs(self.points[inside], self.contrast[inside], offsets)

    def chords(self) -> np.ndarray:
        return np.hypot(*(self.points[self.offsets[1:] - 1] - self.points[self.offsets[:-1]]).T)

    def __len__(self) -> int:
        return len(self.offsets) - 1


def curves_from_image(
    image: UInt8[np.ndarray, "h w *c"], *, config: ImageCurvesConfig = ImageCurvesConfig()
) -> list[Curve]:
    """Find smooth edge curves that may be images of straight lines.

    Args:
        image: Grey (h, w) or RGB (h, w, 3), uint8.
        config: How curves are taken.

    Returns:
        Curves in pixels of `image`, the longest first.
    """
    full = _grey(image)
    work, scale = _working_picture(full, config.max_size, config.min_size)
    edges = detect_edges(work, config=config.edges)
    arcs = _arcs_of(edges, True, config.smooth, config.continuation)
    shortest = max(config.min_length, config.min_length_share * max(work.shape))
    arcs = arcs.chosen(arcs.chords() >= shortest)
    arcs = _plausible(arcs, work, config.rejection)
    arcs = _longest(arcs, config.max_curves)
    return _finished(arcs, full, scale, config.refinement)


def curves_from_heatmap(
    heatmap: Float[np.ndarray, "hh ww"],
    image: UInt8[np.ndarray, "h w *c"],
    *,
    config: HeatmapCurvesConfig = HeatmapCurvesConfig(),
) -> list[Curve]:
    """Find the curves that a heatmap marks, placed on the edges of the picture beside them.

    Args:
        heatmap: Heat per pixel, high on lines, of the same view as `image` at any resolution.
        image: Grey (h, w) or RGB (h, w, 3), uint8.
        config: How curves are taken.

    Returns:
        Curves in pixels of `image`, the longest first.
    """
    if heatmap.ndim != 2:
        raise ValueError(f"Expected a heatmap of shape (h, w), got {heatmap.shape}.")
    full = _grey(image)
    work, scale = _working_picture(full, config.max_size, 0)
    ridges = detect_ridges(heatmap, config=config.ridges)
    centre = _arcs_of(ridges, False, config.smooth, config.continuation)
    centre = centre.chosen(centre.chords() >= config.min_length)
    if not len(centre):
        return []
    ratio = scale * full.shape[::-1] / np.array(heatmap.shape[::-1])
    centre = _Arcs((centre.points + 0.5) * ratio - 0.5, centre.contrast, centre.offsets)
    arcs, unsnapped = _snapped(centre, work, float(ratio.mean()), config)
    arcs = _longest(_plausible(arcs, work, config.rejection), config.max_curves)
    unsnapped = _longest(_plausible(unsnapped, work, config.rejection), config.max_curves)
    curves = _finished(arcs, full, scale, config.refinement)
    sigma = config.centre_sigma * float((ratio / scale).mean())
    curves += [
        Curve((unsnapped.points[a:b] + 0.5) / scale - 0.5, sigma, 0.1)
        for a, b in zip(unsnapped.offsets[:-1], unsnapped.offsets[1:], strict=True)
    ]
    return sorted(curves, key=lambda curve: -curve.length)[: config.max_curves]


def _grey(image: np.ndarray) -> np.ndarray:
    """Grey uint8 picture."""
    if image.dtype != np.uint8 or image.ndim not in (2, 3):
        raise ValueError(f"Expected uint8 (h, w) or (h, w, 3), got {image.dtype} {image.shape}.")
    if image.ndim == 2:
        return np.ascontiguousarray(image)
    if image.shape[2] != 3:
        raise ValueError(f"Expected 3 channels, got {image.shape[2]}.")
    return cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)


def _working_picture(
    grey: np.ndarray, max_size: int, min_size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Float picture of a workable size, and its pixels per pixel of the input along u and v."""
    longest = max(grey.shape)
    scale = max_size / longest if longest > max_size else min(max(min_size / longest, 1.0), 2.0)
    height, width = grey.shape
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    if scale != 1.0:
        kind = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
        grey = cv2.resize(grey, size, interpolation=kind)
    return grey.astype(np.float32), np.array([size[0] / width, size[1] / height])


def _arcs_of(
    source: EdgePoints, directed: bool, smooth: SmoothConfig, continuation: ContinuationConfig
) -> _Arcs:
    """Points linked, cut into smooth arcs and joined."""
    chains = link_points(source, directed=directed, min_points=smooth.min_points)
    arcs = _Arcs(source.points[chains.order], source.contrast[chains.order], chains.offsets)
    arcs = arcs.taken(*smooth_arcs(arcs.points, arcs.offsets, config=smooth))
    return arcs.taken(*continue_arcs(arcs.points, arcs.offsets, config=continuation))


def _snapped(
    centre: _Arcs, work: np.ndarray, ratio: float, config: HeatmapCurvesConfig
) -> tuple[_Arcs, _Arcs]:
    """Centre lines moved to edges, and those beside which there is none."""
    reach = max(config.reach * ratio, 2.0)
    snapped = snap_to_edges(
        work, centre.points, centre.offsets, reach=reach, config=config.snapping
    )
    counts = np.diff(snapped.offsets)
    share = np.add.reduceat(snapped.found.astype(float), snapped.offsets[:-1]) / counts
    on_edge = share >= config.min_found
    arcs = _Arcs(snapped.points, snapped.contrast, snapped.offsets)
    arcs = arcs.chosen(on_edge)
    if len(arcs):
        arcs = arcs.only(snapped.found[np.repeat(on_edge, counts)])
        arcs = arcs.only(inliers(arcs.points, arcs.offsets, floor=_SNAP_FLOOR))
    arcs = arcs.taken(*smooth_arcs(arcs.points, arcs.offsets, config=config.snapped))
    arcs = arcs.taken(*continue_arcs(arcs.points, arcs.offsets))
    return arcs, centre.chosen(~on_edge)


def _plausible(arcs: _Arcs, work: np.ndarray, config: RejectionConfig) -> _Arcs:
    """Arcs that a lens could have made of lines."""
    if not len(arcs):
        return arcs
    height, width = work.shape
    surround = find_surround(work)
    reject = beside_surround(arcs.points, arcs.offsets, surround, config=config)
    reject |= beside_frame(arcs.points, arcs.offsets, width, height, config=config)
    reject |= on_border_circle(arcs.points, arcs.offsets, width, height, config=config.circle)
    reject |= impossible_bend(
        arcs.points, arcs.offsets, width, height, surround.radius, config=config
    )
    return arcs.chosen(~reject)


def _longest(arcs: _Arcs, most: int) -> _Arcs:
    """The longest arcs, in the order in which they came."""
    if len(arcs) <= most:
        return arcs
    chords = arcs.chords()
    return arcs.chosen(chords >= np.sort(chords)[-most])


def _finished(
    arcs: _Arcs, full: np.ndarray, scale: np.ndarray, refinement: SnapConfig
) -> list[Curve]:
    """Curves of the full picture from arcs of the working picture."""
    if not len(arcs):
        return []
    arcs = _Arcs((arcs.points + 0.5) / scale - 0.5, arcs.contrast, arcs.offsets)
    pixels = 1 / float(scale.mean())  # of the full picture per working pixel
    if pixels > 1:
        arcs = _refined(arcs, full, 1.5 * pixels, refinement)
    near = inliers(arcs.points, arcs.offsets, floor=_OUTLIER_FLOOR * pixels)
    arcs = arcs.only(near)
    rms_of_arcs = fit_by_length(arcs.points, arcs.offsets).rms
    curves = []
    for rms, start, stop in zip(rms_of_arcs, arcs.offsets[:-1], arcs.offsets[1:], strict=True):
        level = float(np.median(arcs.contrast[start:stop]))
        strength = level / (level + _HALF_CONTRAST)
        curves.append(Curve(arcs.points[start:stop], max(float(rms), _MIN_SIGMA), strength))
    return sorted(curves, key=lambda curve: -curve.length)


def _refined(arcs: _Arcs, full: np.ndarray, reach: float, config: SnapConfig) -> _Arcs:
    """Points placed again on the full picture; curves along which that finds little stay."""
    snapped = snap_to_edges(full, arcs.points, arcs.offsets, reach=reach, config=config)
    counts = np.diff(snapped.offsets)
    share = np.add.reduceat(snapped.found.astype(float), snapped.offsets[:-1]) / counts
    well = share >= 0.5
    moved = _Arcs(snapped.points, snapped.contrast, snapped.offsets).chosen(well)
    if well.any():
        moved = moved.only(snapped.found[np.repeat(well, counts)])
    left = arcs.chosen(~well)
    return _Arcs(
        np.concatenate([moved.points, left.points]),
        np.concatenate([moved.contrast, left.contrast]),
        np.concatenate([moved.offsets, moved.offsets[-1] + left.offsets[1:]]),
    )

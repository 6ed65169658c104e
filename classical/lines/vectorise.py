"""The vectoriser: from a picture, or from a heatmap beside it, to curves.

A picture gives edge points. A heatmap gives those of them that lie where it is hot; and where the
picture has no edge that is good enough by itself, its own centre lines, snapped to what edge there
is. All that follows is the same, see `arcs`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from classical.lines.arcs import Arcs, finish_curves, link_arcs, longest_arcs, plausible_arcs
from classical.lines.continuation import ContinuationConfig, continue_arcs
from classical.lines.curve import Curve
from classical.lines.edges import EdgeConfig, EdgePoints, detect_edges
from classical.lines.rejection import RejectionConfig, Surround, find_surround
from classical.lines.ridges import RidgeConfig, detect_ridges, smoothed_heat
from classical.lines.smooth import SmoothConfig, inliers, smooth_arcs
from classical.lines.snap import SnapConfig, sample, snap_to_edges
from classical.lines.working import grey_picture, working_picture

_SNAP_FLOOR = 0.6  # working pixels; a snapped path may still follow two edges in turn


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
        image: How edges of the picture become curves where the heatmap is hot.
        reach: Edges are sought this far beside a centre line, pixels of the heatmap.
        min_length: Shortest centre line, pixels of the heatmap.
        min_found: Curves along which a smaller share of points has an edge stay on their centre
            line, with the larger uncertainty of it.
        centre_sigma: Standard deviation of such a centre line, pixels of the heatmap.
        min_heat: Smallest mean heat beside a curve, as a share of the hottest pixel.
        max_covered: Centre lines of which a larger share lies beside curves are not used.
        ridges: What counts as a ridge, and as hot.
        smooth: What counts as a smooth arc of the heatmap.
        continuation: When arcs of the heatmap are joined.
        snapping: How edges beside a centre line are found.
        snapped: What counts as a smooth arc of edges beside a centre line.
    """

    image: ImageCurvesConfig = field(
        default_factory=lambda: ImageCurvesConfig(min_length_share=0.02)
    )
    reach: float = 1.5
    min_length: float = 10.0
    min_found: float = 0.4
    centre_sigma: float = 0.4
    min_heat: float = 0.15
    max_covered: float = 0.4
    ridges: RidgeConfig = field(default_factory=RidgeConfig)
    smooth: SmoothConfig = field(
        default_factory=lambda: SmoothConfig(
            min_points=5, corner_reach=4, corner_angle=0.5, trim=1, max_rms=0.5
        )
    )
    continuation: ContinuationConfig = field(
        default_factory=lambda: ContinuationConfig(max_gap=16.0, max_gap_share=1.0, max_rms=0.5)
    )
    snapping: SnapConfig = field(default_factory=lambda: SnapConfig(min_contrast=3.0))
    snapped: SmoothConfig = field(
        default_factory=lambda: SmoothConfig(trim=2, corner_angle=0.5, max_rms=0.4)
    )


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
    full = grey_picture(image)
    work, scale = working_picture(full, config.min_size, config.max_size)
    arcs = _edge_arcs(detect_edges(work, config=config.edges), find_surround(work), config)
    arcs = longest_arcs(arcs, config.max_curves)
    return finish_curves(arcs, full, scale, config.refinement)


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
    full = grey_picture(image)
    work, scale = working_picture(full, config.image.min_size, config.image.max_size)
    wide, threshold = _wide_heat(heatmap, config)
    ridges = detect_ridges(heatmap, config=config.ridges)
    edges = _hot_edges(detect_edges(work, config=config.image.edges), wide, threshold)
    edges = _along_ridges(edges, ridges, config.reach)
    surround = find_surround(work)
    arcs = _edge_arcs(edges, surround, config.image)
    centre = _centre_lines(ridges, arcs, work, config)
    snapped, unsnapped = _snapped(centre, work, work.shape[1] / heatmap.shape[1], surround, config)
    curves = [
        curve
        for part in (arcs, snapped)
        for curve in finish_curves(part, full, scale, config.image.refinement)
    ]
    curves += _unsnapped_curves(unsnapped, scale, full.shape[1] / heatmap.shape[1], config)
    curves = [curve for curve in _heated(curves, wide, full) if curve.strength >= config.min_heat]
    return sorted(curves, key=lambda curve: -curve.length)[: config.image.max_curves]


def curves_from_both(
    heatmap: Float[np.ndarray, "hh ww"] | Callable[[], Float[np.ndarray, "hh ww"]],
    image: UInt8[np.ndarray, "h w *c"],
    *,
    config: HeatmapCurvesConfig = HeatmapCurvesConfig(),
    edges: ImageCurvesConfig = ImageCurvesConfig(),
) -> list[Curve]:
    """Edges of the picture, and what the heatmap marks beyond them.

    Args:
        heatmap: Heat per pixel, high on lines, of the same view as `image` at any resolution; or
            what gives it: it is asked when the edges are found, and may be made meanwhile.
        image: Grey (h, w) or RGB (h, w, 3), uint8.
        config: How curves are taken from the heatmap.
        edges: How curves are taken from the picture.

    Returns:
        Curves in pixels of `image`, the longest first.
    """
    full = grey_picture(image)
    work, scale = working_picture(full, edges.min_size, edges.max_size)
    surround = find_surround(work)
    arcs = _edge_arcs(detect_edges(work, config=edges.edges), surround, edges)
    arcs = longest_arcs(arcs, edges.max_curves)
    curves = finish_curves(arcs, full, scale, edges.refinement)
    heatmap = heatmap() if callable(heatmap) else heatmap
    ridges = detect_ridges(heatmap, config=config.ridges)
    centre = _centre_lines(ridges, arcs, work, config)
    ratio = work.shape[1] / heatmap.shape[1]
    snapped, unsnapped = _snapped(centre, work, ratio, surround, config)
    hinted = finish_curves(snapped, full, scale, edges.refinement)
    hinted += _unsnapped_curves(unsnapped, scale, full.shape[1] / heatmap.shape[1], config)
    curves += [replace(curve, is_hinted=True) for curve in hinted]
    return sorted(curves, key=lambda curve: -curve.length)


def centre_curves(
    heatmap: Float[np.ndarray, "hh ww"],
    width: int,
    height: int,
    *,
    config: HeatmapCurvesConfig = HeatmapCurvesConfig(),
) -> list[Curve]:
    """The centre lines of a heatmap as curves, without a look at the picture.

    Args:
        heatmap: Heat per pixel, high on lines.
        width: Width of the picture in whose pixels the curves are given.
        height: Its height.
        config: How curves are taken.

    Returns:
        Curves, the longest first.
    """
    if heatmap.ndim != 2:
        raise ValueError(f"Expected a heatmap of shape (h, w), got {heatmap.shape}.")
    arcs = link_arcs(
        detect_ridges(heatmap, config=config.ridges),
        directed=False,
        smooth=config.smooth,
        continuation=config.continuation,
    )
    arcs = arcs.chosen(arcs.chords() >= config.min_length)
    ratio = np.array([width / heatmap.shape[1], height / heatmap.shape[0]])
    sigma = config.centre_sigma * float(ratio[0])
    curves = [
        Curve((arcs.points[start:stop] + 0.5) * ratio - 0.5, sigma, 0.5)
        for start, stop in zip(arcs.offsets[:-1], arcs.offsets[1:], strict=True)
    ]
    return sorted(curves, key=lambda curve: -curve.length)[: config.image.max_curves]


def _unsnapped_curves(
    arcs: Arcs, scale: np.ndarray, enlargement: float, config: HeatmapCurvesConfig
) -> list[Curve]:
    """Centre lines that found no edge, in pixels of the picture."""
    sigma = config.centre_sigma * enlargement
    return [
        Curve((arcs.points[start:stop] + 0.5) / scale - 0.5, sigma, 0.0)
        for start, stop in zip(arcs.offsets[:-1], arcs.offsets[1:], strict=True)
    ]


def _edge_arcs(edges: EdgePoints, surround: Surround, config: ImageCurvesConfig) -> Arcs:
    """Long enough smooth arcs of edges that a lens could have made of lines."""
    arcs = link_arcs(edges, directed=True, smooth=config.smooth, continuation=config.continuation)
    shortest = max(config.min_length, config.min_length_share * max(edges.width, edges.height))
    arcs = arcs.chosen(arcs.chords() >= shortest)
    return plausible_arcs(arcs, surround, config.rejection)


def _wide_heat(heatmap: np.ndarray, config: HeatmapCurvesConfig) -> tuple[np.ndarray, float]:
    """The largest heat within reach of each pixel, and the heat above which a pixel is hot."""
    heat, threshold = smoothed_heat(heatmap, config.ridges)
    size = 2 * int(np.ceil(config.reach)) + 1
    return cv2.dilate(heat, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))), threshold


def _hot_edges(edges: EdgePoints, wide: np.ndarray, threshold: float) -> EdgePoints:
    """Edge points within reach of hot pixels."""
    return edges.chosen(sample(wide, *_rescaled(edges, *wide.shape).T) > threshold)


def _along_ridges(edges: EdgePoints, ridges: EdgePoints, reach: float) -> EdgePoints:
    """Edge points whose direction is nearer along the ridges around them than across.

    Without this, whatever crosses a hot line would leave a stub. Directions are averaged by their
    doubled angles, for which opposite normals are the same.
    """
    field_of_normals = np.zeros((2, ridges.height * ridges.width), np.float32)
    field_of_normals[:, ridges.cells] = _doubled(ridges.normals)
    u, v = _rescaled(edges, ridges.height, ridges.width).T
    agreement = np.zeros(len(edges.points))
    for component, normal in zip(field_of_normals, _doubled(edges.normals), strict=True):
        smooth = cv2.GaussianBlur(component.reshape(ridges.height, ridges.width), (0, 0), reach)
        agreement += sample(smooth, u, v) * normal
    return edges.chosen(agreement > 0)


def _doubled(normals: np.ndarray) -> np.ndarray:
    """Cosine and sine of twice the angle of unit vectors, shape (2, n)."""
    u, v = normals.T
    return np.stack([u * u - v * v, 2 * u * v])


def _rescaled(edges: EdgePoints, height: int, width: int) -> np.ndarray:
    """Edge points in pixels of the same picture at another size."""
    ratio = np.array([width / edges.width, height / edges.height])
    return (edges.points + 0.5) * ratio - 0.5


def _heated(curves: list[Curve], wide: np.ndarray, full: np.ndarray) -> list[Curve]:
    """The curves with the mean heat along them as their strength, the hottest pixel being 1."""
    if not curves:
        return []
    ratio = np.array([full.shape[1] / wide.shape[1], full.shape[0] / wide.shape[0]])
    points = (np.concatenate([curve.points for curve in curves]) + 0.5) / ratio - 0.5
    heat = sample(wide, *points.T) / max(float(wide.max()), 1e-9)
    stops = np.cumsum([len(curve.points) for curve in curves])
    parts = np.split(heat, stops[:-1])
    return [
        replace(curve, strength=float(np.clip(part.mean(), 0, 1)))
        for curve, part in zip(curves, parts, strict=True)
    ]


def _centre_lines(
    ridges: EdgePoints, arcs: Arcs, work: np.ndarray, config: HeatmapCurvesConfig
) -> Arcs:
    """Ridges of the heatmap that no arc covers yet, in pixels of the working picture."""
    centre = link_arcs(
        ridges, directed=False, smooth=config.smooth, continuation=config.continuation
    )
    centre = centre.chosen(centre.chords() >= config.min_length)
    height, width = ridges.height, ridges.width
    ratio = np.array([work.shape[1] / width, work.shape[0] / height])
    covered = np.zeros((height, width), np.uint8)
    cell = np.round((arcs.points + 0.5) / ratio - 0.5).astype(int)
    covered[cell[:, 1].clip(0, height - 1), cell[:, 0].clip(0, width - 1)] = 1
    covered = cv2.dilate(covered, np.ones((5, 5), np.uint8))
    cell = np.round(centre.points).astype(int)
    flags = covered[cell[:, 1], cell[:, 0]] > 0
    centre = Arcs((centre.points + 0.5) * ratio - 0.5, centre.contrast, centre.offsets)
    return centre.chosen(centre.share(flags) <= config.max_covered)


def _snapped(
    centre: Arcs,
    work: np.ndarray,
    ratio: float,
    surround: Surround,
    config: HeatmapCurvesConfig,
) -> tuple[Arcs, Arcs]:
    """Centre lines moved to edges, and those beside which there is none."""
    if not len(centre):
        return centre, centre
    reach = max(config.reach * ratio, 2.0)
    snapped = snap_to_edges(
        work, centre.points, centre.offsets, reach=reach, config=config.snapping
    )
    arcs = Arcs(snapped.points, snapped.contrast, snapped.offsets)
    on_edge = arcs.share(snapped.found) >= config.min_found
    arcs = arcs.chosen(on_edge)
    if len(arcs):
        arcs = arcs.only(snapped.found[np.repeat(on_edge, np.diff(snapped.offsets))])
        arcs = arcs.only(inliers(arcs.points, arcs.offsets, floor=_SNAP_FLOOR))
    arcs = arcs.taken(*smooth_arcs(arcs.points, arcs.offsets, config=config.snapped))
    arcs = arcs.taken(*continue_arcs(arcs.points, arcs.offsets))
    rejection = config.image.rejection
    return (
        plausible_arcs(arcs, surround, rejection),
        plausible_arcs(centre.chosen(~on_edge), surround, rejection),
    )

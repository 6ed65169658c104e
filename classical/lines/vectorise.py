"""The vectoriser: from a picture, or from a heatmap beside it, to curves."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from classical.lines.chains import link_points
from classical.lines.continuation import ContinuationConfig, continue_arcs
from classical.lines.curve import Curve
from classical.lines.edges import EdgeConfig, detect_edges
from classical.lines.rejection import (
    RejectionConfig,
    beside_surround,
    find_surround,
    impossible_bend,
)
from classical.lines.smooth import SmoothConfig, fit_arcs, smooth_arcs

_MIN_SIGMA = 0.05  # pixels; no edge is placed better


@dataclass(frozen=True)
class ImageCurvesConfig:
    """How curves are taken from a picture.

    Attributes:
        max_size: Larger pictures are reduced to this longest side first, pixels.
        min_size: Pictures whose longest side is below this are enlarged twice.
        min_length: Shortest curve, pixels of the picture that is worked on …
        min_length_share: … and as a share of its longest side; the larger counts.
        max_curves: At most so many curves are returned, the longest ones.
        edges: What counts as an edge.
        smooth: What counts as a smooth arc.
        continuation: When arcs are joined.
        rejection: What no lens could have made.
    """

    max_size: int = 1600
    min_size: int = 480
    min_length: float = 24.0
    min_length_share: float = 0.03
    max_curves: int = 300
    edges: EdgeConfig = field(default_factory=EdgeConfig)
    smooth: SmoothConfig = field(default_factory=SmoothConfig)
    continuation: ContinuationConfig = field(default_factory=ContinuationConfig)
    rejection: RejectionConfig = field(default_factory=RejectionConfig)


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
    grey, scale = _working_picture(image, config)
    height, width = grey.shape
    edges = detect_edges(grey, config=config.edges)
    chains = link_points(edges, directed=True, min_points=config.smooth.min_points)
    points, contrast = edges.points[chains.order], edges.contrast[chains.order]
    selected, offsets = smooth_arcs(points, chains.offsets, config=config.smooth)
    points, contrast = points[selected], contrast[selected]
    selected, offsets = continue_arcs(points, offsets, config=config.continuation)
    points, contrast = points[selected], contrast[selected]
    if len(offsets) < 2:
        return []
    surround = find_surround(grey)
    reject = beside_surround(points, offsets, surround, config=config.rejection)
    reject |= impossible_bend(
        points, offsets, width, height, surround.radius, config=config.rejection
    )
    chord = np.hypot(*(points[offsets[1:] - 1] - points[offsets[:-1]]).T)
    shortest = max(config.min_length, config.min_length_share * max(width, height))
    keep = np.flatnonzero(~reject & (chord >= shortest))
    keep = keep[np.argsort(-chord[keep], kind="stable")][: config.max_curves]
    return _as_curves(points, contrast, offsets, keep, scale)


def _working_picture(
    image: np.ndarray, config: ImageCurvesConfig
) -> tuple[Float[np.ndarray, "h w"], float]:
    """Grey picture of a workable size, and its pixels per pixel of the input."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    longest = max(grey.shape)
    scale = 1.0
    if longest > config.max_size:
        scale = config.max_size / longest
    elif longest < config.min_size:
        scale = 2.0
    if scale != 1.0:
        size = (max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale)))
        interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
        grey = cv2.resize(grey, size, interpolation=interpolation)
    return grey.astype(np.float32), scale


def _as_curves(
    points: np.ndarray,
    contrast: np.ndarray,
    offsets: Int[np.ndarray, " p1"],
    keep: np.ndarray,
    scale: float,
) -> list[Curve]:
    """Curves of the input picture from arcs of the working picture."""
    rms = fit_arcs(points, offsets, degree=3).rms
    full = (points + 0.5) / scale - 0.5
    curves = []
    for k in keep:
        piece = slice(offsets[k], offsets[k + 1])
        level = float(np.median(contrast[piece]))
        sigma = max(float(rms[k]), _MIN_SIGMA) / scale
        curves.append(Curve(full[piece], sigma, level / (level + 20.0)))
    return curves

"""Lines followed beyond the ends of their curves, under a lens that is known by and large.

Edges break off where something crosses them or where they grow faint, and the longer a curve is,
the more its bend tells. A lens says where the line goes on: along its great circle. There the
picture is searched within a pixel or two, and the curve grows as far as an edge goes on with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int, UInt8

from classical.camera import KannalaBrandt
from classical.lines.arcs import contrast_of_strength
from classical.lines.curve import REFERENCE_WIDTH, Curve
from classical.lines.great_circles import describe_curves
from classical.lines.snap import SnapConfig, SnappedPoints, snap_to_edges
from classical.lines.working import grey_picture, working_picture

_SHARP_WIDTH = 960  # edges of smaller pictures are no sharper
_PATH_POINTS = 64  # of a great circle beyond an end, from which the snapping interpolates
_FRAME = 2.0  # pixels; a profile so near the picture's frame tells nothing


@dataclass(frozen=True)
class TracingConfig:
    """How far lines are followed; lengths in pixels of a picture 1280 wide.

    Attributes:
        shortest: Shorter curves do not say well enough where they go on.
        share: A curve grows at either end by at most this share of its angle.
        reach: Edges are sought this far beside the great circle, pixels of a picture up to 960
            wide.
        least_contrast: Smallest edge, as a share of the curve's own.
        window: So many neighbouring points …
        least_found: … must have an edge at this share of them, or the line has ended.
        max_size: Larger pictures are searched at this longest side, pixels.
        snapping: How edges are found; lengths in pixels of the picture that is searched.
    """

    shortest: float = 20.0
    share: float = 1.0
    reach: float = 1.75
    least_contrast: float = 0.8
    window: int = 6
    least_found: float = 0.8
    max_size: int = 1600
    snapping: SnapConfig = field(
        default_factory=lambda: SnapConfig(spacing=1.5, sigma=1.2, offset_cost=0.4)
    )


def trace_further(
    curves: Sequence[Curve],
    camera: KannalaBrandt,
    image: UInt8[np.ndarray, "h w *c"],
    *,
    config: TracingConfig = TracingConfig(),
) -> list[Curve]:
    """Let curves grow at both ends along their great circles, while edges go on there.

    Args:
        curves: Curves of the picture.
        camera: Its camera as far as it is known.
        image: The picture, grey (h, w) or RGB (h, w, 3).
        config: How far they grow.

    Returns:
        The curves in the same order; those that found nothing as they came.
    """
    width = camera.width
    shortest = config.shortest * width / REFERENCE_WIDTH
    long = [k for k, c in enumerate(curves) if c.length >= shortest and c.strength > 0]
    paths, offsets, owner, at_end = _paths([curves[k] for k in long], camera, config)
    if not len(owner):
        return list(curves)
    grey, scale = working_picture(grey_picture(image), 0, config.max_size)
    reach = config.reach * max(grey.shape[1] / _SHARP_WIDTH, 1.0)
    at = (paths + 0.5) * scale - 0.5
    snapped = snap_to_edges(grey, at, offsets, reach=reach, config=config.snapping)
    own = np.array([contrast_of_strength(curves[long[k]].strength) for k in owner])
    grown = _while_found(snapped, config.least_contrast * own, config)
    points = (snapped.points + 0.5) / scale - 0.5
    out = list(curves)
    for path in np.flatnonzero(np.add.reduceat(grown, snapped.offsets[:-1], dtype=np.int64)):
        part = slice(snapped.offsets[path], snapped.offsets[path + 1])
        further = points[part][grown[part]]
        k = long[owner[path]]
        ends = (out[k].points, further) if at_end[path] else (further[::-1], out[k].points)
        out[k] = replace(out[k], points=np.concatenate(ends))
    return out


def _paths(
    curves: list[Curve], camera: KannalaBrandt, config: TracingConfig
) -> tuple[
    Float[np.ndarray, "m 2"],
    Int[np.ndarray, " p1"],
    Int[np.ndarray, " p"],
    Int[np.ndarray, " p"],
]:
    """Where curves go on: points, offsets of the paths, the curve of each, 1 beyond its last point.

    A path ends where the camera sees no further or the picture does.
    """
    found, _ = describe_curves(curves, camera)
    if not len(found.members):
        none = np.empty(0, np.int64)
        return np.empty((0, 2)), np.zeros(1, np.int64), none, none
    normals = found.normals[:, None]
    ends = camera.unproject(found.ends.reshape(-1, 2))[0].reshape(-1, 2, 3)
    ends -= (ends * normals).sum(axis=-1, keepdims=True) * normals
    ends /= np.linalg.norm(ends, axis=-1, keepdims=True)
    chord = ends[:, 1:] - ends[:, :1]
    span = 2 * np.arcsin(np.clip(np.linalg.norm(chord, axis=-1) / 2, 0, 1))
    outward = np.cross(normals, ends)
    away = (outward * chord).sum(axis=-1) * [-1, 1]
    outward *= np.where(away < 0, -1.0, 1.0)[..., None]
    angle = config.share * span * np.linspace(0, 1, _PATH_POINTS + 1)[1:]
    angle = angle[:, None, :, None]
    rays = np.cos(angle) * ends[:, :, None] + np.sin(angle) * outward[:, :, None]
    pixels, seen = camera.project(rays.reshape(-1, 3))
    inside = seen & (pixels >= _FRAME).all(axis=1)
    inside &= (pixels <= np.array([camera.width, camera.height]) - 1 - _FRAME).all(axis=1)
    inside = np.logical_and.accumulate(inside.reshape(-1, _PATH_POINTS), axis=1)
    pixels = pixels.reshape(-1, _PATH_POINTS, 2)
    last = inside.sum(axis=1) - 1
    length = np.linalg.norm(pixels[np.arange(len(last)), last] - pixels[:, 0], axis=1)
    least = config.window * config.snapping.spacing * camera.width / REFERENCE_WIDTH
    used = (last >= 3) & (np.where(last >= 3, length, 0) >= least)
    inside &= used[:, None]
    counts = inside.sum(axis=1)[used]
    owner = np.array([group[0] for group in found.members])
    return (
        pixels[inside],
        np.concatenate([[0], np.cumsum(counts)]),
        np.repeat(owner, 2)[used],
        np.tile([0, 1], len(owner))[used],
    )


def _while_found(
    snapped: SnappedPoints, least_contrast: Float[np.ndarray, " p"], config: TracingConfig
) -> np.ndarray:
    """Points with an edge, from the start of each path until too many in a window have none."""
    starts, counts = snapped.offsets[:-1], np.diff(snapped.offsets)
    found = snapped.found & (snapped.contrast >= np.repeat(least_contrast, counts))
    place = np.arange(len(found)) - np.repeat(starts, counts)
    total = np.concatenate([[0], np.cumsum(found)])
    ahead = np.minimum(np.arange(len(found)) + config.window, len(found))
    whole = place + config.window <= np.repeat(counts, counts)
    sparse = whole & (total[ahead] - total[:-1] < config.least_found * config.window)
    first = np.minimum.reduceat(np.where(sparse, place, len(found)), starts)
    first[counts < config.window] = 0
    reached = np.where(first == 0, 0, first + config.window // 2)
    return found & (place < np.repeat(reached, counts))

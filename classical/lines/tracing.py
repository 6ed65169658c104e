"""Lines followed beyond the ends of their curves, under a lens that is known by and large.

Edges break off where something crosses them or where they grow faint, and the longer a curve is,
the more its bend tells. A lens says where the line goes on: along its great circle. There the
picture is searched within a pixel or two, and the curve grows as far as an edge goes on with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from classical.camera import KannalaBrandt
from classical.lines.arcs import contrast_of_strength
from classical.lines.curve import REFERENCE_WIDTH, Curve
from classical.lines.great_circles import CirclePieces, describe_curves
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
        probe: So far every curve is looked beyond; those that find something there are looked
            beyond further.
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
    probe: float = 40.0
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
    shortest = config.shortest * camera.width / REFERENCE_WIDTH
    long = [k for k, c in enumerate(curves) if c.length >= shortest and c.strength > 0]
    pieces, _ = describe_curves([curves[k] for k in long], camera)
    owner = np.array([long[group[0]] for group in pieces.members], np.int64)
    grey, scale = working_picture(grey_picture(image), 0, config.max_size)
    own = np.array([contrast_of_strength(curves[k].strength) for k in owner])
    probe = config.probe * camera.width / REFERENCE_WIDTH / pieces.length
    ends = _ends(pieces, camera)
    goes_on = np.ones((len(owner), 2), bool)
    out = list(curves)
    # most lines end where their curves do: a short look first
    for share in (np.minimum(probe, config.share), np.full(len(owner), config.share)):
        paths, offsets = _paths(ends, camera, share, goes_on, config)
        number, side = np.nonzero(goes_on)
        if not len(number):
            return out
        reach = config.reach * max(grey.shape[1] / _SHARP_WIDTH, 1.0)
        at = (paths + 0.5) * scale - 0.5
        snapped = snap_to_edges(grey, at, offsets, reach=reach, config=config.snapping)
        grown = _while_found(snapped, config.least_contrast * own[number], config)
        goes_on[number, side] = np.add.reduceat(grown, snapped.offsets[:-1], dtype=np.int64) > 0
    points = (snapped.points + 0.5) / scale - 0.5
    for path, (piece, end) in enumerate(zip(number, side, strict=True)):
        part = slice(snapped.offsets[path], snapped.offsets[path + 1])
        further = points[part][grown[part]]
        k = int(owner[piece])
        parts = (out[k].points, further) if end else (further[::-1], out[k].points)
        out[k] = replace(out[k], points=np.concatenate(parts)) if len(further) else out[k]
    return out


class _Ends(NamedTuple):
    """Both ends of each piece on its circle, and where the circle goes on.

    Attributes:
        rays: Unit rays of the first and the last point, shape (p, 2, 3).
        outward: Unit tangents of the circle there, away from the piece, shape (p, 2, 3).
        span: Angle from end to end, shape (p, 1).
    """

    rays: Float[np.ndarray, "p 2 3"]
    outward: Float[np.ndarray, "p 2 3"]
    span: Float[np.ndarray, "p 1"]


def _ends(pieces: CirclePieces, camera: KannalaBrandt) -> _Ends:
    normals = pieces.normals[:, None]
    ends = camera.unproject(pieces.ends.reshape(-1, 2))[0].reshape(-1, 2, 3)
    ends -= (ends * normals).sum(axis=-1, keepdims=True) * normals
    ends /= np.linalg.norm(ends, axis=-1, keepdims=True)
    chord = ends[:, 1:] - ends[:, :1]
    span = 2 * np.arcsin(np.clip(np.linalg.norm(chord, axis=-1) / 2, 0, 1))
    outward = np.cross(normals, ends)
    away = (outward * chord).sum(axis=-1) * [-1, 1]
    outward *= np.where(away < 0, -1.0, 1.0)[..., None]
    return _Ends(ends, outward, span)


def _paths(
    ends: _Ends,
    camera: KannalaBrandt,
    share: Float[np.ndarray, " p"],
    goes_on: Bool[np.ndarray, "p 2"],
    config: TracingConfig,
) -> tuple[Float[np.ndarray, "m 2"], Int[np.ndarray, " q1"]]:
    """Where curves go on beyond their first and last point: points, and offsets of the paths.

    A path ends where the camera sees no further or the picture does; `goes_on` becomes False where
    that leaves none.
    """
    angle = share[:, None] * ends.span * np.linspace(0, 1, _PATH_POINTS + 1)[1:]
    angle = np.repeat(angle[:, None], 2, axis=1)[goes_on][..., None]
    along, outward = ends.rays[goes_on][:, None], ends.outward[goes_on][:, None]
    rays = np.cos(angle) * along + np.sin(angle) * outward
    pixels, seen = camera.project(rays.reshape(-1, 3))
    inside = seen & (pixels >= _FRAME).all(axis=1)
    inside &= (pixels <= np.array([camera.width, camera.height]) - 1 - _FRAME).all(axis=1)
    inside = np.logical_and.accumulate(inside.reshape(-1, _PATH_POINTS), axis=1)
    pixels = pixels.reshape(-1, _PATH_POINTS, 2)
    last = inside.sum(axis=1) - 1
    length = np.linalg.norm(pixels[np.arange(len(last)), last] - pixels[:, 0], axis=1)
    least = config.window * config.snapping.spacing * camera.width / REFERENCE_WIDTH
    used = (last >= 3) & (np.where(last >= 3, length, 0) >= least)
    goes_on[goes_on] = used
    counts = inside.sum(axis=1)[used]
    return pixels[inside & used[:, None]], np.concatenate([[0], np.cumsum(counts)])


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

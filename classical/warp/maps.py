"""Maps between a fisheye picture and its rectified one, both ways.

A map says for each pixel of the picture to be made where it lies in the picture at hand, as
`cv2.remap` takes it. Maps depend on the two cameras only, so they are computed once for a lens.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from classical.camera import Division, KannalaBrandt, Pinhole
from classical.camera.base import check_size
from classical.warp.antialias import Smoothing, plan_smoothing
from classical.warp.cache import MapCache

AnyCamera = KannalaBrandt | Division | Pinhole

OUTSIDE = -32.0  # coordinate of a pixel without a source; resamples to 0 with any kernel
MAX_SIDE = 32766  # cv2.remap counts pixels of the source in 16 bits
_PLAN_STEP, _PLAN_MIN = 4, 32  # pixels from one to the next, pixels that shall be left a side
_CHUNK = 1 << 14  # pixels mapped at a time, so that the intermediates stay in the CPU's cache


@dataclass(frozen=True, eq=False)
class WarpMaps:
    """Where each pixel of a new picture lies in an old one.

    Attributes:
        u: Column in the source, pixels, shape (height, width); `OUTSIDE` where not valid.
        v: Row in the source, likewise.
        valid: True where the source has a pixel.
        source_width: Width of the source picture in pixels.
        source_height: Height of the source picture in pixels.
    """

    u: Float32[np.ndarray, "height width"]
    v: Float32[np.ndarray, "height width"]
    valid: Bool[np.ndarray, "height width"]
    source_width: int
    source_height: int

    def __post_init__(self) -> None:
        check_size(self.source_width, self.source_height)
        if not self.u.shape == self.v.shape == self.valid.shape:
            raise ValueError(
                "Expected u, v and valid of one shape, got "
                f"{self.u.shape}, {self.v.shape} and {self.valid.shape}."
            )
        for array in (self.u, self.v, self.valid):
            array.setflags(write=False)

    @property
    def nbytes(self) -> int:
        """Memory of the arrays in bytes."""
        return self.u.nbytes + self.v.nbytes + self.valid.nbytes

    @cached_property
    def scale(self) -> Float32[np.ndarray, "height width"]:
        """Source pixels per new pixel: root of the area that a new pixel covers; 0 if not valid.

        Over 1 the picture shrinks there. Central differences of the maps, one-sided at the rim and
        taken over valid neighbours only.
        """
        return _local_scale(self.u, self.v, self.valid)

    @cached_property
    def smoothing(self) -> Smoothing:
        """What is done to the source against aliasing before it is looked up.

        Planned on every fourth pixel each way, as the scale changes slowly over the picture.
        """
        step = max(1, min(_PLAN_STEP, min(self.u.shape) // _PLAN_MIN))
        u, v, valid = (array[::step, ::step] for array in (self.u, self.v, self.valid))
        scale = _local_scale(u, v, valid) / np.float32(step)
        size = (self.source_width, self.source_height)
        return plan_smoothing(u, v, scale, *size, step=step)

    @cached_property
    def lookup(self) -> tuple[Float32[np.ndarray, "height width"], ...]:
        """The coordinates (u, v) on the sheet that `smoothing` draws of the source."""
        return self.smoothing.moved(self.u, self.v, self.valid)


def undistort_maps(camera: AnyCamera, target: Pinhole) -> WarpMaps:
    """For each pixel of the rectified picture, its place in the fisheye picture.

    Args:
        camera: AnyCamera of the fisheye picture.
        target: AnyCamera of the rectified picture.

    Returns:
        The maps, from a cache when these cameras were asked for lately.
    """
    return _cache.get(("undistort", camera, target), lambda: _maps(camera, target))


def distort_maps(camera: AnyCamera, target: Pinhole) -> WarpMaps:
    """For each pixel of the fisheye picture, its place in the rectified picture.

    Remapping the rectified picture with it gives the fisheye picture again.

    Args:
        camera: AnyCamera of the fisheye picture.
        target: AnyCamera of the rectified picture.

    Returns:
        The maps, from a cache when these cameras were asked for lately.
    """
    return _cache.get(("distort", camera, target), lambda: _maps(target, camera))


_cache: MapCache[WarpMaps] = MapCache(max_bytes=128 << 20)


def _maps(source: AnyCamera, new: AnyCamera) -> WarpMaps:
    """Maps from the pixels of `new` to those of `source`."""
    if max(source.width, source.height) > MAX_SIDE:
        raise ValueError(
            f"Expected a picture of at most {MAX_SIDE} pixels a side, "
            f"got {source.width}x{source.height}."
        )
    if isinstance(source, KannalaBrandt) and isinstance(new, Pinhole):
        u, v, seen = _fisheye_from_pinhole(source, new)
    else:
        u, v, seen = _any_from_any(source, new)
    return _bounded(u, v, seen, source.width, source.height)


def _fisheye_from_pinhole(
    source: KannalaBrandt, new: Pinhole
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The common case by OpenCV, whose fisheye model is ours; ten times as fast."""
    K, D = source.to_opencv()
    size = (new.width, new.height)
    u, v = cv2.fisheye.initUndistortRectifyMap(K, D, np.eye(3), new.matrix, size, cv2.CV_32FC1)
    x = (np.arange(new.width) - new.u0) / new.focal_u
    y = (np.arange(new.height) - new.v0) / new.focal_v
    tangent = math.tan(source.theta_max) if source.theta_max < math.pi / 2 else math.inf
    return u, v, x[None, :] ** 2 + y[:, None] ** 2 <= tangent**2


def _any_from_any(source: AnyCamera, new: AnyCamera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Through rays, a chunk of rows at a time."""
    shape = (new.height, new.width)
    u, v = np.empty(shape, np.float32), np.empty(shape, np.float32)
    seen = np.empty(shape, bool)
    columns = np.arange(new.width, dtype=np.float64)
    n_rows = max(1, _CHUNK // new.width)
    for top in range(0, new.height, n_rows):
        rows = np.arange(top, min(top + n_rows, new.height), dtype=np.float64)
        grid = np.stack(np.broadcast_arrays(columns[None, :], rows[:, None]), axis=-1)
        rays, looks = new.unproject(grid.reshape(-1, 2))
        points, reached = source.project(rays)
        part = slice(top, top + len(rows))
        u[part] = points[:, 0].reshape(len(rows), -1)
        v[part] = points[:, 1].reshape(len(rows), -1)
        seen[part] = (looks & reached).reshape(len(rows), -1)
    return u, v, seen


def _bounded(u: np.ndarray, v: np.ndarray, seen: np.ndarray, width: int, height: int) -> WarpMaps:
    """Keep what lies within the area of the source's pixels.

    A point in the outer half of a border pixel takes that pixel's colour, as its coordinate is
    clipped to the outermost pixel centre.
    """
    valid = seen & (u >= -0.5) & (u <= width - 0.5) & (v >= -0.5) & (v <= height - 0.5)
    for values, last in ((u, width - 1), (v, height - 1)):
        np.clip(values, 0, last, out=values)
        values[~valid] = OUTSIDE
    return WarpMaps(u, v, valid, width, height)


def _local_scale(u: np.ndarray, v: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Root of the area that one step in each direction covers; 0 if not valid."""
    u_x, u_y = _slope(u, valid, 1), _slope(u, valid, 0)
    v_x, v_y = _slope(v, valid, 1), _slope(v, valid, 0)
    scale = np.sqrt(np.abs(u_x * v_y - u_y * v_x))
    return np.where(valid, scale, 0).astype(np.float32)


def _slope(values: np.ndarray, valid: np.ndarray, axis: int) -> np.ndarray:
    """Derivative along an axis from the valid neighbours, per pixel."""
    values, valid = np.moveaxis(values, axis, 0), np.moveaxis(valid, axis, 0)
    step = np.diff(values, axis=0)
    good = valid[1:] & valid[:-1]
    step = np.where(good, step, np.float32(0))
    total = np.zeros(values.shape, np.float32)
    count = np.zeros(values.shape, np.float32)
    for part in (slice(None, -1), slice(1, None)):
        total[part] += step
        count[part] += good
    return np.moveaxis(total / np.maximum(count, 1), 0, axis)

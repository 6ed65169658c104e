"""Warping frames as they are stored, plane by plane, without a detour through RGB.

Brightness and colour keep their own resolution and depth; nothing is converted, so nothing is lost
but what resampling takes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from classical.camera import KannalaBrandt, Pinhole
from classical.warp import WarpMaps, remap, undistort_maps
from hybrid.config import RectifyConfig
from hybrid.video.display import Display
from hybrid.video.source import av_module

_FULL_RANGE = 2  # AVCOL_RANGE_JPEG
_KEPT = (
    "pts",
    "time_base",
    "duration",
    "color_range",
    "colorspace",
    "color_trc",
    "color_primaries",
)


class FrameWarp:
    """Straightens frames of one film by fixed maps.

    Args:
        display: How the stored frames are shown.
        camera: The lens of the upright frames.
        target: The camera of the straight frames.
        pixel_format: Planar, as `Film.pixel_format`.
        config: Interpolation and smoothing.
    """

    def __init__(
        self,
        display: Display,
        camera: KannalaBrandt,
        target: Pinhole,
        pixel_format: str,
        config: RectifyConfig,
    ) -> None:
        self._options = {"interpolation": config.interpolation, "antialias": config.antialias}
        self._format = av_module().VideoFormat(pixel_format, target.width, target.height)
        self._size = target.width, target.height
        self._deep = self._format.components[0].bits > 8
        luma = display.stored_maps(undistort_maps(camera, target), (1, 1), (0.0, 0.0))
        colour = _colour_maps(display, camera, target, self._format)
        self._maps = (luma, colour, colour)

    def __call__(self, frame: Any) -> Any:
        """The straight frame (av.VideoFrame) with the time and the colours of the given one."""
        if frame.format.name != self._format.name:
            frame = frame.reformat(format=self._format.name)
        straight = av_module().VideoFrame(*self._size, self._format.name)
        blacks = self._blacks(frame)
        for plane, new, maps, black in zip(
            frame.planes, straight.planes, self._maps, blacks, strict=True
        ):
            warped = remap(self._pixels(plane), maps, **self._options)
            if not maps.valid.all():
                warped[~maps.valid] = black
            self._pixels(new)[...] = warped
        for name in _KEPT:
            setattr(straight, name, getattr(frame, name))
        return straight

    def _pixels(self, plane: Any) -> np.ndarray:
        """A plane as an array on its own memory, shape (height, width)."""
        values = np.frombuffer(plane, np.uint16 if self._deep else np.uint8)
        rows = values.reshape(plane.height, -1)
        return rows[:, : plane.width]

    def _blacks(self, frame: Any) -> tuple[int, int, int]:
        """What black is in each plane."""
        full = frame.color_range == _FULL_RANGE or self._format.name.startswith("yuvj")
        depth = self._format.components[0].bits - 8
        return (0 if full else 16) << depth, 128 << depth, 128 << depth


def _colour_maps(
    display: Display, camera: KannalaBrandt, target: Pinhole, pixel_format: Any
) -> WarpMaps:
    """Maps of the planes that hold colour.

    Their samples lie between rows and, unless the format is of the JPEG family, on the even columns
    of the brightness, as in H.264 unless said otherwise.
    """
    width, height = target.width, target.height
    columns, rows = pixel_format.chroma_width(width), pixel_format.chroma_height(height)
    step = -(-width // columns), -(-height // rows)
    between = 0.5 if pixel_format.name.startswith("yuvj") else 0.0
    offset = (between * (step[0] - 1), 0.5 * (step[1] - 1))
    sparse = Pinhole(
        target.focal_u / step[0],
        target.focal_v / step[1],
        (target.u0 - offset[0]) / step[0],
        (target.v0 - offset[1]) / step[1],
        columns,
        rows,
    )
    return display.stored_maps(undistort_maps(camera, sparse), step, offset)

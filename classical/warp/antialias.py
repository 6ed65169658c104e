"""Smoothing before resampling, where and only where the picture shrinks.

A bilinear lookup every s source pixels drops what lies between once s > 1. As s changes slowly over
the picture, the source is smoothed in bands of s, each by the Gaussian that widens a pixel's own
aperture (taken as σ = 0.5 px) to that of s pixels: σ² = 0.25 (s² − 1). Neighbouring bands differ so
little that their seams do not show; each starts from the one before, so that kernels stay small.
Smoothing the source once costs far less than several lookups a pixel. Pictures that shrink
everywhere are first reduced as a whole by area averages.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

_BAND_START = 1.2  # scale from which smoothing is worth it
_BAND_RATIO = 1.25  # from one band to the next
_CELL = 8  # source pixels; the scale is gathered on a grid of such cells
_REACH = 1.9  # the kernel's half width in σ


@dataclass(frozen=True, eq=False)
class Band:
    """A region of the (reduced) source and how it is smoothed.

    Attributes:
        sigma: Standard deviation in pixels of the Gaussian that is added to the band before.
        left: First column of the bounding box.
        top: First row of the bounding box.
        mask: 255 where the band applies, within its bounding box.
    """

    sigma: float
    left: int
    top: int
    mask: UInt8[np.ndarray, "height width"]


@dataclass(frozen=True, eq=False)
class Smoothing:
    """What is done to a source picture before one lookup a pixel is enough.

    Attributes:
        width: Width to reduce the source to, pixels.
        height: Height to reduce the source to, pixels.
        bands: Regions to smooth then, one after the other, each inside the one before.
    """

    width: int
    height: int
    bands: tuple[Band, ...]

    def apply(self, image: np.ndarray) -> np.ndarray:
        """The reduced and smoothed picture; the picture itself where there is nothing to do."""
        if image.shape[:2] != (self.height, self.width):
            size = (self.width, self.height)
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        if not self.bands:
            return image
        smooth = image.copy()
        for band in self.bands:
            _smooth_band(smooth, band)
        return smooth


def plan_smoothing(
    u: Float32[np.ndarray, "height width"],
    v: Float32[np.ndarray, "height width"],
    scale: Float32[np.ndarray, "height width"],
    source_width: int,
    source_height: int,
    *,
    step: int = 1,
) -> Smoothing:
    """Decide where a source has to be smoothed for a map with the given local scale.

    Args:
        u: Column in the source, pixels.
        v: Row in the source, pixels.
        scale: Source pixels per new pixel, 0 where the map is not valid.
        source_width: Width of the source in pixels.
        source_height: Height of the source in pixels.
        step: New pixels from one entry of the map to the next.
    """
    seen = scale > 0
    factor = max(1, math.floor(float(scale[seen].min()))) if seen.any() else 1
    width, height = max(1, source_width // factor), max(1, source_height // factor)
    relative = scale * np.float32(width / source_width)
    if not seen.any() or relative.max() < _BAND_START:
        return Smoothing(width, height, ())
    shrinking = relative >= 1
    x = (u[shrinking] + 0.5) * (width / source_width)
    y = (v[shrinking] + 0.5) * (height / source_height)
    needed = _scale_at_source(x, y, relative[shrinking], width, height, step)
    return Smoothing(width, height, tuple(_bands(needed, width, height)))


def _scale_at_source(
    x: np.ndarray, y: np.ndarray, scale: np.ndarray, width: int, height: int, step: int
) -> np.ndarray:
    """The largest scale with which each cell of the source is looked at, 0 if it shrinks nowhere.

    The grid is coarse enough that neighbouring lookups land in neighbouring cells.
    """
    cell = max(_CELL, math.ceil(step * float(scale.max())))
    shape = (math.ceil(height / cell), math.ceil(width / cell))
    rows = np.clip((y / cell).astype(np.intp), 0, shape[0] - 1)
    columns = np.clip((x / cell).astype(np.intp), 0, shape[1] - 1)
    needed = np.zeros(shape, np.float32)
    np.maximum.at(needed, (rows, columns), scale)
    return cv2.dilate(needed, np.ones((3, 3), np.uint8))


def _bands(needed: np.ndarray, width: int, height: int) -> list[Band]:
    """Nested regions of growing scale over the source."""
    full = cv2.resize(needed, (width, height), interpolation=cv2.INTER_LINEAR)
    bands = []
    start, reached = _BAND_START, 0.0
    while start <= full.max():
        mask = (full >= start).astype(np.uint8) * 255
        left, top, box_width, box_height = cv2.boundingRect(mask)
        variance = 0.25 * (start**2 * _BAND_RATIO - 1)  # for the middle of the band
        cut = np.ascontiguousarray(mask[top : top + box_height, left : left + box_width])
        bands.append(Band(math.sqrt(variance - reached), left, top, cut))
        start, reached = start * _BAND_RATIO, variance
    return bands


def _smooth_band(smooth: np.ndarray, band: Band) -> None:
    """Smooth the pixels of a band in place."""
    reach = max(1, round(_REACH * band.sigma))
    height, width = band.mask.shape
    top, left = max(0, band.top - reach), max(0, band.left - reach)
    around = smooth[top : band.top + height + reach, left : band.left + width + reach]
    blurred = cv2.GaussianBlur(
        around, (2 * reach + 1, 2 * reach + 1), band.sigma, borderType=cv2.BORDER_REPLICATE
    )
    rows = slice(band.top - top, band.top - top + height)
    columns = slice(band.left - left, band.left - left + width)
    box = smooth[band.top : band.top + height, band.left : band.left + width]
    cv2.copyTo(blurred[rows, columns], band.mask, box)

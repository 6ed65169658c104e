"""A picture at full size and halved, smoothed where need be, drawn onto one sheet for lookups."""

from __future__ import annotations

import math
from dataclasses import dataclass
from threading import local

import cv2
import numpy as np
from jaxtyping import Shaped, UInt8

MARGIN = 4  # pixels around a level that repeat its rim, for kernels wider than two pixels
_SIGMA = 0.505  # pixels
_BINOMIAL_SHARE = 0.44
_KEPT_BYTES = 64 << 20  # largest sheet whose memory is kept for the next picture

Box = tuple[slice, slice]  # rows and columns


@dataclass(frozen=True, eq=False)
class Patch:
    """A rectangle of a level that is smoothed.

    Attributes:
        box: Rows and columns of the level.
        mask: 255 where it applies; None means everywhere.
    """

    box: Box
    mask: UInt8[np.ndarray, "height width"] | None


@dataclass(frozen=True, eq=False)
class Level:
    """The source, or a part of it halved a number of times.

    Attributes:
        halving: Rows and columns of the level before that are halved for this one; None for the
            source itself.
        x: Source pixels to the left of it.
        y: Source pixels above it.
        width: Its columns.
        height: Its rows.
        left: First column on the sheet.
        top: First row on the sheet.
        copies: Rectangles of the level that are looked up; none where it only leads to the next.
        patches: Rectangles that are smoothed, and drawn over the copies.
        margins: Whether the rim is repeated around the level.
    """

    halving: Box | None
    x: int
    y: int
    width: int
    height: int
    left: int
    top: int
    copies: tuple[Box, ...]
    patches: tuple[Patch, ...]
    margins: bool

    @property
    def place(self) -> Box:
        """Its rows and columns on the sheet."""
        return (
            slice(self.top, self.top + self.height),
            slice(self.left, self.left + self.width),
        )

    def halved(self, before: np.ndarray, sheet: np.ndarray) -> np.ndarray:
        """This level without smoothing, in its place on the sheet where it is looked up."""
        if self.halving is None:
            for box in self.copies:
                sheet[self.place][box] = before[box]
            return before
        size, mean_of_four = (self.width, self.height), cv2.INTER_LINEAR
        if self.copies:
            page = sheet[self.place]
            cv2.resize(before[self.halving], size, dst=page, interpolation=mean_of_four)
            return page
        return cv2.resize(before[self.halving], size, interpolation=mean_of_four)

    def smooth(self, raw: np.ndarray, sheet: np.ndarray) -> None:
        """Smooth the patches and repeat the rim, on the sheet."""
        for patch in self.patches:
            _smooth(raw, sheet[self.place], patch)
        if self.margins and self.copies:
            _repeat_rim(sheet, self)


@dataclass(frozen=True, eq=False)
class Sheet:
    """Levels side by side in one array, so that one call looks up all of them.

    Attributes:
        width: Columns.
        height: Rows.
        levels: The levels that are drawn, each from the one before.
    """

    width: int
    height: int
    levels: tuple[Level, ...]

    def draw(self, image: Shaped[np.ndarray, "..."]) -> Shaped[np.ndarray, "..."]:
        """The sheet of a picture; its memory is used again by the next call in this thread."""
        sheet = _memory((self.height, self.width, *image.shape[2:]), image.dtype)
        raw = [image]
        for level in self.levels:
            raw.append(level.halved(raw[-1], sheet))
        for level, unsmoothed in zip(self.levels, raw[1:], strict=True):
            level.smooth(unsmoothed, sheet)
        return sheet


def _smooth(raw: np.ndarray, page: np.ndarray, patch: Patch) -> None:
    """Draw a patch of a level smoothed onto its page."""
    rows, columns = patch.box
    top, left = max(0, rows.start - 1), max(0, columns.start - 1)
    around = raw[top : rows.stop + 1, left : columns.stop + 1]
    smooth = _smoothed(around)
    smooth = smooth[rows.start - top :, columns.start - left :]
    smooth = smooth[: rows.stop - rows.start, : columns.stop - columns.start]
    if patch.mask is None:
        page[patch.box] = smooth
    else:
        cv2.copyTo(smooth, patch.mask, page[patch.box])


def _smoothed(image: np.ndarray) -> np.ndarray:
    """(0.11, 0.78, 0.11) both ways, or its like in 16 bits, where only the binomial is fast."""
    border = cv2.BORDER_REPLICATE
    if image.dtype != np.uint16:
        return cv2.GaussianBlur(image, (3, 3), _SIGMA, borderType=border)
    binomial = cv2.GaussianBlur(image, (3, 3), 0, borderType=border)
    return cv2.addWeighted(image, 1 - _BINOMIAL_SHARE, binomial, _BINOMIAL_SHARE, 0)


def _repeat_rim(sheet: np.ndarray, level: Level) -> None:
    """Repeat the outermost pixels of a level around it, as far as the sheet goes."""
    top, left, bottom, right = (
        level.top,
        level.left,
        level.top + level.height,
        level.left + level.width,
    )
    above, before = max(0, top - MARGIN), max(0, left - MARGIN)
    sheet[above:top, left:right] = sheet[top, left:right]
    sheet[bottom : bottom + MARGIN, left:right] = sheet[bottom - 1, left:right]
    rows = slice(above, bottom + MARGIN)
    sheet[rows, before:left] = sheet[rows, left : left + 1]
    sheet[rows, right : right + MARGIN] = sheet[rows, right - 1 : right]


_kept = local()


def _memory(shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """An array with anything in it; fresh pages from the system cost more than the smoothing."""
    size = math.prod(shape) * dtype.itemsize
    if size > _KEPT_BYTES:
        return np.empty(shape, dtype)
    if getattr(_kept, "bytes", None) is None or len(_kept.bytes) < size:
        _kept.bytes = np.empty(size, np.uint8)
    return _kept.bytes[:size].view(dtype).reshape(shape)

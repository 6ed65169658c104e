"""Smoothing before resampling, where and only where the picture shrinks.

A bilinear lookup every s source pixels drops what lies between once s > 1, and grain grows with it.
As s changes slowly over the picture, each part of it is looked up in the source (s < 1.45), in the
source halved by means of 2x2 pixels (s < 2.9), and so on; in each of these the part with s > 1.3 is
smoothed first by a small kernel that leaves 0.63 of the deviation of white noise, beside the 0.5
that halving leaves. That follows the ideal 1 / s in steps too small to show as seams. All of it is
drawn onto one sheet and the map points there, so that the lookup stays one call.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from classical.warp.levels import MARGIN, Box, Level, Patch, Sheet

_HALF_FROM = 1.45  # scale from which the halved source is looked up
_SMOOTH_FROM = 1.3  # scale from which it is smoothed
_CELL = 8  # source pixels; what is needed is gathered on a grid of such cells or larger ones
_FILLINGS = 2  # cells by which the known scale is carried on
_STRETCH = 1.5  # of the scale along one direction, over its mean
_TILE = 128  # pixels of a level in one rectangle to copy
_PATCH_TILES = (48, 64, 96, 128, 192)  # likewise to smooth
_CALL_COST = 15_000  # pixels that could be smoothed in the time of one call
_LEAST_SIDE = 4  # pixels of a level
_MAX_SIDE = 32766  # of a source of cv2.remap


@dataclass(frozen=True, eq=False)
class Smoothing:
    """How the source of a map is smoothed, and where the map's pixels then are.

    Attributes:
        sheet: What is drawn from the source; None where nothing shrinks.
        levels: Level that each new pixel is looked up in, on a grid of every `step`-th pixel.
        step: See `levels`.
    """

    sheet: Sheet | None
    levels: UInt8[np.ndarray, "rows columns"]
    step: int

    def moved(
        self,
        u: Float32[np.ndarray, "height width"],
        v: Float32[np.ndarray, "height width"],
        valid: Bool[np.ndarray, "height width"],
    ) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
        """The map's coordinates on the sheet."""
        if self.sheet is None or len(self.sheet.levels) == 1:
            return u, v
        height, width = u.shape
        looked_up = self.levels.repeat(self.step, axis=0)[:height].repeat(self.step, axis=1)
        looked_up = looked_up[:, :width] * valid
        u, v = u.copy(), v.copy()
        for depth, level in enumerate(self.sheet.levels[1:], start=1):
            here = looked_up == depth
            for values, first, last, place in (
                (u, level.x, level.width - 1, level.left),
                (v, level.y, level.height - 1, level.top),
            ):
                moved = (values[here] + np.float32(0.5 - first)) / np.float32(2**depth)
                values[here] = np.clip(moved - np.float32(0.5), 0, last) + np.float32(place)
        return u, v


def plan_smoothing(
    u: Float32[np.ndarray, "rows columns"],
    v: Float32[np.ndarray, "rows columns"],
    scale: Float32[np.ndarray, "rows columns"],
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
    nothing = Smoothing(None, np.zeros(scale.shape, np.uint8), step)
    if scale.max() < _SMOOTH_FROM:
        return nothing
    deepest = max(0, int(math.log2(min(source_width, source_height) / _LEAST_SIDE)))
    for most in (deepest, 0):  # a huge source has no room for halves beside it
        levels = _levels(scale, most)
        needed = _Needed.of(u, v, scale, levels, (source_width, source_height), step)
        sheet = _sheet(needed)
        if max(sheet.width, sheet.height) <= _MAX_SIDE:
            return Smoothing(sheet, levels, step)
    return nothing


def _levels(scale: np.ndarray, most: int) -> UInt8[np.ndarray, "rows columns"]:
    """How often the source is halved for each entry of the map; its neighbours' where not valid."""
    known = np.where(scale > 0, scale, cv2.dilate(scale, np.ones((3, 3), np.uint8)))
    halvings = np.ceil(np.log2(np.maximum(known, 1e-3) / _HALF_FROM))
    return np.clip(halvings, 0, most).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class _Needed:
    """What is looked up, on a grid of cells over the source.

    Attributes:
        looked_at: Whether a cell is looked at in each level, shape (levels, rows, columns).
        scale: Mean scale with which a cell is looked at, a neighbour's where it is not.
        cell: Side of a cell in source pixels, a multiple of 2^(levels − 1).
        width: Of the source, pixels.
        height: Of the source, pixels.
    """

    looked_at: Bool[np.ndarray, "levels rows columns"]
    scale: Float32[np.ndarray, "rows columns"]
    cell: int
    width: int
    height: int

    @classmethod
    def of(
        cls,
        u: np.ndarray,
        v: np.ndarray,
        scale: np.ndarray,
        levels: np.ndarray,
        size: tuple[int, int],
        step: int,
    ) -> _Needed:
        """The grid is so coarse that neighbouring entries land in neighbouring cells."""
        seen = scale > 0
        depth = int(levels[seen].max())
        unit = 2**depth
        cell = max(_CELL, math.ceil(step * float(scale.max()) * _STRETCH / unit) * unit)
        shape = (depth + 1, math.ceil(size[1] / cell), math.ceil(size[0] / cell))
        rows = np.clip(((v[seen] + 0.5) / cell).astype(np.intp), 0, shape[1] - 1)
        columns = np.clip(((u[seen] + 0.5) / cell).astype(np.intp), 0, shape[2] - 1)
        looked_at = np.zeros(shape, bool)
        looked_at[levels[seen], rows, columns] = True
        place, n_cells = rows * shape[2] + columns, shape[1] * shape[2]
        number = np.bincount(place, minlength=n_cells)
        total = np.bincount(place, weights=scale[seen], minlength=n_cells)
        mean = (total / np.maximum(number, 1)).reshape(shape[1:]).astype(np.float32)
        for _ in range(_FILLINGS):
            mean = np.where(mean > 0, mean, cv2.dilate(mean, np.ones((3, 3), np.uint8)))
        return cls(looked_at, mean, cell, *size)

    def cells(self, depth: int) -> Bool[np.ndarray, "rows columns"]:
        """Cells that a level must hold, with all that a kernel may reach from them."""
        return cv2.dilate(self.looked_at[depth].astype(np.uint8), np.ones((5, 5), np.uint8)) > 0

    def boxes(self) -> list[tuple[int, int, int, int]]:
        """Part of the source that each level covers, (x, y, end of x, end of y) in source pixels.

        The source itself is covered whole; each other level holds all that come after it.
        """
        boxes = []
        low, high = np.array([10**9, 10**9]), np.array([0, 0])
        for depth in range(len(self.looked_at) - 1, 0, -1):
            rows, columns = np.nonzero(self.cells(depth))
            if len(rows):
                low = np.minimum(low, [columns.min() * self.cell, rows.min() * self.cell])
                high = np.maximum(high, [columns.max() + 1, rows.max() + 1])
            unit = 2**depth
            end = np.minimum(high * self.cell, [self.width, self.height]) // unit * unit
            boxes.insert(0, (int(low[0]), int(low[1]), int(end[0]), int(end[1])))
        return [(0, 0, self.width, self.height), *boxes]


def _sheet(needed: _Needed) -> Sheet:
    """Lay the levels out, one below the other, or beside each other on an upright picture."""
    boxes = needed.boxes()
    used = [bool(level.any()) for level in needed.looked_at]
    gap = MARGIN if sum(used) > 1 else 0
    upright = needed.height > needed.width
    levels, place, extent = [], 0, 0
    for depth, (x, y, right, bottom) in enumerate(boxes):
        width, height = (right - x) >> depth, (bottom - y) >> depth
        start = place + gap if place else 0
        side = gap if place else 0
        left, top = (start, side) if upright else (side, start)
        halving = _halving(boxes[depth - 1], boxes[depth], depth) if depth else None
        copies = _copies(needed, depth, boxes[depth]) if used[depth] else ()
        patches = _patches(needed, depth, boxes[depth]) if used[depth] else ()
        size = (x, y, width, height, left, top)
        levels.append(Level(halving, *size, copies, patches, gap > 0))
        if used[depth]:
            place = start + (width if upright else height) + gap
            extent = max(extent, side + (height if upright else width) + gap)
    return Sheet(*((place, extent) if upright else (extent, place)), tuple(levels))


def _halving(
    before: tuple[int, int, int, int], after: tuple[int, int, int, int], depth: int
) -> Box:
    """Rows and columns of the level before, for boxes in source pixels."""
    x, y = before[:2]
    (left, top, right, bottom), halved = after, depth - 1
    return (
        slice((top - y) >> halved, (bottom - y) >> halved),
        slice((left - x) >> halved, (right - x) >> halved),
    )


def _copies(needed: _Needed, depth: int, box: tuple[int, int, int, int]) -> tuple[Box, ...]:
    """Rectangles of a level that are looked up."""
    cells = _inside(needed.cells(depth), needed.cell, box)
    side = needed.cell >> depth
    per_tile = max(1, round(_TILE / side))
    return tuple(_rectangles(_any_in_tiles(cells, per_tile), side * per_tile, _size(box, depth)))


def _patches(needed: _Needed, depth: int, box: tuple[int, int, int, int]) -> tuple[Patch, ...]:
    """Rectangles of a level that are smoothed."""
    width, height = _size(box, depth)
    grid = _inside(needed.scale, needed.cell, box) / np.float32(2**depth)
    looked_at = _inside(needed.cells(depth), needed.cell, box)
    side = needed.cell >> depth
    size = (grid.shape[1] * side, grid.shape[0] * side)
    scale = cv2.resize(grid, size, interpolation=cv2.INTER_LINEAR)[:height, :width]
    there = looked_at.repeat(side, axis=0)[:height].repeat(side, axis=1)[:, :width]
    mask = (scale >= _SMOOTH_FROM) & there
    tilings = [_rectangles(_any_in_tiles(mask, n), n, (width, height)) for n in _PATCH_TILES]
    tiles = min(tilings, key=lambda tiling: sum(map(_area, tiling)) + len(tiling) * _CALL_COST)
    parts = [(tile, mask[tile]) for tile in tiles]
    return tuple(
        Patch(tile, None if part.all() else part.astype(np.uint8) * 255) for tile, part in parts
    )


def _area(box: Box) -> int:
    rows, columns = box
    return (rows.stop - rows.start) * (columns.stop - columns.start)


def _size(box: tuple[int, int, int, int], depth: int) -> tuple[int, int]:
    x, y, right, bottom = box
    return (right - x) >> depth, (bottom - y) >> depth


def _inside(grid: np.ndarray, cell: int, box: tuple[int, int, int, int]) -> np.ndarray:
    """The cells of a box that begins at a cell's corner."""
    x, y, right, bottom = box
    return grid[y // cell : math.ceil(bottom / cell), x // cell : math.ceil(right / cell)]


def _any_in_tiles(mask: np.ndarray, side: int) -> Bool[np.ndarray, "rows columns"]:
    """Whether a tile of side x side entries holds a true one."""
    rows, columns = (math.ceil(n / side) for n in mask.shape)
    padded = np.zeros((rows * side, columns * side), bool)
    padded[: mask.shape[0], : mask.shape[1]] = mask
    return np.asarray(padded.reshape(rows, side, columns, side).any(axis=(1, 3)))


def _rectangles(
    tiles: Bool[np.ndarray, "rows columns"], side: int, size: tuple[int, int]
) -> list[Box]:
    """Cover the true tiles by few rectangles: runs along rows, joined where they repeat below."""
    width, height = size
    done: list[list[int]] = []
    for row, line in enumerate(tiles):
        steps = np.diff(np.concatenate([[0], line.astype(np.int8), [0]]))
        starts, ends = np.flatnonzero(steps == 1).tolist(), np.flatnonzero(steps == -1).tolist()
        for first, last in zip(starts, ends, strict=True):
            for known in done:
                if known[1:] == [row, first, last]:
                    known[1] = row + 1
                    break
            else:
                done.append([row, row + 1, first, last])
    return [
        (
            slice(top * side, min(bottom * side, height)),
            slice(left * side, min(right * side, width)),
        )
        for top, bottom, left, right in done
    ]

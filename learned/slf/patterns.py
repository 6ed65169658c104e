"""Drawn textures whose lines are known exactly: tiles, bricks, windows, shelves, planks, panels.

And what is on `boards`: calibration targets and print. On a wall or a floor their lines run along
the room's axes, so that a scene of `boxes` has the vanishing points that photographs on walls
contradict.
"""

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from learned.slf.atlas import BOARD, PATTERN
from learned.slf.pack import Annotated

_SIZES = ((384, 512), (448, 448), (512, 384), (320, 640))
_MOST_SEGMENTS = 120
Lines = list[tuple[float, float, float, float]]


def draw_patterns(count: int, *, seed: int) -> Iterator[Annotated]:
    """Draw textures, all kinds in turn.

    Args:
        count: Number of textures.
        seed: Seed of all of them.
    """
    for index in range(count):
        rng = np.random.default_rng([seed, 21, index])
        height, width = _SIZES[int(rng.integers(len(_SIZES)))]
        draw = _KINDS[index % len(_KINDS)]
        canvas = _plaster(rng, height, width)
        yield _annotated(rng, canvas, draw(rng, canvas), PATTERN)


def draw_targets(count: int, *, seed: int) -> Iterator[Annotated]:
    """Draw pictures for `boards`, all kinds in turn.

    Args:
        count: Number of pictures.
        seed: Seed of all of them.
    """
    for index in range(count):
        rng = np.random.default_rng([seed, 22, index])
        draw = _TARGETS[index % len(_TARGETS)]
        height, width = _SIZES[int(rng.integers(len(_SIZES)))]
        paper = rng.uniform(170, 250) + rng.normal(0, 6, 3)
        canvas = np.broadcast_to(paper, (height, width, 3)).copy()
        yield _annotated(rng, canvas, draw(rng, canvas), BOARD)


def _annotated(rng: np.random.Generator, canvas: ndarray, lines: Lines, kind: int) -> Annotated:
    """A canvas as a picture of a pack, with the longest of its lines."""
    image = _worn(rng, canvas)
    segments = np.array(lines, np.float32).reshape(-1, 4)
    length = np.hypot(segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1])
    order = np.argsort(-length, kind="stable")[:_MOST_SEGMENTS]
    return Annotated(image, segments[order], kind)


def _colour(rng: np.random.Generator, low: float = 30.0, high: float = 235.0) -> ndarray:
    """A muted colour: grey of any brightness with a little hue."""
    return np.clip(rng.uniform(low, high) + rng.normal(0, 18, 3), 0, 255)


def _contrast(rng: np.random.Generator, colour: ndarray) -> ndarray:
    """A colour that differs clearly from another."""
    shift = rng.uniform(30, 90) * (1 if colour.mean() < 128 else -1)
    return np.clip(colour + shift + rng.normal(0, 8, 3), 0, 255)


def _plaster(rng: np.random.Generator, height: int, width: int) -> ndarray:
    """A wall with a gradient of light."""
    y, x = np.mgrid[0:height, 0:width]
    slope = rng.normal(0, 0.12, 2)
    light = 1 + slope[0] * (x / width - 0.5) + slope[1] * (y / height - 0.5)
    return light[..., None] * _colour(rng, 90.0, 230.0)


def _worn(rng: np.random.Generator, canvas: ndarray) -> UInt8[ndarray, "h w 3"]:
    """Stains and grain, so that no face is flat."""
    import cv2

    height, width = canvas.shape[:2]
    coarse = rng.normal(0, 1, (height // 48 + 2, width // 48 + 2)).astype(np.float32)
    stain = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    grain = rng.normal(0, rng.uniform(0.5, 5.0), (height, width, 1))
    worn = canvas * (1 + rng.uniform(0, 0.06) * stain[..., None]) + grain
    return np.clip(worn, 0, 255).astype(np.uint8)


def _fill(canvas: ndarray, box: tuple[int, int, int, int], colour: ndarray) -> Lines:
    """Paint the rectangle (left, top, right, bottom), ends excluded; its four edges."""
    left, top, right, bottom = box
    canvas[top:bottom, left:right] = colour
    x0, y0, x1, y1 = left - 0.5, top - 0.5, right - 0.5, bottom - 0.5
    return [(x0, y0, x1, y0), (x0, y1, x1, y1), (x0, y0, x0, y1), (x1, y0, x1, y1)]


def _joint(canvas: ndarray, at: int, width: int, colour: ndarray, *, across: bool) -> Lines:
    """Paint a straight joint through the whole picture; its middle line."""
    height, full = canvas.shape[:2]
    middle = at + (width - 1) / 2
    if across:
        canvas[at : at + width] = colour
        return [(-0.5, middle, full - 0.5, middle)]
    canvas[:, at : at + width] = colour
    return [(middle, -0.5, middle, height - 0.5)]


def _tiles(rng: np.random.Generator, canvas: ndarray) -> Lines:
    height, width = canvas.shape[:2]
    step_v = int(rng.integers(36, 130))
    step_u = step_v if rng.random() < 0.7 else int(rng.integers(36, 160))
    second = _contrast(rng, canvas.mean(axis=(0, 1)))
    if rng.random() < 0.3:
        rows, columns = np.arange(height) // step_v, np.arange(width) // step_u
        canvas[(rows[:, None] + columns[None]) % 2 == 1] = second
    colour, thick = _contrast(rng, canvas.mean(axis=(0, 1))), int(rng.integers(1, 5))
    lines: Lines = []
    for at in range(step_v, height - 2, step_v):
        lines += _joint(canvas, at, thick, colour, across=True)
    for at in range(step_u, width - 2, step_u):
        lines += _joint(canvas, at, thick, colour, across=False)
    return lines


def _bricks(rng: np.random.Generator, canvas: ndarray) -> Lines:
    height, width = canvas.shape[:2]
    high, long = int(rng.integers(18, 48)), int(rng.integers(50, 130))
    joint, thick = _contrast(rng, canvas.mean(axis=(0, 1))), int(rng.integers(1, 4))
    lines: Lines = []
    for row, top in enumerate(range(0, height, high)):
        for left in range(-(row % 2) * long // 2, width, long):
            shade = rng.uniform(0.85, 1.1)
            canvas[top : top + high, max(left, 0) : max(left + long, 0)] *= shade
            canvas[top : top + high, max(left, 0) : max(left + thick, 0)] = joint
        if top:
            lines += _joint(canvas, top, thick, joint, across=True)
    return lines


def _planks(rng: np.random.Generator, canvas: ndarray) -> Lines:
    width = canvas.shape[1]
    lines: Lines = []
    at = 0
    while at < width:
        step = int(rng.integers(30, 90))
        canvas[:, at : at + step] *= rng.uniform(0.8, 1.1) + rng.normal(0, 0.02, 3)
        if at:
            lines.append((at - 0.5, -0.5, at - 0.5, canvas.shape[0] - 0.5))
            canvas[:, at : at + 2] *= 0.6
        at += step
    return lines


def _windows(rng: np.random.Generator, canvas: ndarray) -> Lines:
    """A front with rows of framed windows, ledges between the floors."""
    height, width = canvas.shape[:2]
    rows, columns = int(rng.integers(1, 5)), int(rng.integers(2, 7))
    frame, glass = _contrast(rng, canvas.mean(axis=(0, 1))), _colour(rng, 10.0, 110.0)
    cell_v, cell_u = height // rows, width // columns
    inset_v, inset_u = rng.uniform(0.15, 0.3, 2)
    lines: Lines = []
    for row in range(rows):
        for column in range(columns):
            left, top = round(column * cell_u + inset_u * cell_u), round((row + inset_v) * cell_v)
            right, bottom = (
                round((column + 1 - inset_u) * cell_u),
                round((row + 1 - inset_v) * cell_v),
            )
            lines += _window(rng, canvas, (left, top, right, bottom), frame, glass)
        if row and rng.random() < 0.5:
            lines += _joint(canvas, row * cell_v, 4, frame, across=True)
    return lines


def _window(
    rng: np.random.Generator,
    canvas: ndarray,
    box: tuple[int, int, int, int],
    frame: ndarray,
    glass: ndarray,
) -> Lines:
    left, top, right, bottom = box
    rim = max(2, (right - left) // 14)
    lines = _fill(canvas, box, frame)
    pane = glass * rng.uniform(0.7, 1.5)
    lines += _fill(
        canvas, (left + rim, top + rim, right - rim, bottom - rim), np.clip(pane, 0, 255)
    )
    middle = (left + right) // 2
    if right - left > 40:
        canvas[top + rim : bottom - rim, middle - 1 : middle + 2] = frame
        lines.append((float(middle), float(top + rim), float(middle), bottom - rim - 1.0))
    return lines


def _panels(rng: np.random.Generator, canvas: ndarray) -> Lines:
    """Doors of a wardrobe or a panelled wall."""
    height, width = canvas.shape[:2]
    columns = int(rng.integers(1, 6))
    cuts = np.linspace(0, width, columns + 1).astype(int)
    seam = _contrast(rng, canvas.mean(axis=(0, 1)))
    lines: Lines = []
    for left, right in pairwise(cuts):
        if left:
            lines += _joint(canvas, int(left), 2, seam * 0.6, across=False)
        splits = np.sort(rng.uniform(0.25, 0.75, int(rng.integers(0, 3))))
        edges = np.concatenate([[0.0], splits, [1.0]]) * height
        for top, bottom in pairwise(edges):
            gap = max(6, int(0.07 * width / columns))
            box = (int(left) + gap, round(top) + gap, int(right) - gap, round(bottom) - gap)
            if box[2] - box[0] > 16 and box[3] - box[1] > 16:
                base = canvas[box[1], box[0]]
                lines += _fill(canvas, box, np.clip(base * rng.uniform(0.7, 0.9), 0, 255))
                inner = (box[0] + 4, box[1] + 4, box[2] - 4, box[3] - 4)
                canvas[inner[1] : inner[3], inner[0] : inner[2]] = base
    return lines


def _shelves(rng: np.random.Generator, canvas: ndarray) -> Lines:
    """Boards with rows of books."""
    height, width = canvas.shape[:2]
    board, count = _contrast(rng, canvas.mean(axis=(0, 1))), int(rng.integers(3, 7))
    step = height // count
    lines: Lines = []
    for row in range(count):
        base, left = (row + 1) * step - 6, 4
        while left < width - 8:
            thick, high = int(rng.integers(6, 26)), int(step * rng.uniform(0.5, 0.85))
            if rng.random() < 0.9:
                edges = _fill(
                    canvas, (left, base - high, min(left + thick, width), base), _colour(rng)
                )
                lines += edges[2:] if thick > 14 else []
            left += thick
        lines += _fill(canvas, (0, base, width, base + 6), board)[:2]
    for at in range(0, width, max(width // int(rng.integers(1, 4)), 40))[1:]:
        lines += _fill(canvas, (at, 0, at + 6, height), board)[2:]
    return lines


def _pictures(rng: np.random.Generator, canvas: ndarray) -> Lines:
    """A plain wall with framed pictures, a skirting board and a rail."""
    height, width = canvas.shape[:2]
    wall = canvas.mean(axis=(0, 1))
    lines: Lines = []
    for _ in range(int(rng.integers(1, 4))):
        wide, high = (int(x) for x in rng.integers(50, 150, 2))
        left, top = (
            int(rng.integers(10, width - wide - 10)),
            int(rng.integers(20, height - high - 60)),
        )
        lines += _fill(canvas, (left, top, left + wide, top + high), _contrast(rng, wall))
        inner = (left + 6, top + 6, left + wide - 6, top + high - 6)
        lines += _fill(canvas, inner, _colour(rng))
    board = int(rng.integers(12, 34))
    lines += _fill(canvas, (0, height - board, width, height), _contrast(rng, wall))[:1]
    return lines


def _door(rng: np.random.Generator, canvas: ndarray) -> Lines:
    """A door in its frame, beside it a window or nothing."""
    height, width = canvas.shape[:2]
    wide = int(0.34 * height)
    left = int(rng.integers(10, max(width - wide - 10, 11)))
    frame = _contrast(rng, canvas.mean(axis=(0, 1)))
    lines = _fill(canvas, (left, int(0.2 * height), left + wide, height), frame)
    leaf = (left + 8, int(0.2 * height) + 8, left + wide - 8, height)
    lines += _fill(canvas, leaf, _contrast(rng, frame))
    free = (left + wide + 20, width - 20) if left < width / 2 else (20, left - 20)
    if free[1] - free[0] > 60:
        box = (free[0], int(0.2 * height), free[1], int(0.65 * height))
        lines += _window(rng, canvas, box, frame, _colour(rng, 120.0, 240.0))
    return lines


def _sky(rng: np.random.Generator, canvas: ndarray) -> Lines:
    """Sky with soft clouds: a ceiling without lines."""
    import cv2

    height, width = canvas.shape[:2]
    coarse = rng.normal(0, 1, (6, 8)).astype(np.float32)
    cloud = np.clip(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC), 0, 1)
    blue = np.array([120, 165, 225]) * rng.uniform(0.7, 1.1)
    canvas[:] = blue + cloud[..., None] * (np.array([235, 238, 242]) - blue)
    return []


def _grid(rng: np.random.Generator, canvas: ndarray) -> tuple[ndarray, ndarray]:
    """Columns and rows where the squares of a target begin and end, a margin around."""
    height, width = canvas.shape[:2]
    side = int(min(height, width) / rng.uniform(5, 11))
    margin = int(side * rng.uniform(0.0, 1.2))
    columns, rows = (width - 2 * margin) // side, (height - 2 * margin) // side
    left, top = (width - columns * side) // 2, (height - rows * side) // 2
    return left + side * np.arange(columns + 1), top + side * np.arange(rows + 1)


def _squares(
    rng: np.random.Generator, canvas: ndarray
) -> Iterator[tuple[int, int, int, int, bool]]:
    """Cells of a grid as (left, top, right, bottom) and whether they are the dark ones."""
    columns, rows = _grid(rng, canvas)
    for i, (top, bottom) in enumerate(pairwise(rows.tolist())):
        for j, (left, right) in enumerate(pairwise(columns.tolist())):
            yield left, top, right, bottom, (i + j) % 2 == 0


def _chequers(rng: np.random.Generator, canvas: ndarray) -> Lines:
    """A chequerboard."""
    ink = rng.uniform(5, 60) + rng.normal(0, 3, 3)
    cells = list(_squares(rng, canvas))
    for left, top, right, bottom, dark in cells:
        if dark:
            canvas[top:bottom, left:right] = ink
    left, top = cells[0][:2]
    right, bottom = cells[-1][2:4]
    upright = {x for cell in cells for x in (cell[0], cell[2])}
    level = {y for cell in cells for y in (cell[1], cell[3])}
    lines = [(x - 0.5, top - 0.5, x - 0.5, bottom - 0.5) for x in sorted(upright)]
    return lines + [(left - 0.5, y - 0.5, right - 0.5, y - 0.5) for y in sorted(level)]


def _dots(rng: np.random.Generator, canvas: ndarray) -> Lines:
    """A grid of discs, which has no lines of its own."""
    ink, size = rng.uniform(5, 80), rng.uniform(0.25, 0.45)
    y, x = np.mgrid[0 : canvas.shape[0], 0 : canvas.shape[1]]
    for left, top, right, bottom, _ in _squares(rng, canvas):
        middle_x, middle_y = (left + right - 1) / 2, (top + bottom - 1) / 2
        canvas[np.hypot(x - middle_x, y - middle_y) < size * (right - left)] = ink
    return []


def _tags(rng: np.random.Generator, canvas: ndarray) -> Lines:
    """A grid of coded squares."""
    ink = rng.uniform(5, 60)
    lines: Lines = []
    for left, top, right, _, _ in _squares(rng, canvas):
        gap, bits = (right - left) // 8, 6
        edge = (right - left - 2 * gap) // bits * bits
        box = (left + gap, top + gap, left + gap + edge, top + gap + edge)
        lines += _fill(canvas, box, np.full(3, ink))
        code = np.kron(rng.random((bits - 2, bits - 2)) < 0.5, np.ones([edge // bits] * 2))
        inner = canvas[box[1] + edge // bits :, box[0] + edge // bits :]
        inner[: code.shape[0], : code.shape[1]][code > 0] = canvas[0, 0]
    return lines


def _print(rng: np.random.Generator, canvas: ndarray) -> Lines:
    """A poster: rows of words, a picture or two."""
    height, width = canvas.shape[:2]
    ink, row = _colour(rng, 5.0, 90.0), int(rng.integers(10, 30))
    if rng.random() < 0.5:
        canvas[:] = _colour(rng)
    at = row
    while at < height - 2 * row:
        left = row
        while left < width - 3 * row:
            word = int(rng.integers(row, 5 * row))
            canvas[at : at + row // 2, left : min(left + word, width - row)] = ink
            left += word + row // 2
        at += row if rng.random() < 0.85 else 3 * row
    lines: Lines = []
    for _ in range(int(rng.integers(0, 3))):
        wide, high = int(width * rng.uniform(0.2, 0.7)), int(height * rng.uniform(0.2, 0.5))
        left, top = int(rng.integers(0, width - wide)), int(rng.integers(0, height - high))
        lines += _fill(canvas, (left, top, left + wide, top + high), _colour(rng))
    return lines


_TARGETS: tuple[Callable[[np.random.Generator, ndarray], Lines], ...] = (
    _chequers,
    _chequers,
    _tags,
    _dots,
    _print,
)

USES: dict[str, tuple[str, ...]] = {
    "floor": ("_tiles", "_planks", "_bricks"),
    "wall": ("_tiles", "_panels", "_bricks", "_planks", "_pictures"),
    "front": ("_bricks", "_tiles"),
}
"""Which kinds look right where."""


def numbers_for(use: str, count: int) -> list[int]:
    """Numbers of the textures among the first `count` that are fit for a use."""
    names = [kind.__name__ for kind in _KINDS]
    return [i for i in range(count) if names[i % len(names)] in USES[use]]


_KINDS: tuple[Callable[[np.random.Generator, ndarray], Lines], ...] = (
    _tiles,
    _windows,
    _planks,
    _panels,
    _bricks,
    _windows,
    _shelves,
    _tiles,
    _pictures,
    _door,
    _sky,
)

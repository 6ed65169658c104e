"""Furniture and fittings from boxes, drawn at random sizes.

A piece is a list of parts in its own axes: x to the right, y down, z towards its back; the origin
is on the floor in the middle of its front edge.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Parts = list["Part"]


@dataclass(frozen=True)
class Part:
    """One box of a piece.

    Attributes:
        low: Smallest x, y, z in metres.
        high: Largest x, y, z in metres.
        colour: Number of the piece's colour, from 0.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    colour: int = 0


@dataclass(frozen=True)
class Piece:
    """A piece of furniture.

    Attributes:
        parts: Its boxes.
        width: Extent along x, centred.
        depth: Extent along z, from 0.
        height: Extent upwards.
        model: Number of a modelled piece, which has no parts; −1 for one of boxes.
    """

    parts: Parts
    width: float
    depth: float
    height: float
    model: int = -1


def _block(x: float, y: float, z: float, w: float, h: float, d: float, colour: int = 0) -> Part:
    """Box from its left, its foot above the floor, its front, and its size."""
    return Part((x, -(y + h), z), (x + w, -y, z + d), colour)


def _legs(w: float, h: float, d: float, thick: float, colour: int) -> Parts:
    return [
        _block(x, 0.0, z, thick, h, thick, colour)
        for x in (-w / 2, w / 2 - thick)
        for z in (0.0, d - thick)
    ]


def table(rng: np.random.Generator) -> Piece:
    """Table or desk with four legs."""
    w, h, d = rng.uniform(0.8, 1.8), rng.uniform(0.68, 0.78), rng.uniform(0.6, 0.95)
    top = _block(-w / 2 - 0.03, h, -0.03, w + 0.06, 0.04, d + 0.06, 0)
    return Piece([top, *_legs(w, h, d, rng.uniform(0.04, 0.08), 1)], w + 0.06, d + 0.06, h)


def chair(rng: np.random.Generator) -> Piece:
    """Chair with a back."""
    w, d, h = rng.uniform(0.4, 0.48), rng.uniform(0.4, 0.48), rng.uniform(0.43, 0.47)
    parts = [_block(-w / 2, h, 0.0, w, 0.04, d, 0), *_legs(w, h, d, 0.035, 1)]
    posts = (-w / 2, w / 2 - 0.035)
    parts += [_block(x, h + 0.04, d - 0.035, 0.035, 0.44, 0.035, 1) for x in posts]
    parts += [_block(-w / 2, h + y, d - 0.03, w, 0.1, 0.02, 0) for y in (0.14, 0.34)]
    return Piece(parts, w, d, h + 0.5)


def wardrobe(rng: np.random.Generator) -> Piece:
    """Wardrobe with doors and handles."""
    doors = int(rng.integers(2, 5))
    door, h, d = rng.uniform(0.4, 0.6), rng.uniform(1.8, 2.15), rng.uniform(0.5, 0.65)
    w = doors * door
    parts = [_block(-w / 2, 0.0, 0.02, w, h, d - 0.02, 0)]
    for i in range(doors):
        x = -w / 2 + i * door
        parts.append(_block(x + 0.004, 0.08, 0.0, door - 0.008, h - 0.1, 0.02, 1))
        side = 0.9 if i % 2 == 0 else 0.1
        parts.append(_block(x + side * door - 0.01, h * 0.45, -0.03, 0.02, 0.14, 0.03, 2))
    return Piece(parts, w, d, h)


def bookshelf(rng: np.random.Generator) -> Piece:
    """Open shelf with books of many colours."""
    w, h, d, shelves = rng.uniform(0.6, 1.4), rng.uniform(1.2, 2.1), 0.3, int(rng.integers(3, 6))
    parts = [_block(x, 0.0, 0.0, 0.025, h, d, 0) for x in (-w / 2, w / 2 - 0.025)]
    parts.append(_block(-w / 2, 0.0, d - 0.02, w, h, 0.02, 0))
    step = (h - 0.03) / shelves
    for i in range(shelves + 1):
        parts.append(_block(-w / 2 + 0.025, i * step, 0.0, w - 0.05, 0.025, d - 0.02, 0))
    for i in range(shelves):
        x = -w / 2 + 0.03
        while x < w / 2 - 0.12 and rng.random() < 0.93:
            thick, high = rng.uniform(0.025, 0.1), step * rng.uniform(0.55, 0.85)
            place = (x, i * step + 0.025, 0.04, thick - 0.003, high, 0.2)
            parts.append(_block(*place, int(rng.integers(1, 5))))
            x += thick
    return Piece(parts, w, d, h)


def cabinet(rng: np.random.Generator) -> Piece:
    """Chest of drawers or sideboard."""
    w, h, d = rng.uniform(0.6, 1.8), rng.uniform(0.6, 1.1), rng.uniform(0.4, 0.5)
    rows, columns = int(rng.integers(2, 5)), max(1, round(w / 0.7))
    parts = [_block(-w / 2, 0.05, 0.02, w, h - 0.05, d - 0.02, 0)]
    parts.append(_block(-w / 2 - 0.02, h, -0.01, w + 0.04, 0.03, d + 0.01, 2))
    for i in range(rows):
        for j in range(columns):
            x, y = -w / 2 + j * w / columns, 0.07 + i * (h - 0.09) / rows
            wide, high = w / columns - 0.02, (h - 0.09) / rows - 0.02
            parts.append(_block(x + 0.01, y, 0.0, wide, high, 0.02, 1))
            parts.append(_block(x + wide / 2 - 0.06, y + high * 0.6, -0.02, 0.12, 0.015, 0.02, 2))
    return Piece(parts, w + 0.04, d, h)


def bed(rng: np.random.Generator) -> Piece:
    """Bed with its head against the wall."""
    w, d = rng.uniform(0.9, 1.9), rng.uniform(1.95, 2.1)
    parts = [
        _block(-w / 2, 0.1, 0.0, w, 0.2, d, 0),
        _block(-w / 2 + 0.03, 0.3, 0.04, w - 0.06, 0.2, d - 0.1, 1),
    ]
    parts.append(_block(-w / 2 - 0.03, 0.0, d - 0.06, w + 0.06, rng.uniform(0.8, 1.2), 0.06, 0))
    for i in range(1 if w < 1.3 else 2):
        x = -w / 2 + 0.12 + i * w / 2
        parts.append(_block(x, 0.5, d - 0.55, min(0.6, w - 0.24), 0.1, 0.4, 2))
    parts.append(_block(-w / 2 + 0.01, 0.48, 0.02, w - 0.02, 0.05, d * 0.6, 3))
    return Piece(parts, w + 0.06, d, 1.0)


def sofa(rng: np.random.Generator) -> Piece:
    """Sofa with arms, back and cushions."""
    seats, d = int(rng.integers(1, 4)), rng.uniform(0.8, 0.95)
    w = 0.65 * seats + 0.36
    parts = [
        _block(-w / 2 + 0.18, 0.08, 0.0, w - 0.36, 0.2, d, 0),
        _block(-w / 2 + 0.18, 0.28, d - 0.22, w - 0.36, 0.5, 0.22, 0),
    ]
    parts += [_block(x, 0.08, 0.0, 0.18, 0.52, d, 0) for x in (-w / 2, w / 2 - 0.18)]
    for i in range(seats):
        x = -w / 2 + 0.18 + i * 0.65
        parts.append(_block(x + 0.01, 0.28, 0.02, 0.63, 0.14, d - 0.26, 1))
        parts.append(_block(x + 0.03, 0.42, d - 0.34, 0.59, 0.34, 0.12, 1))
    return Piece(parts, w, d, 0.8)


def kitchen(rng: np.random.Generator) -> Piece:
    """Row of cupboards below and above a worktop."""
    count, d = int(rng.integers(3, 7)), 0.6
    w = 0.6 * count
    parts = [
        _block(-w / 2, 0.1, 0.03, w, 0.76, d - 0.03, 0),
        _block(-w / 2, 0.86, -0.02, w, 0.04, d + 0.02, 2),
    ]
    for i in range(count):
        x = -w / 2 + 0.6 * i
        parts.append(_block(x + 0.005, 0.11, 0.01, 0.59, 0.74, 0.02, 1))
        parts.append(_block(x + 0.2, 0.76, -0.02, 0.2, 0.015, 0.03, 3))
        if rng.random() < 0.8:
            parts.append(_block(x + 0.002, 1.4, 0.25, 0.596, 0.7, 0.35, 0))
            parts.append(_block(x + 0.008, 1.41, 0.235, 0.584, 0.68, 0.015, 1))
    return Piece(parts, w, d, 2.1)


def screen(rng: np.random.Generator) -> Piece:
    """Low board with a television."""
    w, wide = rng.uniform(1.2, 2.0), rng.uniform(0.8, 1.4)
    parts = [_block(-w / 2, 0.0, 0.0, w, 0.42, 0.42, 0)]
    parts.append(_block(-wide / 2, 0.48, 0.2, wide, wide * 0.56, 0.05, 4))
    parts.append(_block(-wide / 2 + 0.02, 0.5, 0.193, wide - 0.04, wide * 0.56 - 0.04, 0.007, 3))
    parts.append(_block(-0.2, 0.42, 0.15, 0.4, 0.06, 0.15, 4))
    return Piece(parts, w, 0.42, 1.2)


def door(rng: np.random.Generator) -> Piece:
    """Door leaf with panels in a frame, standing out of the wall."""
    w, h = rng.uniform(0.8, 0.95), rng.uniform(1.98, 2.1)
    parts = [_block(x, 0.0, 0.0, 0.08, h + 0.08, 0.04, 1) for x in (-w / 2 - 0.08, w / 2)]
    parts += [_block(-w / 2, h, 0.0, w, 0.08, 0.04, 1), _block(-w / 2, 0.0, 0.015, w, h, 0.025, 0)]
    for low, high in ((0.08, 0.42), (0.5, 0.94))[: int(rng.integers(0, 3))]:
        parts.append(_block(-w / 2 + 0.12, low * h, 0.005, w - 0.24, (high - low) * h, 0.012, 0))
    parts.append(_block(w / 2 - 0.14, 1.02, -0.03, 0.1, 0.02, 0.045, 2))
    return Piece(parts, w + 0.16, 0.04, h + 0.08)


def window(rng: np.random.Generator) -> Piece:
    """Window with mullions; colour 5 is its pane, through which one sees the outside."""
    w, h, sill = rng.uniform(0.7, 2.2), rng.uniform(0.9, 1.4), rng.uniform(0.7, 1.0)
    parts = [_block(-w / 2, sill, 0.02, w, h, 0.02, 5)]
    parts += [_block(x, sill - 0.06, 0.0, 0.06, h + 0.12, 0.04, 1) for x in (-w / 2 - 0.06, w / 2)]
    parts += [_block(-w / 2, y, 0.0, w, 0.06, 0.04, 1) for y in (sill - 0.06, sill + h)]
    for i in range(1, int(rng.integers(1, 4))):
        parts.append(_block(-w / 2 + i * w / 3 - 0.02, sill, 0.005, 0.04, h, 0.035, 1))
    if rng.random() < 0.5:
        parts.append(_block(-w / 2 - 0.15, sill - 0.1, -0.12, w + 0.3, 0.04, 0.16, 1))
    return Piece(parts, w + 0.12, 0.04, sill + h)


def painting(rng: np.random.Generator) -> Piece:
    """Framed picture on a wall."""
    w, h, y = rng.uniform(0.35, 1.1), rng.uniform(0.35, 0.9), rng.uniform(1.1, 1.5)
    parts = [_block(-w / 2, y, 0.01, w, h, 0.02, 4)]
    parts.append(
        _block(-w / 2 + 0.05, y + 0.05, 0.002, w - 0.1, h - 0.1, 0.01, int(rng.integers(0, 4)))
    )
    return Piece(parts, w, 0.03, y + h)


STANDING: tuple[Callable[[np.random.Generator], Piece], ...] = (
    wardrobe,
    bookshelf,
    cabinet,
    bed,
    sofa,
    kitchen,
    screen,
    table,
    bookshelf,
    cabinet,
)
FITTED: tuple[Callable[[np.random.Generator], Piece], ...] = (
    window,
    door,
    painting,
    window,
    painting,
)

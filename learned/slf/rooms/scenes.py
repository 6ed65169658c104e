"""Procedural interiors, furnished with boxes and models; one time in four a street."""

from collections.abc import Sequence

import numpy as np
from numpy import ndarray

from learned.slf.rooms.builder import Patterns, RoomScene, SceneBuilder, Size, finished
from learned.slf.rooms.furniture import FITTED, Part, chair, table
from learned.slf.rooms.streets import draw_street


def draw_scene(
    rng: np.random.Generator, patterns: Patterns, models: Sequence[Size] = ()
) -> RoomScene:
    """Draw a furnished room, or one time in four a street front.

    Args:
        rng: Source of randomness.
        patterns: Drawn textures to choose from, by use.
        models: Sizes of modelled furniture to choose from, beside that made of boxes.
    """
    return draw_street(rng, patterns) if rng.random() < 0.25 else _room(rng, patterns, models)


def _room(rng: np.random.Generator, patterns: Patterns, models: Sequence[Size]) -> RoomScene:
    shell = np.array([rng.uniform(1.6, 3.6), rng.uniform(1.2, 1.6), rng.uniform(1.6, 4.5)])
    build = SceneBuilder(rng, patterns, models)
    wall = build.new_material(low=0.35, high=0.8)
    other = (
        build.new_material(pattern="wall", pattern_m=2 * shell[1]) if rng.random() < 0.5 else wall
    )
    floor = build.new_material(pattern="floor", pattern_m=rng.uniform(1.8, 4.0))
    ceiling = build.new_material(low=0.6, high=0.85)
    walls = rng.choice([wall, other], 4, p=[0.75, 0.25])
    shell_material = np.array([walls[0], walls[1], ceiling, floor, walls[2], walls[3]])
    skirting = build.new_material(low=0.2)
    for side in range(4):
        _furnish_wall(build, shell, side, skirting)
    _furnish_middle(build, shell)
    size = rng.uniform(0.3, 1.2, 2)
    count = 1 + int(shell[0] * shell[2] > 7)
    lights = np.array(
        [
            [
                x,
                -shell[1] + 0.06,
                z,
                *size,
                22.0 * shell[0] * shell[2] / count * rng.uniform(0.5, 1.6),
            ]
            for x, z in rng.uniform(-0.5, 0.5, (count, 2)) * shell[[0, 2]]
        ]
    )
    lamp = build.new_material(emission=rng.uniform(1.0, 4.0))
    for x, y, z, w, d, _ in lights:
        part = Part((-w / 2, -0.05, -d / 2), (w / 2, 0.0, d / 2))
        build.add(part, np.array([x, y, z]), 0.0, lamp)
    return finished(build, shell, shell_material, lights, is_open=False)


def _furnish_wall(build: SceneBuilder, shell: ndarray, side: int, skirting: int) -> None:
    """Set pieces along a wall from one end to the other, windows and pictures where it is free."""
    rng = build.rng
    yaw = side * np.pi / 2
    along = shell[0] if side % 2 == 0 else shell[2]
    away = shell[2] if side % 2 == 0 else shell[0]
    c, s = np.cos(yaw), np.sin(yaw)

    def origin(x: float, z: float) -> ndarray:
        return np.array([c * x + s * z, shell[1], -s * x + c * z])

    board = Part((-along, -0.09, -0.015), (along, 0.0, 0.0))
    build.add(board, origin(0.0, away), yaw, skirting)
    x = -along + rng.uniform(0.1, 0.8)
    while x < along - 0.6:
        fitted = rng.random() < 0.45
        piece = FITTED[int(rng.integers(len(FITTED)))](rng) if fitted else build.standing()
        if x + piece.width > along - 0.1 or piece.height > 2 * shell[1] - 0.1:
            x += 0.3
            continue
        middle = origin(x + piece.width / 2, away - piece.depth / 2)[[0, 2]]
        reach = max(piece.width, piece.depth) / 2 if not fitted else 0.05
        if piece.depth < 0.6 * away and (fitted or build.is_free(middle, 0.85 * reach)):
            place = origin(x + piece.width / 2, away - piece.depth)
            build.place(piece, place, yaw, pane=rng.uniform(0.5, 5.0))
        x += piece.width + rng.uniform(0.1, 0.9)


def _furnish_middle(build: SceneBuilder, shell: ndarray) -> None:
    """A table with chairs and a rug, where there is room."""
    rng = build.rng
    if min(shell[0], shell[2]) < 2.0:
        return
    middle = rng.uniform(-0.3, 0.3, 2) * shell[[0, 2]]
    if not build.is_free(middle, 1.1):
        return
    yaw = rng.choice([0.0, np.pi / 2, rng.uniform(-np.pi, np.pi)])
    c, s = np.cos(yaw), np.sin(yaw)
    piece = table(rng)

    def origin(x: float, z: float) -> ndarray:
        return np.array([middle[0] + c * x + s * z, shell[1], middle[1] - s * x + c * z])

    build.place(piece, origin(0.0, -piece.depth / 2), yaw)
    for x in (-piece.width / 4, piece.width / 4):
        for turn, z in ((0.0, piece.depth / 2 - 0.1), (np.pi, -piece.depth / 2 + 0.1)):
            if rng.random() < 0.75:
                build.place(chair(rng), origin(x, z), yaw + turn)
    rug = Part((-1.1, -0.012, -0.9), (1.1, 0.0, 0.9))
    build.add(rug, origin(0.0, 0.0), yaw, build.new_material(pattern="floor", pattern_m=1.8))

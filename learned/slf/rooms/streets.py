"""Street fronts of boxes."""

import numpy as np

from learned.slf.rooms.builder import Patterns, RoomScene, SceneBuilder, finished
from learned.slf.rooms.furniture import Part


def draw_street(rng: np.random.Generator, patterns: Patterns) -> RoomScene:
    """Two rows of house fronts along a street."""
    width, eye = rng.uniform(4.0, 9.0), rng.uniform(1.4, 3.5)
    shell = np.array([200.0, eye, 200.0])
    build = SceneBuilder(rng, patterns)
    ground = build.new_material(pattern="floor", pattern_m=rng.uniform(3.0, 6.0))
    shell_material = np.full(6, ground)
    pavement = build.new_material(low=0.1, high=0.4)
    for sign in (-1.0, 1.0):
        kerb = Part((-60.0, -0.14, 0.0), (60.0, 0.0, 3.0))
        yaw = sign * np.pi / 2
        build.add(kerb, np.array([sign * (width - 2.2), eye, 0.0]), yaw, pavement)
        z = -35.0
        while z < 35.0:
            long, high = rng.uniform(6.0, 14.0), rng.uniform(4.0, 14.0)
            _house(build, sign, width + rng.uniform(0, 0.8), z + long / 2, long, high, eye)
            z += long + (rng.uniform(0.0, 3.0) if rng.random() < 0.3 else 0.0)
    for _ in range(int(rng.integers(1, 6))):
        _car(build, rng.choice([-1.0, 1.0]) * (width - 3.3), rng.uniform(-15, 15), eye)
    return finished(build, shell, shell_material, np.zeros((0, 6)), is_open=True)


def _house(
    build: SceneBuilder, sign: float, x: float, z: float, long: float, high: float, eye: float
) -> None:
    """A block with rows of windows, ledges, a cornice and a door."""
    rng = build.rng
    textured = rng.random() < 0.35
    wall = build.new_material(
        low=0.15, high=0.7, pattern="front" if textured else "", pattern_m=rng.uniform(2.0, 4.0)
    )
    frame, glass, trim = (
        build.new_material(low=0.3),
        build.new_material(high=0.1),
        build.new_material(),
    )
    yaw, origin = sign * np.pi / 2, np.array([sign * x, eye, z])
    build.add(Part((-long / 2, -high, 0.0), (long / 2, 0.0, 8.0)), origin, yaw, wall)
    floors, columns = max(1, int(high / 3.0)), max(1, int(long / rng.uniform(1.8, 3.2)))
    w, h = long / columns * rng.uniform(0.35, 0.6), high / floors * rng.uniform(0.4, 0.6)
    for i in range(floors):
        foot = -(i + 0.3) * high / floors
        for j in range(columns):
            u = (j + 0.5) * long / columns - long / 2
            box = Part((u - w / 2, foot - h, -0.03), (u + w / 2, foot, 0.0))
            build.add(box, origin, yaw, glass)
            for a, b in ((-w / 2 - 0.07, -w / 2), (-0.025, 0.025), (w / 2, w / 2 + 0.07)):
                bar = Part((u + a, foot - h, -0.07), (u + b, foot, 0.0))
                build.add(bar, origin, yaw, frame)
            for y in (foot, foot - h - 0.08):
                bar = Part((u - w / 2 - 0.12, y, -0.1), (u + w / 2 + 0.12, y + 0.08, 0.0))
                build.add(bar, origin, yaw, frame)
        if i and rng.random() < 0.4:
            y = -i * high / floors
            build.add(
                Part((-long / 2, y - 0.1, -0.12), (long / 2, y + 0.1, 0.0)), origin, yaw, trim
            )
    cornice = Part((-long / 2, -high - 0.15, -0.3), (long / 2, -high + 0.15, 8.0))
    build.add(cornice, origin, yaw, trim)


def _car(build: SceneBuilder, x: float, z: float, eye: float) -> None:
    rng = build.rng
    long, paint, dark = rng.uniform(3.8, 4.8), build.new_material(), build.new_material(high=0.06)
    origin = np.array([x, eye, z])
    build.add(Part((-0.85, -0.85, -long / 2), (0.85, -0.25, long / 2)), origin, 0.0, paint)
    build.add(Part((-0.75, -1.42, -long / 4), (0.75, -0.85, long / 3)), origin, 0.0, dark)
    for u in (-0.8, 0.6):
        for v in (-long / 3, long / 3):
            wheel = Part((u, -0.6, v - 0.3), (u + 0.2, 0.0, v + 0.3))
            build.add(wheel, origin, 0.0, dark)

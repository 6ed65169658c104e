"""Procedural interiors and street fronts as boxes, with colours and light.

World axes are those of `learned.slf.boxes`: x right, y down, z forward, metres.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from learned.slf.layouts import draw_rotations
from learned.slf.rooms.furniture import FITTED, STANDING, Part, Piece, chair, table

_COLOURS_A_PIECE = 6
_PANE = 5
_HUE = 0.13
_CAMERA_GAP_M = 0.35
_TRIES = 60


@dataclass(frozen=True)
class RoomScene:
    """A scene of boxes.

    Attributes:
        centre: Centres of the solids.
        half: Half sizes.
        yaw: Turns about the vertical in radians.
        material: Material of each solid.
        colour: Linear RGB per material.
        roughness: Roughness per material.
        emission: Emitted radiance per material, 0 for most.
        pattern: Drawn texture per material, −1 for plain.
        tile: Width and height of one texture per material, metres.
        shell: Half sizes of the room, or of the ground in the open.
        shell_material: Materials of the shell's six faces.
        lights: Ceiling lamps: centre and size (x, y, z, width, depth), and power in W.
        sky: Strength of the sky; 0 indoors.
        sky_turn: Turn of the sky in radians.
        exposure: In stops.
        position: Of the camera.
        rotation: World directions of the camera's axes (columns).
        is_open: Whether the shell is only a ground.
    """

    centre: Float[ndarray, "n 3"]
    half: Float[ndarray, "n 3"]
    yaw: Float[ndarray, " n"]
    material: Int[ndarray, " n"]
    colour: Float[ndarray, "m 3"]
    roughness: Float[ndarray, " m"]
    emission: Float[ndarray, " m"]
    pattern: Int[ndarray, " m"]
    tile: Float[ndarray, "m 2"]
    shell: Float[ndarray, " 3"]
    shell_material: Int[ndarray, " 6"]
    lights: Float[ndarray, "k 6"]
    sky: float
    sky_turn: float
    exposure: float
    position: Float[ndarray, " 3"]
    rotation: Float[ndarray, "3 3"]
    is_open: bool


Patterns = Mapping[str, Sequence[int]]
"""Numbers of the drawn textures fit for each use: `floor`, `wall`, `front`."""


class _Builder:
    """Collects solids and materials; the scene is made from it once."""

    def __init__(self, rng: np.random.Generator, patterns: Patterns) -> None:
        self.rng = rng
        self.patterns = patterns
        self.solids: list[tuple[ndarray, ndarray, float, int]] = []
        self.materials: list[tuple[ndarray, float, float, int, ndarray]] = []
        self.footprints: list[tuple[ndarray, float]] = []

    def new_material(
        self,
        *,
        low: float = 0.03,
        high: float = 0.8,
        emission: float = 0.0,
        pattern: str = "",
        pattern_m: float = 1.0,
    ) -> int:
        """Add a material; with a use it gets a drawn texture of about `pattern_m` in height."""
        rng = self.rng
        grey = np.exp(rng.uniform(np.log(low), np.log(high)))
        colour = np.clip(grey * np.exp(rng.normal(0, _HUE, 3)), 0.01, 0.9)
        drawn = self.patterns.get(pattern, ())
        number = int(drawn[int(rng.integers(len(drawn)))]) if len(drawn) else -1
        tile = np.array([rng.uniform(0.9, 1.6), 1.0]) * pattern_m
        self.materials.append((colour, float(rng.uniform(0.15, 0.9)), emission, number, tile))
        return len(self.materials) - 1

    def add(self, part: Part, origin: ndarray, yaw: float, material: int) -> None:
        """Add a part of a piece that stands at `origin`, turned by `yaw`."""
        low, high = np.array(part.low), np.array(part.high)
        c, s = np.cos(yaw), np.sin(yaw)
        middle = (low + high) / 2
        turned = np.array(
            [c * middle[0] + s * middle[2], middle[1], -s * middle[0] + c * middle[2]]
        )
        self.solids.append((origin + turned, (high - low) / 2, yaw, material))

    def place(self, piece: Piece, origin: ndarray, yaw: float, pane: float = 0.0) -> None:
        """Add a whole piece with colours of its own."""
        first = len(self.materials)
        for i in range(_COLOURS_A_PIECE):
            self.new_material(emission=pane if i == _PANE else 0.0)
        for part in piece.parts:
            self.add(part, origin, yaw, first + part.colour)

    def is_free(self, middle: ndarray, reach: float) -> bool:
        """Whether a disc on the floor is clear of what stands there, and take it."""
        for other, radius in self.footprints:
            if np.hypot(*(other - middle)) < radius + reach:
                return False
        self.footprints.append((middle, reach))
        return True


def draw_scene(rng: np.random.Generator, patterns: Patterns) -> RoomScene:
    """Draw a furnished room, or one time in four a street front.

    Args:
        rng: Source of randomness.
        patterns: Drawn textures to choose from, by use.
    """
    return _street(rng, patterns) if rng.random() < 0.25 else _room(rng, patterns)


def _room(rng: np.random.Generator, patterns: Patterns) -> RoomScene:
    shell = np.array([rng.uniform(1.6, 3.6), rng.uniform(1.2, 1.6), rng.uniform(1.6, 4.5)])
    build = _Builder(rng, patterns)
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
    return _finished(build, shell, shell_material, lights, is_open=False)


def _furnish_wall(build: _Builder, shell: ndarray, side: int, skirting: int) -> None:
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
        kinds = FITTED if fitted else STANDING
        piece = kinds[int(rng.integers(len(kinds)))](rng)
        if x + piece.width > along - 0.1 or piece.height > 2 * shell[1] - 0.1:
            x += 0.3
            continue
        middle = origin(x + piece.width / 2, away - piece.depth / 2)[[0, 2]]
        reach = max(piece.width, piece.depth) / 2 if not fitted else 0.05
        if piece.depth < 0.6 * away and (fitted or build.is_free(middle, 0.85 * reach)):
            place = origin(x + piece.width / 2, away - piece.depth)
            build.place(piece, place, yaw, pane=rng.uniform(0.5, 5.0))
        x += piece.width + rng.uniform(0.1, 0.9)


def _furnish_middle(build: _Builder, shell: ndarray) -> None:
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


def _street(rng: np.random.Generator, patterns: Patterns) -> RoomScene:
    """Two rows of house fronts along a street."""
    width, eye = rng.uniform(4.0, 9.0), rng.uniform(1.4, 3.5)
    shell = np.array([200.0, eye, 200.0])
    build = _Builder(rng, patterns)
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
    return _finished(build, shell, shell_material, np.zeros((0, 6)), is_open=True)


def _house(
    build: _Builder, sign: float, x: float, z: float, long: float, high: float, eye: float
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


def _car(build: _Builder, x: float, z: float, eye: float) -> None:
    rng = build.rng
    long, paint, dark = rng.uniform(3.8, 4.8), build.new_material(), build.new_material(high=0.06)
    origin = np.array([x, eye, z])
    build.add(Part((-0.85, -0.85, -long / 2), (0.85, -0.25, long / 2)), origin, 0.0, paint)
    build.add(Part((-0.75, -1.42, -long / 4), (0.75, -0.85, long / 3)), origin, 0.0, dark)
    for u in (-0.8, 0.6):
        for v in (-long / 3, long / 3):
            wheel = Part((u, -0.6, v - 0.3), (u + 0.2, 0.0, v + 0.3))
            build.add(wheel, origin, 0.0, dark)


def _finished(
    build: _Builder, shell: ndarray, shell_material: ndarray, lights: ndarray, *, is_open: bool
) -> RoomScene:
    rng = build.rng
    centre, half = (np.array([s[i] for s in build.solids]) for i in (0, 1))
    yaw = np.array([s[2] for s in build.solids])
    reach = np.array([4.0, 0.0, 12.0]) if is_open else shell - [0.5, 0.0, 0.5]
    colour, roughness, emission, pattern, tile = (
        np.array(x) for x in zip(*build.materials, strict=True)
    )
    return RoomScene(
        centre=centre,
        half=half,
        yaw=yaw,
        material=np.array([s[3] for s in build.solids]),
        colour=colour,
        roughness=roughness,
        emission=emission,
        pattern=pattern,
        tile=tile,
        shell=shell,
        shell_material=shell_material,
        lights=lights,
        sky=float(rng.uniform(0.6, 1.4)) if is_open else 0.0,
        sky_turn=float(rng.uniform(0, 2 * np.pi)),
        exposure=float(rng.normal(0.0, 0.3)),
        position=_camera_place(rng, centre, half, yaw, shell, reach),
        rotation=draw_rotations(rng, 1)[0],
        is_open=is_open,
    )


def _camera_place(
    rng: np.random.Generator,
    centre: ndarray,
    half: ndarray,
    yaw: ndarray,
    shell: ndarray,
    reach: ndarray,
) -> ndarray:
    """A place clear of all solids, or the clearest of many."""
    best, best_gap = np.zeros(3), -np.inf
    for _ in range(_TRIES):
        height = rng.uniform(0.9, 1.9) if shell[0] < 100 else shell[1]
        place = rng.uniform(-1, 1, 3) * reach
        place[1] = shell[1] - height
        away = place - centre
        c, s = np.cos(yaw), np.sin(yaw)
        local = np.stack(
            [c * away[:, 0] - s * away[:, 2], away[:, 1], s * away[:, 0] + c * away[:, 2]], 1
        )
        gap = np.linalg.norm(np.maximum(np.abs(local) - half, 0), axis=1).min()
        if gap > best_gap:
            best, best_gap = place, gap
        if gap > _CAMERA_GAP_M:
            break
    return best

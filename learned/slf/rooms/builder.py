"""Scenes of boxes and models: what they hold, and how they are put together.

World axes are those of `learned.slf.boxes`: x right, y down, z forward, metres.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from learned.slf.layouts import draw_rotations
from learned.slf.rooms.furniture import STANDING, Part, Piece

_COLOURS_A_PIECE = 6
_PANE = 5
_HUE = 0.13
_CAMERA_GAP_M = 0.35
_MODEL_SHARE = 0.7  # of the pieces at a wall, where there are models
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
        is_pane: Whether the camera sees the outside in a material, which shines.
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
        model: Number of each piece that is a model.
        model_pose: From a model's own axes (those of a piece) to the world's.
    """

    centre: Float[ndarray, "n 3"]
    half: Float[ndarray, "n 3"]
    yaw: Float[ndarray, " n"]
    material: Int[ndarray, " n"]
    colour: Float[ndarray, "m 3"]
    roughness: Float[ndarray, " m"]
    emission: Float[ndarray, " m"]
    is_pane: Bool[ndarray, " m"]
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
    model: Int[ndarray, " p"]
    model_pose: Float[ndarray, "p 4 4"]


Patterns = Mapping[str, Sequence[int]]
"""Numbers of the drawn textures fit for each use: `floor`, `wall`, `front`."""

Size = tuple[float, float, float]
"""Width, depth and height of a modelled piece of furniture in metres."""


class SceneBuilder:
    """Collects solids and materials; the scene is made from it once."""

    def __init__(
        self, rng: np.random.Generator, patterns: Patterns, models: Sequence[Size] = ()
    ) -> None:
        self.rng = rng
        self.patterns = patterns
        self.models = models
        self.placed: list[tuple[int, ndarray]] = []
        self.bounds: list[tuple[ndarray, ndarray, float]] = []
        self.solids: list[tuple[ndarray, ndarray, float, int]] = []
        self.materials: list[tuple[ndarray, float, float, bool, int, ndarray]] = []
        self.footprints: list[tuple[ndarray, float]] = []

    def new_material(
        self,
        *,
        low: float = 0.03,
        high: float = 0.8,
        emission: float = 0.0,
        is_pane: bool = False,
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
        roughness = float(rng.uniform(0.15, 0.9))
        self.materials.append((colour, roughness, emission, is_pane, number, tile))
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
        if piece.model >= 0:
            self._place_model(piece, origin, yaw)
            return
        first = len(self.materials)
        for i in range(_COLOURS_A_PIECE):
            is_pane = i == _PANE
            self.new_material(emission=pane if is_pane else 0.0, is_pane=is_pane)
        for part in piece.parts:
            self.add(part, origin, yaw, first + part.colour)

    def _place_model(self, piece: Piece, origin: ndarray, yaw: float) -> None:
        c, s = np.cos(yaw), np.sin(yaw)
        turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, origin
        self.placed.append((piece.model, pose))
        half = np.array([piece.width, piece.height, piece.depth]) / 2
        self.bounds.append((origin + turn @ [0.0, -half[1], half[2]], half, yaw))

    def standing(self) -> Piece:
        """A piece to stand at a wall: mostly a model where there are any."""
        rng = self.rng
        if len(self.models) and rng.random() < _MODEL_SHARE:
            number = int(rng.integers(len(self.models)))
            return Piece([], *self.models[number], model=number)
        return STANDING[int(rng.integers(len(STANDING)))](rng)

    def is_free(self, middle: ndarray, reach: float) -> bool:
        """Whether a disc on the floor is clear of what stands there, and take it."""
        for other, radius in self.footprints:
            if np.hypot(*(other - middle)) < radius + reach:
                return False
        self.footprints.append((middle, reach))
        return True


def finished(
    build: SceneBuilder, shell: ndarray, shell_material: ndarray, lights: ndarray, *, is_open: bool
) -> RoomScene:
    """The scene of what was collected, with a camera somewhere clear of it.

    Args:
        build: Solids, models and materials.
        shell: Half sizes of the room or of the ground.
        shell_material: Materials of its six faces.
        lights: Ceiling lamps.
        is_open: Whether the shell is only a ground.
    """
    rng = build.rng
    centre, half = (np.array([s[i] for s in build.solids]) for i in (0, 1))
    yaw = np.array([s[2] for s in build.solids])
    reach = np.array([4.0, 0.0, 12.0]) if is_open else shell - [0.5, 0.0, 0.5]
    colour, roughness, emission, is_pane, pattern, tile = (
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
        is_pane=is_pane,
        pattern=pattern,
        tile=tile,
        shell=shell,
        shell_material=shell_material,
        lights=lights,
        sky=float(rng.uniform(0.6, 1.4)) if is_open else 0.0,
        sky_turn=float(rng.uniform(0, 2 * np.pi)),
        exposure=float(rng.normal(0.0, 0.3)),
        position=_camera_place(rng, *_obstacles(build), shell, reach),
        rotation=draw_rotations(rng, 1)[0],
        is_open=is_open,
        model=np.array([number for number, _ in build.placed], dtype=int),
        model_pose=np.array([pose for _, pose in build.placed]).reshape(-1, 4, 4),
    )


def _obstacles(build: SceneBuilder) -> tuple[ndarray, ndarray, ndarray]:
    """Centres, half sizes and turns of all that the camera must not stand in."""
    solids = [*[solid[:3] for solid in build.solids], *build.bounds]
    centre, half, yaw = (np.array(part) for part in zip(*solids, strict=True))
    return centre, half, yaw


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

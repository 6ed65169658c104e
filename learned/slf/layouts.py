"""Random rooms, halls and street canyons for `boxes`, and random poses."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray
from torch import Tensor

from learned.slf.atlas import Atlas
from learned.slf.boxes import FACES, Boxes

_CLEARANCE_M = 0.6
_CEILING, _FLOOR = 2, 3


@dataclass(frozen=True)
class PoseCfg:
    """Camera poses: mostly held level, some held anyhow.

    Attributes:
        level_share: Weight of the level part.
        level_sigma: Standard deviations of pitch and roll there, in radians.
        free_sigma: Standard deviation of the pitch of the rest; their roll is uniform.
    """

    level_share: float = 0.75
    level_sigma: tuple[float, float] = (np.radians(12.0), np.radians(4.0))
    free_sigma: float = np.radians(40.0)


@dataclass(frozen=True)
class LayoutCfg:
    """Sizes of scenes in metres.

    Attributes:
        kinds: Weights of room, hall and canyon.
        width: Range of the width per kind.
        height: Range of the height per kind.
        depth: Range of the depth per kind.
        object_size: Range of the objects' sides per kind.
        most_objects: Largest number of objects.
        pattern_share: Weight of drawn patterns on walls; on floors and ceilings it is doubled.
    """

    kinds: tuple[float, float, float] = (0.6, 0.15, 0.25)
    width: tuple[tuple[float, float], ...] = ((2.4, 7.0), (6.0, 18.0), (8.0, 24.0))
    height: tuple[tuple[float, float], ...] = ((2.2, 3.6), (3.5, 8.0), (6.0, 18.0))
    depth: tuple[tuple[float, float], ...] = ((2.4, 9.0), (8.0, 30.0), (25.0, 70.0))
    object_size: tuple[tuple[float, float], ...] = ((0.35, 1.6), (0.5, 2.5), (1.2, 4.5))
    most_objects: int = 4
    pattern_share: float = 0.35


def draw_rotations(
    rng: np.random.Generator, n: int, config: PoseCfg | None = None
) -> Float[ndarray, "n 3 3"]:
    """Rotations from camera to world: any yaw, pitch and roll as configured."""
    config = config or PoseCfg()
    level = rng.random(n) < config.level_share
    pitch_sigma = np.where(level, config.level_sigma[0], config.free_sigma)
    pitch = np.clip(rng.normal(size=n) * pitch_sigma, -1.5, 1.5)
    roll = np.where(
        level, rng.normal(size=n) * config.level_sigma[1], rng.uniform(-np.pi, np.pi, n)
    )
    yaw = rng.uniform(-np.pi, np.pi, n)
    return _about(1, yaw) @ _about(0, pitch) @ _about(2, roll)


def draw_boxes(
    rng: np.random.Generator,
    atlas: Atlas,
    photographs: Int[Tensor, " p"],
    patterns: Int[Tensor, " q"],
    n: int,
    config: LayoutCfg | None = None,
) -> Boxes:
    """Draw scenes of boxes.

    Args:
        rng: Source of randomness.
        atlas: Where the pictures are.
        photographs: Numbers of the photographs to choose from.
        patterns: Numbers of the drawn patterns to choose from; may be empty.
        n: Number of scenes.
        config: Sizes.
    """
    config = config or LayoutCfg()
    kind = rng.choice(len(config.kinds), n, p=np.array(config.kinds) / sum(config.kinds))
    room = _log_uniform(rng, np.stack([_ranges(r, kind) for r in _sizes(config)], 1)) / 2
    eye = room * rng.uniform(-1, 1, (n, 3)) * 0.65
    eye[:, 1] = room[:, 1] - np.minimum(rng.uniform(0.7, 2.2, n), 1.8 * room[:, 1])
    eye[:, [0, 2]] = np.clip(eye[:, [0, 2]], -room[:, [0, 2]] + 0.3, room[:, [0, 2]] - 0.3)
    centre, half, yaw = _objects(rng, room, eye, _ranges(config.object_size, kind), config)
    photo_ids, pattern_ids = photographs.cpu().numpy(), patterns.cpu().numpy()
    picture = _pictures(rng, half.shape[:2], photo_ids, pattern_ids, config.pattern_share)
    tile, offset = _tiles(rng, atlas.extent[:, 0].cpu().numpy()[picture], half)
    shade = rng.uniform(0.55, 1.15, picture.shape)
    arrays = (centre, half, yaw, picture, tile, offset, shade, draw_rotations(rng, n), eye)
    device = atlas.texels.device
    tensors = [
        torch.as_tensor(a, device=device, dtype=torch.int64 if a is picture else torch.float32)
        for a in arrays
    ]
    return Boxes(*tensors)


def _sizes(config: LayoutCfg) -> tuple[tuple[tuple[float, float], ...], ...]:
    return config.width, config.height, config.depth


def _ranges(ranges: tuple[tuple[float, float], ...], kind: ndarray) -> ndarray:
    return np.array(ranges)[kind]


def _log_uniform(rng: np.random.Generator, ranges: ndarray) -> ndarray:
    low, high = np.log(ranges[..., 0]), np.log(ranges[..., 1])
    return np.exp(low + (high - low) * rng.random(low.shape))


def _objects(
    rng: np.random.Generator, room: ndarray, eye: ndarray, size: ndarray, config: LayoutCfg
) -> tuple[ndarray, ndarray, ndarray]:
    """The room as box 0, then objects on its floor or under its ceiling, clear of the camera."""
    n, most = len(room), config.most_objects
    half = _log_uniform(rng, np.broadcast_to(size[:, None, None], (n, most, 3, 2))) / 2
    half = np.minimum(half, 0.45 * room[:, None])
    free = np.maximum(room[:, None] - half, 0)
    place = rng.uniform(-1, 1, (n, most, 3))
    # furniture stands along walls: push one horizontal coordinate outwards
    walls = rng.random((n, most)) < 0.6
    which = np.where(rng.random((n, most)) < 0.5, 0, 2)
    for axis in (0, 2):
        at = walls & (which == axis)
        place[..., axis] = np.where(at, np.sign(place[..., axis]) * 0.98, place[..., axis] * 0.9)
    place[..., 1] = np.where(rng.random((n, most)) < 0.85, 1.0, -1.0)
    centre = place * free
    yaw = np.where(walls | (rng.random((n, most)) < 0.5), 0.0, rng.uniform(-0.8, 0.8, (n, most)))
    reach = np.hypot(half[..., 0], half[..., 2])
    away = np.linalg.norm(centre[..., [0, 2]] - eye[:, None, [0, 2]], axis=-1)
    there = (away > reach + _CLEARANCE_M) & (
        np.arange(most) < rng.integers(0, most + 1, n)[:, None]
    )
    half = half * there[..., None]
    centre = np.concatenate([np.zeros((n, 1, 3)), centre], axis=1)
    half = np.concatenate([room[:, None], half], axis=1)
    return centre, half, np.concatenate([np.zeros((n, 1)), yaw], axis=1)


def _pictures(
    rng: np.random.Generator,
    shape: tuple[int, ...],
    photographs: ndarray,
    patterns: ndarray,
    pattern_share: float,
) -> ndarray:
    faces = (*shape, FACES)
    picture = photographs[rng.integers(0, len(photographs), faces)]
    if len(patterns) == 0:
        return picture
    share = np.full(FACES, pattern_share)
    share[[_CEILING, _FLOOR]] = min(1.0, 2 * pattern_share)
    drawn = patterns[rng.integers(0, len(patterns), faces)]
    return np.where(rng.random(faces) < share, drawn, picture)


def _tiles(rng: np.random.Generator, extent: ndarray, half: ndarray) -> tuple[ndarray, ndarray]:
    """Size of a picture on each face: as high as a wall, or a part of a floor."""
    axis = np.arange(FACES) // 2
    size_u = 2 * np.where(axis == 0, half[..., 2:3], half[..., 0:1])
    size_v = 2 * np.where(axis == 1, half[..., 2:3], half[..., 1:2])
    aspect = extent[..., 0] / extent[..., 1] * rng.uniform(0.85, 1.2, extent.shape[:-1])
    high = size_v * np.where(axis == 1, rng.uniform(0.35, 1.0, aspect.shape), 1.0)
    # no face takes more than a handful of repeats, however long it is
    wide = np.maximum(np.maximum(high * aspect, size_u / 4), 1e-3)
    offset = rng.uniform(0, 2, (*aspect.shape, 2))
    offset[..., 1] = np.where(axis == 1, offset[..., 1], 0.0)
    return np.stack([wide, np.maximum(high, 1e-3)], -1), offset


def _about(axis: int, angle: ndarray) -> ndarray:
    """Rotations about one axis."""
    matrix = np.zeros((len(angle), 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[:, axis, axis] = 1.0
    matrix[:, i, i] = matrix[:, j, j] = np.cos(angle)
    matrix[:, i, j], matrix[:, j, i] = -np.sin(angle), np.sin(angle)
    return matrix

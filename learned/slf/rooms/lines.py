"""True lines of a room: edges of its boxes and lines of its drawn textures, as far as seen."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from learned.slf.atlas import Atlas
from learned.slf.boxes import FACES, Boxes, edge_segments, pattern_segments
from learned.slf.optics import Optics, unproject
from learned.slf.rooms.builder import RoomScene
from learned.slf.rooms.sight import BoxSight, Sight
from learned.slf.strokes import (
    Segments3D,
    Strokes,
    bent_strokes,
    cut_strokes,
    filtered_strokes,
)

_SIDE_PX = 1.2
_GROUND = 3
_SKY_M = 200.0
_LEAST_SEEN = 0.6
_CELL_PX, _CROWD = 6.0, 3  # so many lines of one direction in a cell melt into grey
_DIRECTIONS = 4


@dataclass(frozen=True)
class RoomGeometry:
    """A room for ray casting.

    Attributes:
        boxes: The shell as box 0 and the solids.
        material: Material of every face, shape (1, n, 6); negative where there is no face.
        is_open: Whether the shell is only a ground.
    """

    boxes: Boxes
    material: Tensor
    is_open: bool


def room_geometry(scene: RoomScene, atlas: Atlas) -> RoomGeometry:
    """The scene as boxes with drawn textures; plain faces take the atlas's last picture.

    Args:
        scene: The room.
        atlas: Drawn textures, then one without lines.
    """
    n = len(scene.centre) + 1
    material = np.concatenate(
        [scene.shell_material[None], np.repeat(scene.material[:, None], FACES, 1)]
    )
    pattern = scene.pattern[material]
    middle, shell = np.zeros(3), scene.shell
    if scene.is_open:
        # only the ground of an open shell is there: lift its ceiling out of sight
        pattern[0, np.arange(FACES) != _GROUND] = -1
        wide, ground, deep = scene.shell
        middle = np.array([0.0, ground - _SKY_M, 0.0])
        shell = np.array([wide, _SKY_M, deep])
    arrays = (
        np.concatenate([middle[None], scene.centre]),
        np.concatenate([shell[None], scene.half]),
        np.concatenate([[0.0], scene.yaw]),
        np.where(pattern < 0, len(atlas) - 1, pattern),
        np.where((pattern < 0)[..., None], 1e3, scene.tile[material]),
        np.zeros((n, FACES, 2)),
        np.ones((n, FACES)),
        scene.rotation,
        scene.position,
    )
    tensors = [
        torch.as_tensor(a[None], dtype=torch.int64 if i == 3 else torch.float32)
        for i, a in enumerate(arrays)
    ]
    return RoomGeometry(Boxes(*tensors), torch.as_tensor(material[None]), scene.is_open)


def room_strokes(
    room: RoomGeometry,
    atlas: Atlas,
    lens: Optics,
    *,
    shortest_px: float,
    sight: Sight | None = None,
    edges: Segments3D | None = None,
) -> tuple[Strokes, Segments3D]:
    """Visible lines of the room in the fisheye picture, with the pieces they are of.

    An edge counts where the two sides of it differ: another face, material or distance. A seam of
    two flush boxes does not, nor do lines of a drawn texture that lie too close to be told apart.

    Args:
        room: The boxes.
        atlas: Drawn textures, then one without lines.
        lens: The fisheye lens.
        shortest_px: Lines shorter than this are left out.
        sight: What is seen; None means that the boxes are all there is.
        edges: Of what is no box, in camera coordinates.
    """
    sight = sight or BoxSight(room.boxes, room.material)
    solid = edge_segments(room.boxes, with_room=not room.is_open)
    parts = [solid, *([edges] if edges is not None else []), pattern_segments(atlas, room.boxes)]
    segments = Segments3D(
        torch.cat([part.start for part in parts]),
        torch.cat([part.end for part in parts]),
        torch.cat([part.row for part in parts]),
    )
    strokes = bent_strokes(
        lens, segments, visibility=lambda points, _row: sight.sees(points), shortest_px=shortest_px
    )
    is_edge = strokes.segment < len(segments) - len(parts[-1])
    differs = sight.differ(*_sides(lens, strokes)).to(torch.float32)
    share = torch.zeros_like(strokes.length).index_add_(0, strokes.run, differs)
    share /= torch.bincount(strokes.run, minlength=len(strokes.length)).clamp_min(1)
    strokes = filtered_strokes(strokes, ~is_edge | (share >= _LEAST_SEEN))
    is_drawn = strokes.segment >= len(segments) - len(parts[-1])
    crowded = is_drawn.index_select(0, strokes.run) & _is_crowded(strokes)
    return cut_strokes(strokes, ~crowded, shortest_px=shortest_px), segments


def _is_crowded(strokes: Strokes) -> Tensor:
    """True for points among lines of one direction that are too near to be told apart."""
    angle = torch.atan2(strokes.tangent[:, 1], strokes.tangent[:, 0]) / np.pi
    direction = torch.round(angle * _DIRECTIONS).long() % _DIRECTIONS
    column, row = torch.floor(strokes.points / _CELL_PX).long().unbind(1)
    cells = torch.stack([column, row, direction], 1)
    _, cell = torch.unique(cells, dim=0, return_inverse=True)
    owners = torch.unique(torch.stack([cell, strokes.run], 1), dim=0)[:, 0]
    return torch.bincount(owners, minlength=int(cell.max()) + 1 if len(cell) else 0)[cell] >= _CROWD


def _sides(lens: Optics, strokes: Strokes) -> tuple[Tensor, Tensor]:
    """Rays a little to either side of every point."""
    normal = torch.stack([-strokes.tangent[:, 1], strokes.tangent[:, 0]], 1)
    row = torch.zeros(len(normal), dtype=torch.int64)
    return (
        unproject(lens, strokes.points - _SIDE_PX * normal, row)[0],
        unproject(lens, strokes.points + _SIDE_PX * normal, row)[0],
    )

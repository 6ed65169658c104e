"""Rooms and street canyons from textured boxes, ray-cast exactly for any lens.

The camera stands inside a large box; smaller boxes stand on its floor. Every face carries a picture
of the atlas, so straight lines of a picture are straight in space, faces meet at right angles, and
the field of view is true. Boxes are turned about the vertical only.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from learned.slf.atlas import Atlas, sample
from learned.slf.optics import Optics
from learned.slf.planes import clipped
from learned.slf.strokes import Segments3D, ragged_arange

FACES = 6
_FAR = 1e6
_TINY = 1e-9
_SURFACE = 2e-3
_MOST_SEGMENTS = 60


@dataclass(frozen=True)
class Boxes:
    """A scene of boxes per sample; box 0 is seen from within, the others from without.

    World axes: x right, y down, z forward, the floor at largest y; lengths in metres. Face 2a is
    the one at −axis a, face 2a + 1 the one at +axis a.

    Attributes:
        centre: Centres of the boxes.
        half: Half sizes; zero for a box that is not there.
        yaw: Turn about the vertical in radians; 0 for box 0.
        picture: Picture on each face.
        tile: Width and height of one picture on the face, in metres; pictures repeat mirrored.
        offset: Where the first picture begins, as a share of the picture.
        shade: Brightness of each face.
        rotation: World directions of the camera's axes (columns).
        position: Where the camera stands.
    """

    centre: Float[Tensor, "b k 3"]
    half: Float[Tensor, "b k 3"]
    yaw: Float[Tensor, "b k"]
    picture: Int[Tensor, "b k 6"]
    tile: Float[Tensor, "b k 6 2"]
    offset: Float[Tensor, "b k 6 2"]
    shade: Float[Tensor, "b k 6"]
    rotation: Float[Tensor, "b 3 3"]
    position: Float[Tensor, "b 3"]

    def to(self, device: torch.device | str) -> "Boxes":
        """The same scenes on another device."""
        return Boxes(**{name: value.to(device) for name, value in vars(self).items()})


@torch.no_grad()
def render_boxes(
    atlas: Atlas, boxes: Boxes, lens: Optics, rays: Float[Tensor, "b 3 h w"]
) -> Float[Tensor, "b 3 h w"]:
    """What each ray sees, in [0, 255]."""
    shape = rays.shape
    world = torch.bmm(boxes.rotation, rays.flatten(2)).view(shape)
    depth, face, cosine, u, v = _cast_room(boxes, world)
    owner = torch.zeros_like(face)
    for k in range(1, boxes.half.shape[1]):
        rows = torch.nonzero(boxes.half[:, k, 0] > 0)[:, 0]
        if len(rows):
            _cast_box(boxes, world, k, rows, (depth, face, owner, cosine, u, v))
    index = face.add_(owner, alpha=FACES)
    index += (torch.arange(shape[0], device=rays.device) * _slots(boxes))[:, None, None]
    index = index.view(-1)
    picture = boxes.picture.view(-1).index_select(0, index)
    per_metre, start, shade, texels = (
        table.view(-1, table.shape[-1]).T.contiguous() for table in _face_tables(atlas, boxes, lens)
    )
    # texels along the picture from its first repeat, folded back at every second border
    column = _mirrored(u.view(-1), index, per_metre[0], start[0], texels[1])
    row = _mirrored(v.view(-1), index, per_metre[1], start[1], texels[2])
    footprint = depth.view(-1) * texels[0].index_select(0, index)
    footprint *= cosine.view(-1).clamp_min_(0.05).rsqrt_()
    level = footprint.log2_().round_().clamp_(0, 3).long()
    colour = sample(atlas, picture, column, row, level)
    colour *= shade[0].index_select(0, index)
    return colour.clamp_(0, 255).view(3, shape[0], *shape[2:]).movedim(0, 1)


def _face_tables(atlas: Atlas, boxes: Boxes, lens: Optics) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Per face: texels a metre and at its corner, shade, and (texels a pixel and metre, size)."""
    extent = atlas.extent[boxes.picture, 0].to(boxes.tile.dtype)
    per_metre = extent / boxes.tile.clamp_min(1e-6)
    pixel = 2.0 / (lens.vector[:, 0] * lens.size)
    footprint = per_metre[..., 1:] * pixel[:, None, None, None]
    texels = torch.cat([footprint, extent], dim=-1)
    return per_metre, boxes.offset * extent, boxes.shade[..., None], texels


def _mirrored(
    place: Tensor, index: Tensor, per_metre: Tensor, start: Tensor, size: Tensor
) -> Tensor:
    """Texel of a place on a face, pictures repeating mirrored."""
    size = size.index_select(0, index)
    texel = place * per_metre.index_select(0, index) + start.index_select(0, index)
    folded = texel.remainder_(2 * size).sub_(size).abs_()
    return size.sub_(folded).sub_(0.5)


def box_segments(atlas: Atlas, boxes: Boxes) -> Segments3D:
    """Edges of all boxes and lines of all pictures on them, in camera coordinates."""
    edges, lines = edge_segments(boxes), pattern_segments(atlas, boxes)
    row = torch.cat([edges.row, lines.row])
    order = torch.argsort(row, stable=True)
    start = torch.cat([edges.start, lines.start])[order]
    return Segments3D(start, torch.cat([edges.end, lines.end])[order], row[order])


def edge_segments(boxes: Boxes, *, with_room: bool = True) -> Segments3D:
    """Twelve edges of every box, in camera coordinates.

    Args:
        boxes: The scenes.
        with_room: Whether box 0 counts; it does not where it is only a ground.
    """
    ends, row, box = _edge_list(boxes)
    if not with_room:
        ends, row, box = ends[box > 0], row[box > 0], box[box > 0]
    return _seen_from_camera(boxes, ends, row, box)


def pattern_segments(atlas: Atlas, boxes: Boxes) -> Segments3D:
    """Lines of all pictures on all faces, in camera coordinates."""
    return _seen_from_camera(boxes, *_picture_list(atlas, boxes))


def _seen_from_camera(boxes: Boxes, ends: Tensor, row: Tensor, box: Tensor) -> Segments3D:
    cosine, sine = torch.cos(boxes.yaw[row, box]), torch.sin(boxes.yaw[row, box])
    world = _turned(ends.movedim(2, 0), cosine[:, None], sine[:, None])
    world = torch.stack(world, dim=2) + boxes.centre[row, box][:, None]
    camera = torch.einsum("nji,nej->nei", boxes.rotation[row], world - boxes.position[row][:, None])
    return Segments3D(camera[:, 0], camera[:, 1], row)


def first_hits(
    boxes: Boxes, rays: Float[Tensor, "n 3"], row: Int[Tensor, " n"]
) -> tuple[Float[Tensor, " n"], Int[Tensor, " n"], Int[Tensor, " n"]]:
    """What single rays meet first.

    Args:
        boxes: The scenes.
        rays: Unit directions in camera coordinates.
        row: Scene of each ray.

    Returns:
        depth: Distance in metres.
        owner: Box that is met.
        face: Its face.
    """
    world = torch.einsum("nij,nj->ni", boxes.rotation[row], rays)
    eye = boxes.position[row] - boxes.centre[row, 0]
    distance = (boxes.half[row, 0].copysign(world) - eye) * _safe_inverse(world)
    depth, axis = distance.min(dim=1)
    face = 2 * axis + (world.gather(1, axis[:, None])[:, 0] > 0)
    owner = torch.zeros_like(face)
    for k in range(1, boxes.half.shape[1]):
        enter, leave, near, _, local = _slabs(boxes, world.movedim(1, 0), k, row)
        hit = torch.nonzero((enter < leave) & (enter > 0) & (enter < depth))[:, 0]
        if len(hit):
            direction = torch.stack(local)[near[hit], hit]
            depth[hit], owner[hit] = enter[hit], k
            face[hit] = 2 * near[hit] + (direction < 0)
    return depth, owner, face


def box_visibility(
    boxes: Boxes, points: Float[Tensor, "n 3"], row: Int[Tensor, " n"]
) -> Bool[Tensor, " n"]:
    """True where no box stands between the camera and the point."""
    seen = torch.ones(len(points), dtype=torch.bool, device=points.device)
    world = torch.einsum("nij,nj->ni", boxes.rotation[row], points)
    for k in range(1, boxes.half.shape[1]):
        half = boxes.half[row, k]
        enter, leave, *_ = _slabs(boxes, world.movedim(1, 0), k, row)
        hidden = (enter < leave) & (enter > 0) & (enter < 1.0 - _SURFACE) & (half[:, 0] > 0)
        seen &= ~hidden
    return seen


def _slots(boxes: Boxes) -> int:
    return boxes.half.shape[1] * FACES


def _turned(xyz: tuple[Tensor, ...] | Tensor, cosine: Tensor, sine: Tensor) -> tuple[Tensor, ...]:
    """Turn vectors about the vertical: from a box's axes to the world's."""
    x, y, z = xyz[0], xyz[1], xyz[2]
    return cosine * x + sine * z, y, -sine * x + cosine * z


def _safe_inverse(x: Tensor) -> Tensor:
    return 1.0 / torch.where(x.abs() < _TINY, torch.full_like(x, _TINY), x)


def _cast_room(boxes: Boxes, world: Tensor) -> tuple[Tensor, ...]:
    """Distance, face, cosine of incidence and place on the face where rays leave the room."""
    view = (-1, 3, 1, 1)
    eye = (boxes.position - boxes.centre[:, 0]).view(view)
    half = boxes.half[:, 0].view(view)
    distance = (half.copysign(world) - eye) * _safe_inverse(world)
    depth = torch.minimum(torch.minimum(distance[:, 0], distance[:, 1]), distance[:, 2])
    is_x, is_y = ((distance[:, a] == depth).to(depth.dtype) for a in (0, 1))
    is_y = is_y * (1.0 - is_x)
    # chosen by arithmetic: selecting with masks is several times slower on a CPU
    direction = (
        world[:, 2] + is_x * (world[:, 0] - world[:, 2]) + is_y * (world[:, 1] - world[:, 2])
    )
    face = (4.0 - 4.0 * is_x - 2.0 * is_y + (direction > 0)).long()
    hit = torch.addcmul(eye + half, depth[:, None], world)
    u = torch.lerp(hit[:, 0], hit[:, 2], is_x)
    v = torch.lerp(hit[:, 1], hit[:, 2], is_y)
    return depth, face, direction.abs_(), u, v


def _cast_box(
    boxes: Boxes, world: Tensor, k: int, rows: Tensor, buffers: tuple[Tensor, ...]
) -> None:
    """Where rays of some samples meet box k before anything else, write it into the buffers."""
    depth, face, owner, cosine, u, v = buffers
    enter, leave, near, eye, local = _slabs(boxes, world[rows].movedim(1, 0), k, rows, image=True)
    hit = (enter < leave) & (enter > 0) & (enter < depth[rows])
    at = torch.nonzero(hit)
    if len(at) == 0:
        return
    sample_row = rows[at[:, 0]]
    where = (sample_row, at[:, 1], at[:, 2])
    t = enter[hit]
    axis = near[hit]
    direction = torch.stack([x[hit] for x in local])
    start = torch.stack([x.expand_as(enter)[hit] for x in eye])
    place = start + t * direction
    half = boxes.half[sample_row, k]
    facing = direction.gather(0, axis[None])[0]
    depth[where] = t
    face[where] = 2 * axis + (facing < 0)
    owner[where] = k
    cosine[where] = facing.abs()
    u[where], v[where] = _face_place(
        place[0], place[1], place[2], half[:, 0], half[:, 1], half[:, 2], axis
    )


def _slabs(
    boxes: Boxes, world: Tensor, k: int, rows: Tensor, *, image: bool = False
) -> tuple[Tensor, Tensor, Tensor, tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Entry and exit distance of rays and box k, the axis of entry, eye and rays in its axes."""
    shape = (-1, 1, 1) if image else (-1,)
    cosine = torch.cos(boxes.yaw[rows, k]).view(shape)
    sine = torch.sin(boxes.yaw[rows, k]).view(shape)
    offset = (boxes.position[rows] - boxes.centre[rows, k]).movedim(1, 0).view(3, *shape)
    eye = _turned(offset, cosine, -sine)
    local = _turned(world, cosine, -sine)
    enter = near = leave = None
    for axis in range(3):
        half = boxes.half[rows, k, axis].view(shape)
        inverse = _safe_inverse(local[axis])
        middle, width = -eye[axis] * inverse, half * inverse.abs()
        first, last = middle - width, middle + width
        if enter is None or leave is None or near is None:
            enter, leave, near = first, last, torch.zeros_like(first, dtype=torch.long)
        else:
            near = torch.where(first > enter, axis, near)
            enter, leave = torch.maximum(enter, first), torch.minimum(leave, last)
    assert enter is not None
    assert leave is not None
    assert near is not None
    return enter, leave, near, eye, local


def _face_place(
    x: Tensor, y: Tensor, z: Tensor, hx: Tensor, hy: Tensor, hz: Tensor, axis: Tensor
) -> tuple[Tensor, Tensor]:
    """Coordinates on a face from its corner in metres: (z, y), (x, z) or (x, y) by the axis."""
    u = torch.where(axis == 0, z + hz, x + hx)
    v = torch.where(axis == 1, z + hz, y + hy)
    return u, v


def _edge_list(boxes: Boxes) -> tuple[Tensor, Tensor, Tensor]:
    """Twelve edges a box, in its own axes, with sample and box."""
    corners = torch.tensor(
        [[(-1.0) ** (i >> a) for a in range(3)] for i in range(8)], device=boxes.half.device
    )
    pairs = [(i, i | 1 << a) for i in range(8) for a in range(3) if not i >> a & 1]
    unit = torch.stack([corners[[i for i, _ in pairs]], corners[[j for _, j in pairs]]], dim=1)
    row, box = torch.nonzero(boxes.half[..., 0] > 0, as_tuple=True)
    ends = unit[None] * boxes.half[row, box][:, None, None]
    count = len(pairs)
    return ends.flatten(0, 1), row.repeat_interleave(count), box.repeat_interleave(count)


def _picture_list(atlas: Atlas, boxes: Boxes) -> tuple[Tensor, Tensor, Tensor]:
    """The lines of every repeat of every picture on every face, in the boxes' own axes."""
    n_boxes = boxes.half.shape[1]
    there = (boxes.half[..., :1] > 0).expand(-1, -1, FACES).reshape(-1)
    face_id = torch.nonzero(there)[:, 0]
    face, half = face_id % FACES, boxes.half.reshape(-1, 3)[face_id // FACES]
    axis = face // 2
    size_u = 2 * torch.where(axis == 0, half[:, 2], half[:, 0])
    size_v = 2 * torch.where(axis == 1, half[:, 2], half[:, 1])
    size = torch.stack([size_u, size_v], 1)
    tile, offset = boxes.tile.reshape(-1, 2)[face_id], boxes.offset.reshape(-1, 2)[face_id]
    first = torch.floor(offset)
    repeats = (torch.floor(size / tile + offset - 1e-4) - first + 1).long()
    which, place = ragged_arange(repeats[:, 0] * repeats[:, 1])
    cell = torch.stack([place % repeats[which, 0], place // repeats[which, 0]], 1) + first[which]
    picture = boxes.picture.reshape(-1)[face_id][which]
    # a picture's segments are stored longest first, so the limit drops the short ones
    counts = (atlas.first[picture + 1] - atlas.first[picture]).clamp_max(_MOST_SEGMENTS)
    owner, number = ragged_arange(counts)
    segment = atlas.segments[atlas.first[picture][owner] + number].view(-1, 2, 2)
    extent = atlas.extent[picture, 0].to(segment.dtype)[owner]
    share = (segment + 0.5) / extent[:, None]
    cells, of_face = cell[owner], which[owner]
    share = torch.where((cells.remainder(2) == 1)[:, None], 1.0 - share, share) + cells[:, None]
    flat = (share - offset[of_face][:, None]) * tile[of_face][:, None]
    middle = size[of_face] / 2
    flat, keep = clipped(flat - middle[:, None], middle)
    flat, of_face = flat[keep], of_face[keep]
    ends = _on_face(flat, face[of_face], half[of_face])
    box_id = face_id[of_face] // FACES
    return ends, box_id // n_boxes, box_id % n_boxes


def _on_face(flat: Tensor, face: Tensor, half: Tensor) -> Tensor:
    """Points of a face, given from its middle, in the axes of its box."""
    axis = face // 2
    side = (2.0 * (face % 2) - 1.0)[:, None]
    wall = [(half[:, a, None] * side).expand(-1, 2) for a in range(3)]
    first, second = flat[..., 0], flat[..., 1]
    is_x, is_y, is_z = ((axis == a)[:, None] for a in range(3))
    x = torch.where(is_x, wall[0], first)
    y = torch.where(is_y, wall[1], second)
    z = torch.where(is_z, wall[2], torch.where(is_x, first, second))
    return torch.stack([x, y, z], dim=2)

"""Bent lines: straight pieces in space, through a lens, onto a line map.

All pieces of a batch lie in one flat list, and every step is a tensor operation over all of their
sample points at once.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from learned.slf.optics import Optics, project

CLIPPED_LENGTH = 255.0
_HALF_WIDTH_PX = 1.0
_COARSE_NODES = 25
_STEP_PX = 0.5
_MOST_STEPS = 1600

Visibility = Callable[[Float[Tensor, "n 3"], Int[Tensor, " n"]], Bool[Tensor, " n"]]
"""Which points in camera coordinates of which sample are not hidden by something nearer."""


@dataclass(frozen=True)
class Segments3D:
    """Straight pieces in camera coordinates.

    Attributes:
        start: One end, shape (n, 3).
        end: The other end, shape (n, 3).
        row: Sample of the batch that each belongs to, not falling.
    """

    start: Float[Tensor, "n 3"]
    end: Float[Tensor, "n 3"]
    row: Int[Tensor, " n"]

    def __len__(self) -> int:
        """Number of pieces."""
        return self.start.shape[0]


@dataclass(frozen=True)
class Strokes:
    """Visible runs of bent lines as dense points, one run after the other.

    Attributes:
        points: Pixels (u, v), half a pixel apart or less.
        tangent: Unit directions of the curves at the points.
        run: Number of the run of each point, rising from 0.
        length: Bent length of each run in pixels, shape (runs,).
        row: Sample of each run, shape (runs,).
        segment: Piece that each run belongs to, shape (runs,).
    """

    points: Float[Tensor, "n 2"]
    tangent: Float[Tensor, "n 2"]
    run: Int[Tensor, " n"]
    length: Float[Tensor, " runs"]
    row: Int[Tensor, " runs"]
    segment: Int[Tensor, " runs"]


def bent_strokes(
    lens: Optics,
    segments: Segments3D,
    *,
    visibility: Visibility | None = None,
    shortest_px: float = 12.0,
) -> Strokes:
    """Image straight pieces as visible runs.

    Args:
        lens: Lenses of the batch.
        segments: Pieces in camera coordinates.
        visibility: What hides points, if anything does.
        shortest_px: Runs shorter than this are dropped.
    """
    share, which = _dense_parameters(lens, segments)
    row = segments.row[which]
    points, valid = project(lens, _along(segments, share, which), row)
    if visibility is not None:
        valid = valid & visibility(_along(segments, share, which), row)
    points, which = points[valid], which[valid]
    index = torch.nonzero(valid)[:, 0]
    step = torch.zeros_like(points)
    step[:-1] = points[1:] - points[:-1]
    # a run ends where the piece changes or where a hidden or unseen point lies between
    continues = torch.zeros(len(points), dtype=torch.bool, device=points.device)
    continues[:-1] = (which[1:] == which[:-1]) & (index[1:] == index[:-1] + 1)
    starts = torch.ones_like(continues)
    starts[1:] = ~continues[:-1]
    run = torch.cumsum(starts, 0) - 1
    distance = torch.linalg.vector_norm(step, dim=1) * continues
    n_runs = int(run[-1]) + 1 if len(run) else 0
    length = torch.zeros(n_runs, dtype=points.dtype, device=points.device)
    length.index_add_(0, run, distance)
    tangent = step / torch.linalg.vector_norm(step, dim=1, keepdim=True).clamp_min(1e-9)
    last = ~continues
    tangent[1:][last[1:]] = tangent[:-1][last[1:]]
    first = torch.nonzero(starts)[:, 0]
    segment = which[first]
    return _kept(points, tangent, run, length, segments.row[segment], segment, shortest_px)


def draw_line_map(strokes: Strokes, *, batch: int, size: int) -> Float[Tensor, "b 1 h w"]:
    """Draw runs three pixels wide with the value min(length, 255) / 255.

    A pixel belongs to a run where its centre is at most one pixel from it; where runs cross, the
    longer one wins.

    Args:
        strokes: Runs in pixels of the frame.
        batch: Number of samples.
        size: Width and height of the frame.
    """
    device, dtype = strokes.points.device, strokes.points.dtype
    canvas = torch.zeros(batch * size * size, dtype=dtype, device=device)
    if len(strokes.points) == 0:
        return canvas.view(batch, 1, size, size)
    offset = torch.arange(-1, 2, device=device, dtype=dtype)
    grid = torch.stack(torch.meshgrid(offset, offset, indexing="ij"), -1).view(1, 9, 2)
    nearest = torch.round(strokes.points)[:, None] + grid
    away = nearest - strokes.points[:, None]
    tangent = strokes.tangent[:, None]
    across = away[..., 0] * tangent[..., 1] - away[..., 1] * tangent[..., 0]
    along = (away * tangent).sum(-1)
    near = (across.abs() <= _HALF_WIDTH_PX) & (along.abs() <= _STEP_PX)
    near |= (away * away).sum(-1) <= _HALF_WIDTH_PX**2
    near &= ((nearest >= 0) & (nearest <= size - 1)).all(-1)
    value = strokes.length.clamp_max(CLIPPED_LENGTH) / CLIPPED_LENGTH
    cell = nearest[..., 1].long() * size + nearest[..., 0].long()
    cell += (strokes.row[strokes.run] * (size * size))[:, None]
    levels = value[strokes.run][:, None].expand(-1, 9)
    canvas.scatter_reduce_(0, cell[near], levels[near], "amax")
    return canvas.view(batch, 1, size, size)


def ragged_arange(counts: Int[Tensor, " n"]) -> tuple[Int[Tensor, " m"], Int[Tensor, " m"]]:
    """Owner and place within the owner for `counts` items each, one owner after the other."""
    owner = torch.repeat_interleave(torch.arange(len(counts), device=counts.device), counts)
    before = torch.cumsum(counts, 0) - counts
    return owner, torch.arange(len(owner), device=counts.device) - before[owner]


def _along(segments: Segments3D, share: Tensor, which: Tensor) -> Tensor:
    start, end = segments.start[which], segments.end[which]
    return start + share[:, None] * (end - start)


def _dense_parameters(lens: Optics, segments: Segments3D) -> tuple[Tensor, Tensor]:
    """Places on the pieces, at most half a pixel apart in the image, and their piece."""
    n, device = len(segments), segments.start.device
    share = _even_angles(segments)
    which = torch.arange(n, device=device).repeat_interleave(_COARSE_NODES)
    pixels, _ = project(lens, _along(segments, share.reshape(-1), which), segments.row[which])
    pixels = pixels.view(n, _COARSE_NODES, 2)
    middle = (lens.size - 1) / 2
    outside = ((pixels - middle).abs() - lens.size / 2).amax(-1)
    distance = torch.linalg.vector_norm(pixels[:, 1:] - pixels[:, :-1], dim=-1)
    # an interval whose ends are farther out than it is long cannot cut the frame
    needed = torch.minimum(outside[:, 1:], outside[:, :-1]) <= distance + 2.0
    counts = torch.ceil(distance / (0.9 * _STEP_PX)).clamp(1, _MOST_STEPS).long() * needed
    interval, place = ragged_arange(counts.view(-1))
    owner = interval // (_COARSE_NODES - 1)
    low = share[:, :-1].reshape(-1)[interval]
    high = share[:, 1:].reshape(-1)[interval]
    fraction = place.to(share.dtype) / counts.view(-1)[interval]
    return low + (high - low) * fraction, owner


def _even_angles(segments: Segments3D) -> Tensor:
    """Parameters of nodes at equal angles along each piece, as seen from the camera."""
    a, b = segments.start, segments.end
    length_a = torch.linalg.vector_norm(a, dim=1, keepdim=True).clamp_min(1e-9)
    length_b = torch.linalg.vector_norm(b, dim=1, keepdim=True).clamp_min(1e-9)
    unit_a, unit_b = a / length_a, b / length_b
    half = torch.linalg.vector_norm(unit_a - unit_b, dim=1, keepdim=True) / 2
    angle = 2 * torch.asin(half.clamp(1e-5, 1 - 1e-6))
    s = torch.linspace(0.0, 1.0, _COARSE_NODES, dtype=a.dtype, device=a.device)
    # slerp weights of the unit ends, turned into the parameter on the chord between a and b
    weight_a = torch.sin((1 - s) * angle) / length_a
    weight_b = torch.sin(s * angle) / length_b
    return weight_b / (weight_a + weight_b)


def _kept(
    points: Tensor,
    tangent: Tensor,
    run: Tensor,
    length: Tensor,
    row: Tensor,
    segment: Tensor,
    shortest: float,
) -> Strokes:
    """Drop short runs and number the others anew."""
    keep = length >= shortest
    number = torch.cumsum(keep, 0) - 1
    stays = keep[run]
    return Strokes(
        points[stays], tangent[stays], number[run[stays]], length[keep], row[keep], segment[keep]
    )

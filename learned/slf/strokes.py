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
_COARSE_NODES = 13
_STEP_PX = 1.0
_MOST_STEPS = 1600
_LARGEST_STRETCH = 1.6

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
        points: Pixels (u, v), at most one apart.
        tangent: Unit directions of the curves at the points.
        share: Place of each point on its piece, 0 at its start and 1 at its end.
        run: Number of the run of each point, rising from 0.
        length: Bent length of each run in pixels, shape (runs,).
        row: Sample of each run, shape (runs,).
        segment: Piece that each run belongs to, shape (runs,).
    """

    points: Float[Tensor, "n 2"]
    tangent: Float[Tensor, "n 2"]
    share: Float[Tensor, " n"]
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
    segments, original = _worth_imaging(lens, segments, shortest_px)
    share, which = _dense_parameters(lens, segments)
    place = _along(segments, share, which)
    row = segments.row.index_select(0, which)
    points, valid = project(lens, place, row)
    index = torch.nonzero(valid)[:, 0]
    if visibility is not None:
        seen = visibility(place.index_select(0, index), row.index_select(0, index))
        index = index[seen]
    points, which = points.index_select(0, index), which.index_select(0, index)
    # a run ends where the piece changes or where a hidden or unseen point lies between
    continues = _follows(index) & _same(which)
    run, first, step, length = _numbered(points, continues)
    tangent = step / torch.hypot(step[:, 0], step[:, 1]).clamp_min(1e-9)[:, None]
    # the last point of a run has the direction of the one before
    tangent[1:] += tangent[:-1] * (~continues[1:])[:, None]
    segment = which.index_select(0, first)
    rows = segments.row.index_select(0, segment)
    share = share.index_select(0, index)
    runs = Strokes(points, tangent, share, run, length, rows, original[segment])
    return filtered_strokes(runs, length >= shortest_px)


def cut_strokes(strokes: Strokes, keep: Bool[Tensor, " n"], *, shortest_px: float) -> Strokes:
    """Runs without some of their points; what is left of a run is one run or several.

    Args:
        strokes: The runs.
        keep: False for points that go.
        shortest_px: Runs shorter than this are dropped.
    """
    kept = torch.nonzero(keep)[:, 0]
    before = strokes.run.index_select(0, kept)
    points, tangent, share = (
        x.index_select(0, kept) for x in (strokes.points, strokes.tangent, strokes.share)
    )
    run, first, _, length = _numbered(points, _follows(kept) & _same(before))
    old = before.index_select(0, first)
    runs = Strokes(points, tangent, share, run, length, strokes.row[old], strokes.segment[old])
    return filtered_strokes(runs, length >= shortest_px)


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
    value = strokes.length.clamp_max(CLIPPED_LENGTH) / CLIPPED_LENGTH
    value = value.index_select(0, strokes.run)
    first = strokes.row.index_select(0, strokes.run) * (size * size)
    u, v = strokes.points.T.contiguous()
    du, dv = strokes.tangent.T.contiguous()
    column, row = torch.round(u), torch.round(v)
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            x, y = column + i, row + j
            a, b = x - u, y - v
            near = ((a * dv - b * du).abs() <= _HALF_WIDTH_PX) & ((a * du + b * dv).abs() <= 0.5)
            near |= a * a + b * b <= _HALF_WIDTH_PX**2
            near &= (torch.minimum(x, y) >= 0) & (torch.maximum(x, y) <= size - 1)
            cell = first + (y * size + x).clamp(0, size * size - 1).long()
            canvas.scatter_reduce_(0, cell, value * near, "amax")
    return canvas.view(batch, 1, size, size)


def ragged_arange(counts: Int[Tensor, " n"]) -> tuple[Int[Tensor, " m"], Int[Tensor, " m"]]:
    """Owner and place within the owner for `counts` items each, one owner after the other."""
    owner = torch.repeat_interleave(torch.arange(len(counts), device=counts.device), counts)
    before = torch.cumsum(counts, 0) - counts
    place = torch.arange(len(owner), device=counts.device)
    return owner, place.sub_(before.index_select(0, owner))


def _same(values: Tensor) -> Tensor:
    """True where the next value is the same."""
    same = torch.zeros(len(values), dtype=torch.bool, device=values.device)
    same[:-1] = values[1:] == values[:-1]
    return same


def _follows(index: Tensor) -> Tensor:
    """True where the next number is one more."""
    return _same(index - torch.arange(len(index), device=index.device))


def _numbered(points: Tensor, continues: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Run of each point, first point of each run, step to the next point, length of each run."""
    starts = torch.ones_like(continues)
    starts[1:] = ~continues[:-1]
    run = torch.cumsum(starts, 0) - 1
    step = torch.zeros_like(points)
    step[:-1] = (points[1:] - points[:-1]) * continues[:-1, None]
    first = torch.nonzero(starts)[:, 0]
    length = torch.zeros(len(first), dtype=points.dtype, device=points.device)
    length.index_add_(0, run, torch.hypot(step[:, 0], step[:, 1]))
    return run, first, step, length


def _worth_imaging(
    lens: Optics, segments: Segments3D, shortest_px: float
) -> tuple[Segments3D, Tensor]:
    """Pieces that may give a run of the least length, and their numbers."""
    unit_a = segments.start / _norm(segments.start).clamp_min(1e-9)
    unit_b = segments.end / _norm(segments.end).clamp_min(1e-9)
    angle = 2 * torch.asin((_norm(unit_a - unit_b)[:, 0] / 2).clamp_max(1.0))
    vector, theta_max = lens.vector[segments.row], lens.theta_max[segments.row]
    scale = vector[:, :5].abs().sum(1) * (lens.size / 2)
    long_enough = angle * torch.minimum(scale, vector[:, 0] * lens.size / 2 * _LARGEST_STRETCH)
    nearest_axis = torch.acos(torch.maximum(unit_a[:, 2], unit_b[:, 2]).clamp(-1, 1))
    keep = (long_enough >= shortest_px) & (nearest_axis - angle <= theta_max)
    kept = torch.nonzero(keep)[:, 0]
    parts = (x.index_select(0, kept) for x in (segments.start, segments.end, segments.row))
    return Segments3D(*parts), kept


def _norm(x: Tensor) -> Tensor:
    return torch.linalg.vector_norm(x, dim=1, keepdim=True)


def _along(segments: Segments3D, share: Tensor, which: Tensor) -> Tensor:
    start, end = segments.start.index_select(0, which), segments.end.index_select(0, which)
    return torch.lerp(start, end, share[:, None])


def _dense_parameters(lens: Optics, segments: Segments3D) -> tuple[Tensor, Tensor]:
    """Places on the pieces, at most a pixel apart in the image, and their piece."""
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
    low = share[:, :-1].reshape(-1).index_select(0, interval)
    high = share[:, 1:].reshape(-1).index_select(0, interval)
    fraction = place.to(share.dtype) / counts.view(-1).index_select(0, interval)
    return torch.lerp(low, high, fraction), owner


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


def filtered_strokes(strokes: Strokes, keep: Bool[Tensor, " runs"]) -> Strokes:
    """Some of the runs, numbered anew."""
    number = torch.cumsum(keep, 0) - 1
    stays = torch.nonzero(keep.index_select(0, strokes.run))[:, 0]
    points, tangent, share, run = (
        x.index_select(0, stays)
        for x in (strokes.points, strokes.tangent, strokes.share, strokes.run)
    )
    ends = (strokes.length[keep], strokes.row[keep], strokes.segment[keep])
    return Strokes(points, tangent, share, number.index_select(0, run), *ends)

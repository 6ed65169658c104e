"""Flat boards held before the lens: calibration targets, posters, signs.

A board hides what is behind it, in boxes as in panoramas. Its lines are straight in space like all
others, but they cluster where it is held, and what the rest of the scene tells is at the rim.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from torch import Tensor

from learned.slf.atlas import Atlas, sample
from learned.slf.optics import Optics
from learned.slf.strokes import Segments3D, Visibility, ragged_arange

_HALF_ANGLE = (np.radians(9.0), np.radians(50.0))
_OFF_AXIS = np.radians(28.0)
_FARTHEST = np.radians(65.0)
_TILT, _ROLL = np.radians(22.0), np.radians(12.0)
_STEEPEST = np.radians(55.0)
_ANYHOW = 0.25
_PRINT = 0.7
_SHADE = (0.35, 1.1)
_TINY = 1e-6


@dataclass(frozen=True)
class Boards:
    """One board before each of some samples; the distance to its middle is the unit of length.

    Attributes:
        picture: Picture on the board.
        pose: Its axes to the right and down and its middle (columns), in camera coordinates.
        half: Half width and half height.
        shade: Brightness.
    """

    picture: Int[Tensor, " b"]
    pose: Float[Tensor, "b 3 3"]
    half: Float[Tensor, "b 2"]
    shade: Float[Tensor, " b"]

    def __len__(self) -> int:
        """Number of boards."""
        return len(self.picture)

    def __getitem__(self, rows: Tensor) -> Boards:
        """Some of the boards."""
        return Boards(**{name: value[rows] for name, value in vars(self).items()})


@dataclass(frozen=True)
class Held:
    """Which of some samples have a board before the lens.

    Attributes:
        boards: The boards, or None where no sample has one.
        number: Board of each sample, rising, or -1.
    """

    boards: Boards | None
    number: Int[Tensor, " b"]

    @property
    def rows(self) -> Int[Tensor, " n"]:
        """The samples that have one, in the order of the boards."""
        return torch.nonzero(self.number >= 0)[:, 0]

    def before(self, rows: Int[Tensor, " n"]) -> Held:
        """Those of some of the samples."""
        number = self.number[rows]
        there = number >= 0
        if self.boards is None or not there.any():
            return Held(None, torch.full_like(number, -1))
        again = torch.where(there, torch.cumsum(there, 0) - 1, -1)
        return Held(self.boards[number[there]], again)

    def seen(
        self, points: Float[Tensor, "n 3"], row: Int[Tensor, " n"], *, scene: Visibility | None
    ) -> Bool[Tensor, " n"]:
        """Which points of the scene neither it nor a board hides."""
        whole = torch.ones(len(points), dtype=torch.bool, device=points.device)
        visible = whole if scene is None else scene(points, row)
        if self.boards is not None:
            number = self.number[row]
            at = torch.nonzero(number >= 0)[:, 0]
            visible[at] &= board_visibility(self.boards, points[at], number[at])
        return visible

    def lay(self, atlas: Atlas, lens: Optics, rays: Tensor, picture: Tensor) -> None:
        """Draw the boards over the samples' pictures in [0, 255], in place."""
        if self.boards is not None:
            rows = self.rows
            some = picture[rows]
            lay_boards(atlas, self.boards, lens[rows], rays[rows], some)
            picture[rows] = some


def draw_boards(
    rng: np.random.Generator,
    atlas: Atlas,
    targets: Int[Tensor, " p"],
    photographs: Int[Tensor, " q"],
    n: int,
) -> Boards:
    """Draw boards: mostly near the axis, facing the lens and upright.

    Args:
        rng: Source of randomness.
        atlas: Where the pictures are.
        targets: Numbers of the drawn boards to choose from.
        photographs: Numbers of the photographs that are boards, too; may be empty.
        n: Number of boards.
    """
    drawn = targets.cpu().numpy()[rng.integers(0, len(targets), n)]
    if len(photographs):
        printed = photographs.cpu().numpy()[rng.integers(0, len(photographs), n)]
        drawn = np.where(rng.random(n) < _PRINT, drawn, printed)
    extent = atlas.extent[:, 0].cpu().numpy()[drawn].astype(float)
    longer = np.tan(np.exp(rng.uniform(np.log(_HALF_ANGLE[0]), np.log(_HALF_ANGLE[1]), n)))
    half = extent / extent.max(axis=1, keepdims=True) * longer[:, None]
    pose = _poses(rng, n)
    device = atlas.texels.device
    return Boards(
        picture=torch.as_tensor(drawn, device=device),
        pose=torch.as_tensor(pose, dtype=torch.float32, device=device),
        half=torch.as_tensor(half, dtype=torch.float32, device=device),
        shade=torch.as_tensor(rng.uniform(*_SHADE, n), dtype=torch.float32, device=device),
    )


def _poses(rng: np.random.Generator, n: int) -> Float[ndarray, "n 3 3"]:
    """Where boards are held and how: the columns of `Boards.pose`."""
    theta = np.minimum(np.abs(rng.normal(0, _OFF_AXIS, n)), _FARTHEST)
    phi = rng.uniform(-np.pi, np.pi, n)
    middle = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], 1)
    roll = np.where(rng.random(n) < _ANYHOW, rng.uniform(-np.pi, np.pi, n), rng.normal(0, _ROLL, n))
    upright = np.stack([-np.sin(roll), np.cos(roll), np.zeros(n)], 1)
    right, down = _across(upright, middle)
    # turned away from the ray to its middle about its own axes
    tilt = np.tan(np.clip(rng.normal(0, _TILT, (n, 2)), -_STEEPEST, _STEEPEST))
    away = middle + tilt[:, :1] * right + tilt[:, 1:] * down
    return np.stack([*_across(down, away), middle], axis=2)


def _across(down: Float[ndarray, "n 3"], away: Float[ndarray, "n 3"]) -> tuple[ndarray, ndarray]:
    """Unit axes to the right and down at right angles to `away`, down as near as can be."""
    right = np.cross(down, away)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    away = away / np.linalg.norm(away, axis=1, keepdims=True)
    return right, np.cross(away, right)


@torch.no_grad()
def lay_boards(
    atlas: Atlas,
    boards: Boards,
    lens: Optics,
    rays: Float[Tensor, "b 3 h w"],
    picture: Float[Tensor, "b 3 h w"],
) -> None:
    """Draw boards over pictures in [0, 255], in place, their borders smooth.

    Args:
        atlas: Where the pictures on the boards are.
        boards: One for each of the pictures.
        lens: Lenses of the pictures.
        rays: Unit directions of the pixels.
        picture: What is changed.
    """
    x, y, nearness = _on_board(boards.pose, rays.flatten(2))
    pixel = 2.0 / (lens.vector[:, 0] * rays.shape[-1])
    footprint = pixel[:, None] / nearness.clamp_min(_TINY)
    inwards = torch.minimum(boards.half[:, :1] - x.abs(), boards.half[:, 1:] - y.abs())
    share = (inwards / footprint + 0.5).clamp_(0, 1) * (nearness > _TINY)
    row, place = torch.nonzero(share > 0, as_tuple=True)
    chosen = boards.picture[row]
    extent = atlas.extent[chosen, 0].to(x.dtype)
    per_unit = extent[:, 0] / (2 * boards.half[row, 0])
    column = (x[row, place] + boards.half[row, 0]) * per_unit - 0.5
    line = (y[row, place] + boards.half[row, 1]) * per_unit - 0.5
    level = (footprint[row, place] * per_unit).log2_().round_().clamp_(0, 3).long()
    colour = sample(atlas, chosen, column, line, level).mul_(boards.shade[row]).clamp_(0, 255)
    flat = picture.flatten(2)
    behind = flat[row, :, place]
    flat[row, :, place] = torch.lerp(behind, colour.T, share[row, place][:, None])
    picture.copy_(flat.view_as(picture))


def board_segments(atlas: Atlas, boards: Boards) -> Segments3D:
    """Borders of the boards and lines of the pictures on them, in camera coordinates."""
    counts = atlas.first[boards.picture + 1] - atlas.first[boards.picture]
    row, place = ragged_arange(counts)
    ends = atlas.segments[atlas.first[boards.picture][row] + place].view(-1, 2, 2)
    extent = atlas.extent[boards.picture, 0].to(ends.dtype)[row][:, None]
    inner = (2 * (ends + 0.5) / extent - 1) * boards.half[row][:, None]
    corner = boards.half.new_tensor([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    sides = torch.stack([corner, corner.roll(-1, 0)], dim=1)
    border = (sides * boards.half[:, None, None]).flatten(0, 1)
    owner = torch.arange(len(boards), device=row.device).repeat_interleave(4)
    every, owner = torch.cat([inner, border]), torch.cat([row, owner])
    order = torch.argsort(owner, stable=True)
    flat = torch.cat([every, torch.ones_like(every[..., :1])], dim=2)[order]
    owner = owner[order]
    camera = torch.einsum("nij,nej->nei", boards.pose[owner], flat)
    return Segments3D(camera[:, 0], camera[:, 1], owner)


def board_visibility(
    boards: Boards, points: Float[Tensor, "n 3"], row: Int[Tensor, " n"]
) -> Bool[Tensor, " n"]:
    """True where no board stands before a point of the scene; boards are nearer than all else."""
    x, y, nearness = _on_board(boards.pose[row], points[..., None])
    within = (x.abs() <= boards.half[row, :1]) & (y.abs() <= boards.half[row, 1:])
    return ~(within & (nearness > 0))[:, 0]


def _on_board(
    pose: Float[Tensor, "b 3 3"], rays: Float[Tensor, "b 3 n"]
) -> tuple[Float[Tensor, "b n"], Float[Tensor, "b n"], Float[Tensor, "b n"]]:
    """Where rays meet the planes of boards, and 1 / distance in lengths of the rays."""
    place = torch.linalg.solve(pose, rays)
    nearness = place[:, 2]
    ahead = torch.where(nearness.abs() < _TINY, torch.full_like(nearness, _TINY), nearness)
    return place[:, 0] / ahead, place[:, 1] / ahead, nearness

"""Photographs as a plane in front of the lens: the paper's D-Wireframe."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from learned.slf.atlas import Atlas
from learned.slf.strokes import Segments3D, ragged_arange


@dataclass(frozen=True)
class Planes:
    """Square cuts of photographs that fill the plane z = 1 between −1 and 1.

    Attributes:
        picture: Number of the photograph in the atlas.
        centre: Middle of the cut in pixels.
        axis: Pixels per unit along the plane's x, (du, dv); its y is this turned by 90°, mirrored
            where `flip` is −1.
        flip: 1, or −1 for a mirrored photograph.
    """

    picture: Int[Tensor, " b"]
    centre: Float[Tensor, "b 2"]
    axis: Float[Tensor, "b 2"]
    flip: Float[Tensor, " b"]

    def axes(self) -> Float[Tensor, "b 2 2"]:
        """Pixels of the photograph per unit of the plane: column 0 for x, column 1 for y."""
        x = self.axis * torch.stack([self.flip, self.flip], 1)
        y = torch.stack([-self.axis[:, 1], self.axis[:, 0]], 1)
        return torch.stack([x, y], dim=2)


def draw_planes(
    rng: np.random.Generator, atlas: Atlas, pictures: Int[Tensor, " p"], n: int, *, upright: bool
) -> Planes:
    """Choose photographs and cuts.

    Args:
        rng: Source of randomness.
        atlas: The photographs.
        pictures: Which of them may be used.
        n: Number of planes.
        upright: Keep photographs as they are, else mirror half of them and turn some.
    """
    chosen = pictures.cpu().numpy()[rng.integers(0, len(pictures), n)]
    extent = atlas.extent[chosen, 0].cpu().numpy().astype(float)
    half = extent.min(axis=1) / 2 * (rng.uniform(0.8, 1.0, n) if not upright else 1.0)
    room = (extent - 1) / 2 - (half - 0.5)[:, None]
    centre = (extent - 1) / 2 + np.maximum(room, 0) * rng.uniform(-1, 1, (n, 2))
    turned = (rng.random(n) < 0.12) & (not upright)
    angle = np.where(turned, rng.integers(1, 4, n) * (np.pi / 2), 0.0)
    flip = np.where((rng.random(n) < 0.5) & (not upright), -1.0, 1.0)
    axis = (half - 0.5)[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    device = atlas.texels.device
    return Planes(
        torch.as_tensor(chosen, device=device),
        *(torch.as_tensor(x, dtype=torch.float32, device=device) for x in (centre, axis, flip)),
    )


def render_planes(
    atlas: Atlas, planes: Planes, points: Float[Tensor, "b 2 h w"]
) -> Float[Tensor, "b 3 h w"]:
    """What is seen of the photographs at points of the plane, in [0, 255]; black beside them.

    Args:
        atlas: The photographs.
        planes: One for each picture to make.
        points: Where the pixels' rays meet the plane z = 1.
    """
    extent = atlas.extent[planes.picture, 0].to(points.dtype)
    # grid_sample wants the picture between −1 and 1, from border to border
    scale = (2.0 / extent)[:, :, None]
    shift = ((2.0 * planes.centre + 1.0) / extent - 1.0)[..., None]
    axes = planes.axes() * scale
    grid = torch.baddbmm(shift, axes, points.flatten(2)).view(points.shape)
    out = points.new_empty((len(points), 3, *points.shape[2:]))
    for row, picture in enumerate(planes.picture.tolist()):
        place = grid[row : row + 1].movedim(1, 3)
        out[row] = functional.grid_sample(atlas.image(picture)[None], place, align_corners=False)[0]
    seen = torch.maximum(points[:, 0].abs(), points[:, 1].abs()) <= 1.0
    return out.mul_(seen[:, None])


def plane_segments(atlas: Atlas, planes: Planes) -> Segments3D:
    """The photographs' segments on the plane, cut to its square."""
    counts = atlas.first[planes.picture + 1] - atlas.first[planes.picture]
    row, place = ragged_arange(counts)
    ends = atlas.segments[atlas.first[planes.picture][row] + place].view(-1, 2, 2)
    inverse = torch.linalg.inv(planes.axes())[row]
    flat = torch.einsum("nij,nej->nei", inverse, ends - planes.centre[row][:, None])
    flat, keep = clipped(flat, torch.ones_like(flat[:, 0]))
    flat = torch.cat([flat, torch.ones_like(flat[..., :1])], dim=2)[keep]
    return Segments3D(flat[:, 0], flat[:, 1], row[keep])


def clipped(
    ends: Float[Tensor, "n 2 2"], half: Float[Tensor, "n 2"]
) -> tuple[Float[Tensor, "n 2 2"], Tensor]:
    """Segments cut to rectangles from −half to half (Liang and Barsky), and which have a rest."""
    start, step = ends[:, 0], ends[:, 1] - ends[:, 0]
    # a step of zero is parallel to that pair of sides: any large quotient of the right sign will do
    safe = torch.where(step.abs() < 1e-9, torch.full_like(step, 1e-9), step)
    a, b = (-half - start) / safe, (half - start) / safe
    enter = torch.minimum(a, b).amax(1).clamp_min(0.0)
    leave = torch.maximum(a, b).amin(1).clamp_max(1.0)
    out = torch.stack([start + enter[:, None] * step, start + leave[:, None] * step], dim=1)
    return out, leave > enter

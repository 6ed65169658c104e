"""Cuts of equirectangular panoramas with any lens and pose.

The middle column of a panorama looks along z, its rows run from the zenith down. Lines are stored
by the pixels of their ends; between them a line follows the great circle.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from learned.slf.atlas import Atlas, sample
from learned.slf.strokes import Segments3D, ragged_arange


@dataclass(frozen=True)
class Views:
    """Panoramas and the directions they are seen in.

    Attributes:
        picture: Number of the panorama in the atlas.
        rotation: World directions of the camera's axes (columns).
    """

    picture: Int[Tensor, " b"]
    rotation: Float[Tensor, "b 3 3"]


@torch.no_grad()
def render_views(
    atlas: Atlas, views: Views, rays: Float[Tensor, "b 3 h w"]
) -> Float[Tensor, "b 3 h w"]:
    """What each ray sees, in [0, 255]."""
    world = torch.bmm(views.rotation, rays.flatten(2)).view(rays.shape)
    extent = atlas.extent[views.picture, 0].to(rays.dtype)[:, :, None, None]
    u = (torch.atan2(world[:, 0], world[:, 2]) / (2 * math.pi) + 0.5) * extent[:, 0] - 0.5
    v = (torch.asin(world[:, 1].clamp(-1, 1)) / math.pi + 0.5) * extent[:, 1] - 0.5
    picture = views.picture[:, None, None].expand_as(u)
    colour = sample(atlas, picture, u, v, torch.zeros_like(picture), wrap_u=True)
    return colour.movedim(0, 1)


def view_segments(atlas: Atlas, views: Views) -> Segments3D:
    """The panoramas' lines as chords between unit vectors, in camera coordinates."""
    counts = atlas.first[views.picture + 1] - atlas.first[views.picture]
    row, place = ragged_arange(counts)
    ends = atlas.segments[atlas.first[views.picture][row] + place].view(-1, 2, 2)
    extent = atlas.extent[views.picture, 0].to(ends.dtype)[row][:, None]
    angle = ((ends + 0.5) / extent - 0.5) * math.pi
    longitude, latitude = 2 * angle[..., 0], angle[..., 1]
    level = torch.cos(latitude)
    parts = [level * torch.sin(longitude), torch.sin(latitude), level * torch.cos(longitude)]
    camera = torch.einsum("nji,nej->nei", views.rotation[row], torch.stack(parts, -1))
    return Segments3D(camera[:, 0], camera[:, 1], row)

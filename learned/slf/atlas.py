"""Pictures and their straight segments in one flat pack, sampled by index on any device.

Photographs of any size lie one after the other as RGBA words with their mip levels, so a single
gather reads texels of many photographs at once: a room whose walls are different photographs is
rendered without a loop over walls. The file is safetensors and is mapped, not read.
"""

from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float, Int
from torch import Tensor

LEVELS = 4
"""Mip levels stored per picture: full size, then halves."""

_FORMAT = "slf-atlas-1"


@dataclass(frozen=True)
class Atlas:
    """Pictures with segments.

    Attributes:
        texels: RGBA bytes of every level of every picture, one 32-bit word a texel.
        base: Index of the first texel of each level, shape (p, LEVELS).
        extent: Width and height of each level in texels, shape (p, LEVELS, 2).
        segments: Straight segments (u1, v1, u2, v2) in pixels of level 0, shape (s, 4).
        first: Row of `segments` where each picture's own begin, shape (p + 1,).
        kind: 0 photograph, 1 drawn pattern, 2 panorama; shape (p,).
    """

    texels: Int[Tensor, " t"]
    base: Int[Tensor, "p levels"]
    extent: Int[Tensor, "p levels 2"]
    segments: Float[Tensor, "s 4"]
    first: Int[Tensor, " p_plus_1"]
    kind: Int[Tensor, " p"]

    def __len__(self) -> int:
        """Number of pictures."""
        return self.base.shape[0]

    def to(self, device: torch.device | str) -> "Atlas":
        """The same atlas on another device."""
        return Atlas(**{name: value.to(device) for name, value in vars(self).items()})

    def of_kind(self, kind: int) -> Int[Tensor, " n"]:
        """Numbers of the pictures of one kind."""
        return torch.nonzero(self.kind == kind)[:, 0]


@torch.no_grad()
def sample(
    atlas: Atlas,
    picture: Int[Tensor, "..."],
    u: Float[Tensor, "..."],
    v: Float[Tensor, "..."],
    level: Int[Tensor, "..."],
    *,
    wrap_u: bool = False,
) -> Float[Tensor, "3 ..."]:
    """Read pictures bilinearly, with the border texel repeated outside.

    Args:
        atlas: The pictures.
        picture: Number of the picture for every query.
        u: Column in pixels of level 0, the centre of the first texel at 0.
        v: Row in pixels of level 0.
        level: Mip level for every query, clamped to those stored.
        wrap_u: Whether columns go round, as in a panorama.

    Returns:
        RGB in [0, 255], shape (3, ...).
    """
    slot = picture * LEVELS + level.clamp(0, LEVELS - 1)
    base = atlas.base.view(-1)[slot]
    size = atlas.extent.view(-1, 2)[slot]
    width, height = size[..., 0], size[..., 1]
    full = atlas.extent[:, 0, :].to(u.dtype)[picture]
    x = (u + 0.5) * (width / full[..., 0]) - 0.5
    y = (v + 0.5) * (height / full[..., 1]) - 0.5
    x0, y0 = torch.floor(x), torch.floor(y)
    share_x, share_y = x - x0, y - y0
    column, row = x0.long(), y0.long()
    if wrap_u:
        left, right = column.remainder(width), (column + 1).remainder(width)
    else:
        last = width - 1
        left = torch.minimum(column.clamp_min(0), last)
        right = torch.minimum((column + 1).clamp_min(0), last)
    last = height - 1
    top = base + torch.minimum(row.clamp_min(0), last) * width
    bottom = base + torch.minimum((row + 1).clamp_min(0), last) * width
    corners = [atlas.texels[at] for at in (top + left, top + right, bottom + left, bottom + right)]
    weights = [
        (1 - share_x) * (1 - share_y),
        share_x * (1 - share_y),
        (1 - share_x) * share_y,
        share_x * share_y,
    ]
    out = torch.empty((3, *u.shape), dtype=u.dtype, device=u.device)
    for channel in range(3):
        shift = 8 * channel
        parts = [((c >> shift) & 255) * w for c, w in zip(corners, weights, strict=True)]
        out[channel] = parts[0] + parts[1] + parts[2] + parts[3]
    return out


def save_atlas(atlas: Atlas, path: Path) -> None:
    """Write a pack, whole or not at all."""
    from safetensors.torch import save_file

    temporary = path.with_name(path.name + ".part")
    save_file(dict(vars(atlas)), temporary, metadata={"format": _FORMAT})
    temporary.replace(path)


def load_atlas(path: Path) -> Atlas:
    """Map a pack into memory.

    Raises:
        ValueError: If the file is no pack of this format.
    """
    from safetensors import safe_open

    with safe_open(path, framework="pt") as file:
        found = (file.metadata() or {}).get("format")
        if found != _FORMAT:
            raise ValueError(f"expected a pack of format {_FORMAT!r}, got {found!r} in {path}")
        return Atlas(**{name: file.get_tensor(name) for name in file.keys()})  # noqa: SIM118

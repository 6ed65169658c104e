"""Pictures and their straight segments in one flat pack, sampled by index on any device.

Photographs of any size lie one after the other as RGBA words with their mip levels, so a single
gather reads texels of many photographs at once: a room whose walls are different photographs is
rendered without a loop over walls. The file is safetensors and is mapped, not read.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from classical.files import atomic_path

PHOTOGRAPH, PATTERN, PANORAMA, ROOM, BOARD = range(5)
"""Kinds: photographs, drawn patterns, panoramas, panoramas of rendered rooms, drawn boards."""

LEVELS = 4
"""Mip levels stored per picture: full size, then halves."""

_FORMAT = "slf-atlas-1"
_RED_BLUE = 0x00FF00FF


@dataclass(frozen=True)
class Atlas:
    """Pictures with segments.

    Attributes:
        texels: RGBA bytes of every level of every picture, one 32-bit word a texel.
        base: Index of the first texel of each level, shape (p, LEVELS).
        extent: Width and height of each level in texels, shape (p, LEVELS, 2).
        segments: Straight segments (u1, v1, u2, v2) in pixels of level 0, shape (s, 4).
        first: Row of `segments` where each picture's own begin, shape (p + 1,).
        kind: `PHOTOGRAPH`, `PATTERN`, `PANORAMA`, `ROOM` or `BOARD`; shape (p,).
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

    def image(self, picture: int) -> Float[Tensor, "3 h w"]:
        """One picture at full size, RGB in [0, 255]."""
        width, height = self.extent[picture, 0].tolist()
        start = int(self.base[picture, 0])
        texels = self.texels[start : start + width * height].view(torch.uint8)
        return texels.view(height, width, 4).float().permute(2, 0, 1)[:3]

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
    shape = u.shape
    picture, u, v = picture.reshape(-1), u.reshape(-1), v.reshape(-1)
    slot = picture * LEVELS + level.reshape(-1).clamp(0, LEVELS - 1)
    # index_select is several times faster than indexing on a CPU
    base = atlas.base.view(-1).index_select(0, slot).int()
    width, height, ratio_u, ratio_v = (x.view(-1).index_select(0, slot) for x in _tables(atlas))
    x, y = (u + 0.5).mul_(ratio_u).sub_(0.5), (v + 0.5).mul_(ratio_v).sub_(0.5)
    x0, y0 = torch.floor(x), torch.floor(y)
    share_x, share_y = x.sub_(x0), y.sub_(y0)
    left, right = _neighbours(x0.int(), width, wrap=wrap_u)
    top, bottom = _neighbours(y0.int(), height, wrap=False)
    top.mul_(width).add_(base)
    bottom.mul_(width).add_(base)
    return _blend(atlas.texels, (left, right, top, bottom), share_x, share_y).view(3, *shape)


def _tables(atlas: Atlas) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Width, height and their ratios to the full size, for every level of every picture."""
    width, height = atlas.extent[..., 0], atlas.extent[..., 1]
    ratio_u, ratio_v = width / width[:, :1], height / height[:, :1]
    return width.int(), height.int(), ratio_u, ratio_v


def _neighbours(first: Tensor, count: Tensor, *, wrap: bool) -> tuple[Tensor, Tensor]:
    """A texel's number and the next one's, held inside or taken round."""
    if wrap:
        return first.remainder(count), (first + 1).remainder(count)
    last = count - 1
    low = torch.minimum(first.clamp_min(0), last)
    return low, torch.minimum((first + 1).clamp_min_(0), last)


def _blend(
    texels: Tensor, corners: tuple[Tensor, Tensor, Tensor, Tensor], share_x: Tensor, share_y: Tensor
) -> Tensor:
    """Weigh four texels with weights that sum to 256, red and blue in one integer."""
    left, right, top, bottom = corners
    weight_x = share_x.mul_(256).add_(0.5).int()
    low = (256 - weight_x) * (256 - (weight_y := share_y.mul_(256).add_(0.5).int()))
    taps = [(low + 128) >> 8]
    taps.append((weight_x * (256 - weight_y) + 128) >> 8)
    taps.append(((256 - weight_x) * weight_y + 128) >> 8)
    taps.append(256 - taps[0] - taps[1] - taps[2])
    places = (top + left, top + right, bottom + left, bottom + right)
    odd = even = None
    for place, weight in zip(places, taps, strict=True):
        word = texels.index_select(0, place)
        pair = (word & _RED_BLUE).mul_(weight)
        green = word.bitwise_right_shift_(8).bitwise_and_(255).mul_(weight)
        even = pair if even is None else even.add_(pair)
        odd = green if odd is None else odd.add_(green)
    assert even is not None
    assert odd is not None
    out = torch.empty((3, len(share_x)), dtype=share_x.dtype, device=share_x.device)
    out[0] = even & 0xFFFF
    out[1] = odd
    out[2] = even.bitwise_right_shift_(16).bitwise_and_(0xFFFF)
    return out.mul_(1.0 / 256.0)


def merged_atlas(parts: list[Atlas]) -> Atlas:
    """Several packs as one, pictures in the order given."""
    texels = np.cumsum([0] + [len(part.texels) for part in parts])
    lines = np.cumsum([0] + [len(part.segments) for part in parts])
    first = [part.first[:-1] + int(n) for part, n in zip(parts, lines[:-1], strict=True)]
    return Atlas(
        texels=torch.cat([part.texels for part in parts]),
        base=torch.cat([part.base + int(n) for part, n in zip(parts, texels[:-1], strict=True)]),
        extent=torch.cat([part.extent for part in parts]),
        segments=torch.cat([part.segments for part in parts]),
        first=torch.cat([*first, torch.tensor(lines[-1:])]),
        kind=torch.cat([part.kind for part in parts]),
    )


def save_atlas(atlas: Atlas, path: Path) -> None:
    """Write a pack, whole or not at all."""
    from safetensors.torch import save_file

    with atomic_path(path) as temporary:
        save_file(dict(vars(atlas)), temporary, metadata={"format": _FORMAT})


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

"""Mirrored samples: a flip of the picture is another picture of a lens that is known as well."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from learned.slf.batch import SlfBatch

MIRRORS: tuple[tuple[int, ...], ...] = ((), (3,), (2, 3), (2,))
"""None, left-right, half turn, top-bottom: dimensions of b c h w."""


def mirrored(batch: SlfBatch, dims: tuple[int, ...]) -> SlfBatch:
    """The batch with its pictures flipped along `dims` (2: top-bottom, 3: left-right).

    A flip of a frame centred on (0, 0) turns the sign of the principal point; the rest of the lens
    is radial and stays.
    """
    if not dims:
        return batch
    sign = torch.ones_like(batch.k)
    sign[:, 7] = -1.0 if 3 in dims else 1.0
    sign[:, 8] = -1.0 if 2 in dims else 1.0

    def flip(picture: Tensor | None) -> Tensor | None:
        return None if picture is None else picture.flip(dims)

    return replace(
        batch,
        image=batch.image.flip(dims),
        line_map=batch.line_map.flip(dims),
        k=batch.k * sign,
        rectified=batch.rectified.flip(dims),
        seen=flip(batch.seen),
    )

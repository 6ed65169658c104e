"""Mirrored pictures: a flip of the picture is another picture of a lens that is known as well.

It makes four training samples of one, and four looks at one picture, whose mean errs less than
they.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from learned.larecnet import LaRecNet
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

    def flip(picture: Tensor | None) -> Tensor | None:
        return None if picture is None else picture.flip(dims)

    return replace(
        batch,
        image=batch.image.flip(dims),
        line_map=batch.line_map.flip(dims),
        k=batch.k * _signs(dims).to(batch.k),
        rectified=batch.rectified.flip(dims),
        seen=flip(batch.seen),
    )


def transposed(batch: SlfBatch) -> SlfBatch:
    """The batch with columns and rows exchanged: upright pictures of lying ones.

    In the gauge m_u = 1 the lens becomes (k m_v, 1, 1 / m_v, v0, u0).
    """

    def swap(picture: Tensor | None) -> Tensor | None:
        return None if picture is None else picture.transpose(2, 3)

    k = batch.k
    aspect = k[:, 6:7]
    return replace(
        batch,
        image=batch.image.transpose(2, 3),
        line_map=batch.line_map.transpose(2, 3),
        k=torch.cat([k[:, :5] * aspect, k[:, 5:6], 1 / aspect, k[:, 8:9], k[:, 7:8]], dim=1),
        rectified=batch.rectified.transpose(2, 3),
        seen=swap(batch.seen),
    )


@dataclass(frozen=True)
class MeanEstimate:
    """What LaRecNet says of pictures and their mirror images, brought together.

    Attributes:
        k: Mean of the estimates, in half widths.
        covariance: Mean of their covariances, or None where the network predicts none. Their errors
            are nearly the same, so it is not divided by their number.
        seen: Lineness and heatmap of the pictures themselves, or None where the network uses none.
    """

    k: Float[Tensor, "b 9"]
    covariance: Float[Tensor, "b 9 9"] | None
    seen: Float[Tensor, "b 2 h w"] | None


def mean_estimate(network: LaRecNet, image: Float[Tensor, "b 3 h w"]) -> MeanEstimate:
    """Estimate the lens from each picture and its three mirror images.

    Line perception, the dearer part, looks once; its maps are mirrored.

    Args:
        network: In evaluation mode.
        image: Pictures at the network's frame.
    """
    seen = network.dlp.maps(image) if network.uses_lines else None
    out = network(_all_mirrored(image), seen=None if seen is None else _all_mirrored(seen))
    signs = torch.stack([_signs(dims) for dims in MIRRORS]).to(out.k)[:, None]
    k = out.k.unflatten(0, (len(MIRRORS), -1)) * signs
    covariance = None
    if out.estimate.cholesky is not None:
        spread = network.parameters_of_lens.covariance(out.estimate.cholesky)
        each = spread.unflatten(0, (len(MIRRORS), -1)) * signs[..., None] * signs[..., None, :]
        covariance = each.mean(0)
    return MeanEstimate(k.mean(0), covariance, seen)


def _all_mirrored(pictures: Float[Tensor, "b c h w"]) -> Float[Tensor, "4*b c h w"]:
    """The batch once for each of `MIRRORS`: one pass over all is faster than four."""
    flipped = torch.cat([pictures.flip(dims) for dims in MIRRORS])
    return flipped.contiguous(memory_format=torch.channels_last)


def _signs(dims: tuple[int, ...]) -> Float[Tensor, " 9"]:
    """By what a flip along `dims` multiplies (k1..k5, m_u, m_v, u0, v0)."""
    sign = torch.ones(9)
    sign[7] = -1.0 if 3 in dims else 1.0
    sign[8] = -1.0 if 2 in dims else 1.0
    return sign

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
    lenses, spreads = [], []
    for dims in MIRRORS:
        flipped = image.flip(dims).contiguous(memory_format=torch.channels_last)
        out = network(flipped, seen=None if seen is None else seen.flip(dims))
        sign = _signs(dims).to(out.k)
        lenses.append(out.k * sign)
        if out.estimate.cholesky is not None:
            spread = network.parameters_of_lens.covariance(out.estimate.cholesky)
            spreads.append(spread * sign * sign[:, None])
    covariance = torch.stack(spreads).mean(0) if spreads else None
    return MeanEstimate(torch.stack(lenses).mean(0), covariance, seen)


def _signs(dims: tuple[int, ...]) -> Float[Tensor, " 9"]:
    """By what a flip along `dims` multiplies (k1..k5, m_u, m_v, u0, v0)."""
    sign = torch.ones(9)
    sign[7] = -1.0 if 3 in dims else 1.0
    sign[8] = -1.0 if 2 in dims else 1.0
    return sign

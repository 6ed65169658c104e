"""Attentive uncertainty regularisation: where the rectified picture is hard to get right."""

from __future__ import annotations

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional


class AttentiveUncertainty(nn.Module):
    """The uncertainty map U_A from L1–L4, the fisheye picture and the rectified one.

    The paper writes a channel-wise softmax; over one channel that is the constant 1. "space" takes
    it over the pixels and scales it to the geometric mean 1: log U_A has mean 0 and starts uniform,
    as the paper's figure shows. (With the arithmetic mean held instead, L_pix is least where one
    pixel has all of U_A, since log U_A then falls everywhere else.) "channels" takes the softmax
    over several channels and keeps the first, which the factor `channels` brings to 1 at the start.

    Args:
        stages: Channels of the four stages' features.
        width: Channels C that each is brought down to.
        normalise: See above.
        channels: Channels of the softmax under "channels".
    """

    def __init__(
        self,
        stages: tuple[int, ...],
        *,
        width: int,
        normalise: Literal["space", "channels"] = "space",
        channels: int = 4,
    ) -> None:
        super().__init__()
        self.normalise = normalise
        self.channels = channels if normalise == "channels" else 1
        self.narrow = nn.ModuleList(nn.Conv2d(c, width, 1) for c in stages)
        self.last = nn.Conv2d(6 + width * len(stages), self.channels, 3, padding=1)
        for start in self.last.parameters():
            nn.init.zeros_(start)

    def forward(
        self,
        features: tuple[Float[Tensor, "b _ _ _"], ...],
        image: Float[Tensor, "b 3 h w"],
        rectified: Float[Tensor, "b 3 h w"],
    ) -> Float[Tensor, "b 1 h w"]:
        """U_A at the size of `image`, geometric mean 1 (space) or 1 at the start (channels)."""
        size = image.shape[-2:]
        maps = [
            functional.interpolate(conv(f), size=size, mode="bilinear", align_corners=False)
            for conv, f in zip(self.narrow, features, strict=True)
        ]
        logits = self.last(torch.cat([image, rectified, *maps], 1)).float()
        if self.normalise == "channels":
            return self.channels * torch.softmax(logits, 1)[:, :1]
        return (logits - logits.mean((1, 2, 3), keepdim=True)).exp()

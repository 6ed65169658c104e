"""Bottleneck residual stages (He et al., CVPR 2016), the backbone of the calibration module."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from learned.pyramid import conv_norm


class Bottleneck(nn.Module):
    """1x1, 3x3, 1x1 with a skip; the stride sits in the 3x3, as in torchvision."""

    def __init__(self, channels_in: int, channels_out: int, *, stride: int, ratio: int = 4) -> None:
        super().__init__()
        middle = channels_out // ratio
        self.body = nn.Sequential(
            conv_norm(channels_in, middle, 1),
            conv_norm(middle, middle, 3, stride=stride),
            nn.Conv2d(middle, channels_out, 1, bias=False),
            nn.BatchNorm2d(channels_out),
        )
        self.skip: nn.Module = nn.Identity()
        if stride != 1 or channels_in != channels_out:
            self.skip = nn.Sequential(
                nn.Conv2d(channels_in, channels_out, 1, stride, bias=False),
                nn.BatchNorm2d(channels_out),
            )

    def forward(self, features: Float[Tensor, "b c h w"]) -> Float[Tensor, "b d hs ws"]:
        """Add the body's answer to the skip."""
        return torch.relu(self.skip(features) + self.body(features))


def stage(
    channels_in: int, channels_out: int, blocks: int, *, stride: int, ratio: int
) -> nn.Sequential:
    """A stage of bottlenecks; the first one changes size and channels."""
    return nn.Sequential(
        *(
            Bottleneck(
                channels_in if i == 0 else channels_out,
                channels_out,
                stride=stride if i == 0 else 1,
                ratio=ratio,
            )
            for i in range(blocks)
        )
    )

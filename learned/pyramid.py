"""Pyramid residual modules (Yang et al., ICCV 2017), the building block of line perception."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional


def conv_norm(channels_in: int, channels_out: int, size: int, *, stride: int = 1) -> nn.Sequential:
    """A convolution, batch norm and ReLU: what the paper puts at each layer but the last."""
    return nn.Sequential(
        nn.Conv2d(channels_in, channels_out, size, stride, size // 2, bias=False),
        nn.BatchNorm2d(channels_out),
        nn.ReLU(inplace=True),
    )


class PyramidBranch(nn.Module):
    """A 3x3 convolution on a smaller copy of the features, brought back to their size."""

    def __init__(self, channels: int, branch_channels: int, scale: float) -> None:
        super().__init__()
        self.scale = scale
        self.look = conv_norm(channels, branch_channels, 3)
        self.widen = nn.Conv2d(branch_channels, channels, 1, bias=False)

    def forward(self, features: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        """Run the branch; the size of `features` is kept."""
        if self.scale == 0.5:
            small = functional.avg_pool2d(features, 2, ceil_mode=True)
        else:
            small = functional.interpolate(
                features, scale_factor=self.scale, mode="bilinear", align_corners=False
            )
        seen = self.widen(self.look(small))
        return functional.interpolate(seen, size=features.shape[-2:], mode="nearest")


class PyramidResidual(nn.Module):
    """A bottleneck whose middle convolution also looks at coarser copies of its input.

    Yang et al. shrink by fractional max pooling; bilinear shrinking is the same pyramid
    without its random numbers.

    Args:
        channels_in: Channels that come.
        channels_out: Channels that leave.
        middle: Channels of the bottleneck.
        branch: Channels of a pyramid branch.
        scales: Size of each branch as a fraction of the input's.
    """

    def __init__(
        self,
        channels_in: int,
        channels_out: int,
        *,
        middle: int,
        branch: int,
        scales: tuple[float, ...],
    ) -> None:
        super().__init__()
        self.reduce = conv_norm(channels_in, middle, 1)
        self.main = nn.Conv2d(middle, middle, 3, padding=1, bias=False)
        self.branches = nn.ModuleList(PyramidBranch(middle, branch, s) for s in scales)
        self.merge = nn.Sequential(nn.BatchNorm2d(middle), nn.ReLU(inplace=True))
        self.expand = nn.Conv2d(middle, channels_out, 1, bias=False)
        self.norm: nn.Module = nn.BatchNorm2d(channels_out)
        same = channels_in == channels_out
        self.skip = nn.Identity() if same else nn.Conv2d(channels_in, channels_out, 1, bias=False)

    def forward(self, features: Float[Tensor, "b c h w"]) -> Float[Tensor, "b d h w"]:
        """Add the pyramid's answer to the features."""
        small = self.reduce(features)
        seen = self.main(small)
        for branch in self.branches:
            seen = seen + branch(small)
        return self.skip(features) + self.norm(self.expand(self.merge(seen)))

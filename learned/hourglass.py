"""The hourglass of stacked hourglass networks (Newell et al., ECCV 2016)."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from learned.pyramid import PyramidResidual


@dataclass(frozen=True)
class PyramidCfg:
    """How wide a pyramid residual module is inside.

    Attributes:
        bottleneck: Middle channels as a fraction of the wider side.
        branch: Channels of a pyramid branch as a fraction of the middle.
        scales: Sizes of the branches as fractions of the input.
    """

    bottleneck: float = 0.5
    branch: float = 0.25
    scales: tuple[float, ...] = (0.84, 0.71, 0.59, 0.5)

    def build(self, channels_in: int, channels_out: int) -> PyramidResidual:
        """Make one module with these proportions."""
        middle = round(max(channels_in, channels_out) * self.bottleneck)
        branch = max(8, round(middle * self.branch))
        return PyramidResidual(
            channels_in, channels_out, middle=middle, branch=branch, scales=self.scales
        )


class Hourglass(nn.Module):
    """Halve the features `depth` times and come back, with a skip at each size.

    Args:
        width: Channels at full size.
        depth: Number of halvings.
        growth: Channels added at each halving (the paper: 0).
        pyramid: Proportions of the modules.
    """

    def __init__(self, width: int, *, depth: int, growth: int, pyramid: PyramidCfg) -> None:
        super().__init__()
        below = width + growth
        self.skip = pyramid.build(width, width)
        self.down = pyramid.build(width, below)
        self.inner = (
            Hourglass(below, depth=depth - 1, growth=growth, pyramid=pyramid)
            if depth > 1
            else pyramid.build(below, below)
        )
        self.up = pyramid.build(below, width)

    def forward(self, features: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        """Mix near and far; height and width must divide by 2**depth."""
        below = self.up(self.inner(self.down(functional.max_pool2d(features, 2))))
        return self.skip(features) + functional.interpolate(below, scale_factor=2.0, mode="nearest")

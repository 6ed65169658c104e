"""Rong et al. (ACCV 2016) re-built: classification of the one-parameter division model.

"Radial Lens Distortion Correction Using Convolutional Neural Networks Trained with Synthesized
Images": a classification network over evenly spaced values of the division parameter λ, whose
estimate is the mean of the classes under the softmax. Ours are the backbone (theirs is AlexNet, too
large for what it gives), the range, which must hold lenses past 120°, and soft labels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from learned.polynomial import monotone_limit, radius
from learned.pyramid import conv_norm
from learned.resnet import stage

_FIT_NODES = 64
_FIT_LIMIT = math.radians(80.0)


@dataclass(frozen=True)
class RongCfg:
    """Size and classes of the baseline network.

    Attributes:
        widths: Channels of the stem and the stages.
        strides: Strides of the same.
        blocks: Bottlenecks a stage.
        classes: Number of values of λ.
        low: Smallest λ, in 1 / half width².
        high: Largest λ.
        label_sigma: Standard deviation of the soft labels, in classes.
        frame: Side of the square frame that it looks at, in pixels: that of its training.
    """

    widths: tuple[int, ...] = (64, 256, 512, 1024)
    strides: tuple[int, ...] = (4, 1, 2, 2)
    blocks: int = 3
    classes: int = 401
    low: float = -1.8
    high: float = 0.2
    label_sigma: float = 2.0
    frame: int = 320


class RongNet(nn.Module):
    """A picture in, a distribution over the division parameter out."""

    values: Tensor

    def __init__(self, cfg: RongCfg) -> None:
        super().__init__()
        self.cfg = cfg
        sizes = list(zip(cfg.widths, cfg.widths[1:], cfg.strides[1:], strict=False))
        self.body = nn.Sequential(
            conv_norm(3, cfg.widths[0], 7, stride=cfg.strides[0]),
            *(stage(a, b, cfg.blocks, stride=s, ratio=4) for a, b, s in sizes),
        )
        self.last = nn.Linear(cfg.widths[-1], cfg.classes)
        self.register_buffer("values", torch.linspace(cfg.low, cfg.high, cfg.classes))

    def forward(self, image: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b classes"]:
        """Logits of the classes for RGB in [0, 1]."""
        return self.last(self.body(2.0 * image - 1.0).mean((2, 3)))

    def estimate(self, logits: Float[Tensor, "b classes"]) -> Float[Tensor, " b"]:
        """λ in 1 / half width²: the mean of the classes."""
        return torch.softmax(logits.float(), 1) @ self.values

    def labels(self, lambda_: Float[Tensor, " b"]) -> Float[Tensor, "b classes"]:
        """Soft labels around the true λ."""
        step = self.values[1] - self.values[0]
        clipped = lambda_.clamp(self.cfg.low, self.cfg.high)
        distance = (self.values - clipped[:, None]) / (step * self.cfg.label_sigma)
        return torch.softmax(-0.5 * distance.square(), 1)


def division_parameter(k: Float[Tensor, "b 9"]) -> Float[Tensor, " b"]:
    """The λ that suits a lens best, over the angles its frame shows up to 80°.

    The division model says r / tan θ = s (1 + λ r²) with a free scale s: a line in r², fitted by
    least squares with the weight of a ring's area.

    Args:
        k: Lens in half widths; the principal point plays no part.

    Returns:
        λ in 1 / half width².
    """
    limit = monotone_limit(k[:, :5]).clamp(max=_FIT_LIMIT)[:, None]
    unit = torch.linspace(0.02, 1.0, _FIT_NODES, dtype=k.dtype, device=k.device)
    theta = limit * unit
    r = radius(theta, k[:, :5])
    # rings outside the frame's half diagonal are seen by no pixel
    weight = r * (r < math.sqrt(2.0))
    weight = weight / weight.sum(1, keepdim=True)
    x, y = r.square(), r / torch.tan(theta)
    mean_x, mean_y = (weight * x).sum(1, keepdim=True), (weight * y).sum(1, keepdim=True)
    slope = (weight * (x - mean_x) * (y - mean_y)).sum(1) / (
        (weight * (x - mean_x).square()).sum(1).clamp_min(1e-9)
    )
    scale = mean_y[:, 0] - slope * mean_x[:, 0]
    return slope / scale.clamp_min(1e-6)

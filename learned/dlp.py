"""Distorted line perception: pyramid residual modules, stacked hourglasses, upsampling head.

Xue et al., LaRecNet, "Distorted Line Perception (DLP) Module". The heatmap is Eq. line-map: the
length of the bent line within one pixel, here as min(length, 255) / 255.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from learned.hourglass import Hourglass, PyramidCfg
from learned.pyramid import conv_norm

OUT_STRIDE = 4


@dataclass(frozen=True)
class DlpCfg:
    """Size and variant of the line perception network.

    Attributes:
        width: Channels at a quarter of the picture's size.
        stacks: Number of hourglasses, each with its own supervision.
        depth: Halvings in an hourglass.
        growth: Channels added at each halving.
        stem: "conv" (7x7 stride 2, then pooling between modules) or "patch" (non-overlapping
            4x4 patches in one step, which costs a third on a CPU).
        stem_modules: Pyramid residual modules at a quarter of the size, before the stacks.
        head: "deconv" (two transposed convolutions and a convolution at full size, as the paper)
            or "shuffle" (a convolution at a quarter of the size and a pixel shuffle).
        target: "length" (one channel, the paper's weighted l2) or "lineness" (one channel that
            says line or not by a sigmoid and one for the length: trains faster; the heatmap of
            the contract is their product).
        pyramid: Proportions of the modules.
    """

    width: int = 256
    stacks: int = 5
    depth: int = 4
    growth: int = 0
    stem: Literal["conv", "patch"] = "conv"
    stem_modules: int = 2
    head: Literal["deconv", "shuffle"] = "deconv"
    target: Literal["length", "lineness"] = "length"
    pyramid: PyramidCfg = field(default_factory=PyramidCfg)

    @property
    def channels(self) -> int:
        """Channels of a raw prediction."""
        return 1 if self.target == "length" else 2

    @property
    def multiple(self) -> int:
        """Height and width of a picture must divide by this."""
        return OUT_STRIDE * 2**self.depth


@dataclass(frozen=True)
class DlpOutput:
    """What line perception gives.

    Attributes:
        raw: Raw prediction at full size; one channel (length) or two (logit, length).
        side: Raw predictions of the earlier stacks, at full or a quarter of the size.
    """

    raw: Float[Tensor, "b c h w"]
    side: tuple[Float[Tensor, "b c hs ws"], ...]


class _PatchStem(nn.Sequential):
    """4x4 patches to channels, then modules at a quarter of the size."""

    def __init__(self, cfg: DlpCfg) -> None:
        super().__init__(
            nn.Conv2d(3, cfg.width, OUT_STRIDE, OUT_STRIDE, bias=False),
            nn.BatchNorm2d(cfg.width),
            *(cfg.pyramid.build(cfg.width, cfg.width) for _ in range(cfg.stem_modules)),
        )


class _ConvStem(nn.Sequential):
    """Cascaded modules to H/4 x W/4 x width, as in stacked hourglass networks."""

    def __init__(self, cfg: DlpCfg) -> None:
        half = cfg.width // 2
        super().__init__(
            conv_norm(3, cfg.width // 4, 7, stride=2),
            cfg.pyramid.build(cfg.width // 4, half),
            nn.MaxPool2d(2),
            *(
                cfg.pyramid.build(half if i == 0 else cfg.width, cfg.width)
                for i in range(cfg.stem_modules)
            ),
        )


class _ShuffleHead(nn.Sequential):
    """Predict the 4x4 pixels of a cell as channels, then spread them."""

    def __init__(self, cfg: DlpCfg, *, middle: bool) -> None:
        out = cfg.channels * OUT_STRIDE**2
        before = [conv_norm(cfg.width, cfg.width, 3)] if middle else []
        super().__init__(*before, nn.Conv2d(cfg.width, out, 1), nn.PixelShuffle(OUT_STRIDE))


class _DeconvHead(nn.Sequential):
    """Two transposed convolutions and one convolution, as in the paper."""

    def __init__(self, cfg: DlpCfg) -> None:
        widths = (cfg.width, cfg.width // 2, cfg.width // 4)
        layers: list[nn.Module] = []
        for wide, narrow in pairwise(widths):
            layers += [
                nn.ConvTranspose2d(wide, narrow, 4, 2, 1, bias=False),
                nn.BatchNorm2d(narrow),
                nn.ReLU(inplace=True),
            ]
        super().__init__(*layers, nn.Conv2d(widths[-1], cfg.channels, 3, padding=1))


class LinePerception(nn.Module):
    """The DLP module: a picture in, the heatmap of its bent lines out."""

    def __init__(self, cfg: DlpCfg) -> None:
        super().__init__()
        self.cfg = cfg
        self.stem = _PatchStem(cfg) if cfg.stem == "patch" else _ConvStem(cfg)
        self.hourglasses = nn.ModuleList(
            Hourglass(cfg.width, depth=cfg.depth, growth=cfg.growth, pyramid=cfg.pyramid)
            for _ in range(cfg.stacks)
        )
        self.mixes = nn.ModuleList(conv_norm(cfg.width, cfg.width, 1) for _ in range(cfg.stacks))
        self.side = nn.ModuleList(self._side_head() for _ in range(cfg.stacks - 1))
        self.remix = nn.ModuleList(
            nn.Conv2d(cfg.width, cfg.width, 1, bias=False) for _ in range(cfg.stacks - 1)
        )
        self.head = _ShuffleHead(cfg, middle=True) if cfg.head == "shuffle" else _DeconvHead(cfg)

    def _side_head(self) -> nn.Module:
        """The intermediate supervision of a stack; at full size where the head shuffles."""
        if self.cfg.head == "shuffle":
            return _ShuffleHead(self.cfg, middle=False)
        return nn.Conv2d(self.cfg.width, self.cfg.channels, 1)

    def forward(self, image: Float[Tensor, "b 3 h w"]) -> DlpOutput:
        """Perceive lines.

        Args:
            image: RGB in [0, 1]; height and width divide by `cfg.multiple`.

        Returns:
            Raw predictions.
        """
        features = self.stem(2.0 * image - 1.0)
        side: list[Tensor] = []
        seen = features
        for i, (hourglass, mix) in enumerate(zip(self.hourglasses, self.mixes, strict=True)):
            seen = mix(hourglass(features))
            if i < len(self.side):
                side.append(self.side[i](seen))
                features = features + self.remix[i](seen)
        return DlpOutput(raw=self.head(seen), side=tuple(side))

    def heatmap(self, raw: Float[Tensor, "b c h w"]) -> Float[Tensor, "b 1 h w"]:
        """The heatmap of Eq. line-map from a raw prediction, in [0, 1] for 0 to 255 px."""
        raw = raw.float()
        if self.cfg.target == "length":
            return raw.clamp(0.0, 1.0)
        return torch.sigmoid(raw[:, :1]) * raw[:, 1:].clamp(0.0, 1.0)

    def lineness(self, raw: Float[Tensor, "b c h w"]) -> Float[Tensor, "b 1 h w"]:
        """How sure the network is of a line, in [0, 1], whatever the line's length.

        The paper's one channel knows no such number; there, a quarter of the shortest
        length that its F-measure asks for (16 of 255) counts as sure.
        """
        raw = raw.float()
        if self.cfg.target == "length":
            return (raw * (255.0 / 16.0)).clamp(0.0, 1.0)
        return torch.sigmoid(raw[:, :1])

    def maps(self, image: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 2 h w"]:
        """Lineness and heatmap of pictures; see `forward`."""
        raw = self(image.contiguous(memory_format=torch.channels_last)).raw
        return torch.cat([self.lineness(raw), self.heatmap(raw)], 1)

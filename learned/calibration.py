"""The multiscale calibration module: picture and heatmap to lens parameters.

Xue et al., LaRecNet, "Multiscale Calibration Module": a ResNet backbone to a 10x10 map, a global
branch for all nine parameters, a local branch with shared weights for k1..k5 of five regions, and
their mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from learned.parameters import N_FREE, N_PARAMETERS
from learned.pyramid import conv_norm
from learned.rectification import pixel_grid
from learned.resnet import stage

Source = Literal["image", "heatmap", "features"]
_N_K = 5


@dataclass(frozen=True)
class CalibrationCfg:
    """Size and variant of the calibration module.

    Attributes:
        inputs: What it sees. The paper: picture I_f and heatmap L_f; either alone is an ablation.
            "features" adds the last features of line perception (compact preset: a warm start).
        reading: How 10x10x1024 comes out of 320x320. "conv-first": a stride-2 convolution, then
            stem and stages 1 to 3 (the overview figure has that convolution); "layer4": stem and
            stages 1 to 4, then a 1x1 convolution 2048 to 1024; "patch": 4x4 patches, then three
            stages (compact).
        widths: Channels of the stages.
        blocks: Bottlenecks of the stages.
        ratio: Narrowing inside a bottleneck.
        branch: Channels after the convolutions of the global branch.
        hidden: Width of the first fully connected layer (the paper does not say; 512).
        multiscale: Local branch and fusion; without it the global branch alone (an ablation).
        coordinates: Feed x, y and the squared radius of each pixel too (ours).
        covariance: Predict how far the parameters can be trusted (ours).
    """

    inputs: tuple[Source, ...] = ("image", "heatmap")
    reading: Literal["conv-first", "layer4", "patch"] = "conv-first"
    widths: tuple[int, ...] = (64, 256, 512, 1024)
    blocks: tuple[int, ...] = (3, 4, 6)
    ratio: int = 4
    branch: int = 1024
    hidden: int = 512
    multiscale: bool = True
    coordinates: bool = False
    covariance: bool = False

    def __post_init__(self) -> None:
        if not self.inputs or set(self.inputs) - {"image", "heatmap", "features"}:
            raise ValueError(f"expected inputs among image, heatmap, features, got {self.inputs}")
        if "features" in self.inputs and self.reading != "patch":
            raise ValueError('expected reading="patch" where "features" are an input')


@dataclass(frozen=True)
class CalibrationOutput:
    """Parameters in the coordinates of `Parameters`, before they become k.

    Attributes:
        fused: Mean of global and local for k1..k5, global for the rest.
        glob: Global branch.
        local: The five regions: upper left, lower left, upper right, lower right, centre.
        cholesky: Lower factor of the precision of the free coordinates, or None.
        stages: Features L1 to L4 for the uncertainty regulariser.
    """

    fused: Float[Tensor, "b 9"]
    glob: Float[Tensor, "b 9"]
    local: Float[Tensor, "b 5 5"] | None
    cholesky: Float[Tensor, "b 8 8"] | None
    stages: tuple[Float[Tensor, "b _ _ _"], ...]


class Backbone(nn.Module):
    """Stages L1 to L4 to a 10x10 map for 320x320."""

    def __init__(self, cfg: CalibrationCfg, *, feature_channels: int) -> None:
        super().__init__()
        self.cfg = cfg
        channels = 3 * ("image" in cfg.inputs) + ("heatmap" in cfg.inputs) + 3 * cfg.coordinates
        self.channels = channels
        first = cfg.widths[0]
        deep = feature_channels if "features" in cfg.inputs else 0
        if cfg.reading == "patch":
            self.stem: nn.Module = nn.Conv2d(channels, first, 4, 4)
            self.join: nn.Module = conv_norm(first + deep, first, 1)
        else:
            half = [conv_norm(channels, 16, 3, stride=2)] if cfg.reading == "conv-first" else []
            before = 16 if half else channels
            self.stem = nn.Sequential(*half, conv_norm(before, first, 7, stride=2))
            self.join = nn.MaxPool2d(3, 2, 1)
        strides = [2 if cfg.reading == "patch" else 1] + [2] * (len(cfg.blocks) - 1)
        sizes = zip(cfg.widths, cfg.widths[1:], cfg.blocks, strides, strict=False)
        self.stages = nn.ModuleList(
            stage(a, b, n, stride=s, ratio=cfg.ratio) for a, b, n, s in sizes
        )
        wide = cfg.widths[-1]
        self.last = conv_norm(wide, wide // 2, 1) if cfg.reading == "layer4" else nn.Identity()
        self.channels_out = wide // 2 if cfg.reading == "layer4" else wide

    def forward(
        self, seen: Float[Tensor, "b c h w"], features: Float[Tensor, "b d hq wq"] | None
    ) -> tuple[Float[Tensor, "b e hs ws"], tuple[Tensor, ...]]:
        """The map F_c and the four stages' features."""
        start = self.stem(seen)
        if self.cfg.reading == "patch":
            both = [start] if features is None else [start, features]
            here = self.join(torch.cat(both, 1))
        else:
            here = self.join(start)
        stages = [here if self.cfg.reading == "patch" else start]
        for part in self.stages:
            here = part(here)
            stages.append(here)
        return self.last(here), tuple(stages[-4:])


class _Branch(nn.Module):
    """Pooling and two fully connected layers."""

    def __init__(self, channels: int, hidden: int, out: int) -> None:
        super().__init__()
        self.first = nn.Linear(channels, hidden)
        self.last = nn.Linear(hidden, out)
        nn.init.normal_(self.last.weight, std=0.01)
        nn.init.zeros_(self.last.bias)

    def forward(self, region: Float[Tensor, "b c h w"]) -> Float[Tensor, "b n"]:
        """One vector for a region of the map."""
        with torch.autocast(region.device.type, enabled=False):  # precision is all that counts here
            return self.last(torch.relu(self.first(region.float().mean((2, 3)))))


class Calibration(nn.Module):
    """Backbone, global branch, local branch, fusion and, ours, a covariance.

    `temperature` widens every predicted standard deviation; it is set after training so that
    intervals hold on pictures of the training set that the network has not seen in that form.
    """

    temperature: Tensor

    def __init__(self, cfg: CalibrationCfg, *, feature_channels: int) -> None:
        super().__init__()
        self.cfg = cfg
        self.backbone = Backbone(cfg, feature_channels=feature_channels)
        channels = self.backbone.channels_out
        self.convs = nn.Sequential(
            conv_norm(channels, cfg.branch, 1), conv_norm(cfg.branch, cfg.branch, 3)
        )
        self.glob = _Branch(cfg.branch, cfg.hidden, N_PARAMETERS)
        self.local = _Branch(channels, cfg.hidden, _N_K) if cfg.multiscale else None
        entries = N_FREE * (N_FREE + 1) // 2
        self.spread = _Branch(cfg.branch, cfg.hidden, entries) if cfg.covariance else None
        self.register_buffer("temperature", torch.ones(()))

    def forward(
        self,
        image: Float[Tensor, "b 3 h w"],
        heatmap: Float[Tensor, "b 1 h w"] | None,
        features: Float[Tensor, "b d hq wq"] | None,
    ) -> CalibrationOutput:
        """Estimate the lens; see `CalibrationOutput`."""
        seen = self._inputs(image, heatmap)
        deep = features if "features" in self.cfg.inputs else None
        map_, stages = self.backbone(seen, deep)
        wide = self.convs(map_)
        glob = self.glob(wide).float()
        local = None
        fused = glob
        if self.local is not None:
            local = torch.stack([self.local(r) for r in regions(map_)], 1).float()
            mean = torch.cat([glob[:, None, :_N_K], local], 1).mean(1)
            fused = torch.cat([mean, glob[:, _N_K:]], 1)
        cholesky = None
        if self.spread is not None:
            entries = self.spread(wide.detach()).float()
            cholesky = cholesky_factor(entries) / self.temperature
        return CalibrationOutput(fused, glob, local, cholesky, stages)

    def _inputs(self, image: Tensor, heatmap: Tensor | None) -> Tensor:
        parts = [2.0 * image - 1.0] if "image" in self.cfg.inputs else []
        if "heatmap" in self.cfg.inputs:
            assert heatmap is not None
            parts.append(heatmap)
        if self.cfg.coordinates:
            height, width = int(image.shape[-2]), int(image.shape[-1])
            at = pixel_grid(height, width, device=image.device).reshape(height, width, 2)
            square = at.square().sum(-1, keepdim=True)
            planes = torch.cat([at, square], -1).permute(2, 0, 1)
            parts.append(planes.to(image.dtype).expand(image.shape[0], -1, -1, -1))
        if not parts:
            parts = [torch.zeros_like(image[:, :0])]
        return torch.cat(parts, 1)


def regions(map_: Float[Tensor, "b c h w"]) -> list[Tensor]:
    """Four quarters and the centre (6x6 of 10x10): UL, LL, UR, LR, centre."""
    height, width = int(map_.shape[-2]), int(map_.shape[-1])
    h, w = (height + 1) // 2, (width + 1) // 2
    top, left = round(0.2 * height), round(0.2 * width)
    return [
        map_[..., :h, :w],
        map_[..., height - h :, :w],
        map_[..., :h, width - w :],
        map_[..., height - h :, width - w :],
        map_[..., top : height - top, left : width - left],
    ]


def cholesky_factor(entries: Float[Tensor, "b m"]) -> Float[Tensor, "b 8 8"]:
    """Lower triangular matrix from its entries; the diagonal through an exponential.

    The diagonal stays between e⁻³ and e⁶, so that neither a lucky nor a hopeless picture makes the
    likelihood run away.
    """
    rows, columns = torch.tril_indices(N_FREE, N_FREE, device=entries.device)
    factor = entries.new_zeros(entries.shape[0], N_FREE, N_FREE)
    factor[:, rows, columns] = entries
    eye = torch.eye(N_FREE, device=entries.device)
    return torch.tril(factor, -1) + eye * factor.clamp(-3.0, 6.0).exp()

"""The multiscale calibration module: picture and heatmap to lens parameters.

Xue et al., LaRecNet, "Multiscale Calibration Module": a ResNet backbone to a 10x10 map, a global
branch for all nine parameters, a local branch with shared weights for k1..k5 of five regions, and
their mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from learned.parameters import N_FREE, N_PARAMETERS
from learned.pyramid import conv_norm
from learned.rectification import pixel_grid
from learned.resnet import stage

Source = Literal["image", "heatmap", "lineness"]
_N_K = 5


@dataclass(frozen=True)
class CalibrationCfg:
    """Size and variant of the calibration module.

    Attributes:
        inputs: What it sees. The paper: picture I_f and heatmap L_f; either alone is an ablation.
            "lineness" adds how sure of a line each pixel is, whatever the line's length (ours).
        reading: How 10x10x1024 comes out of 320x320. "conv-first": a stride-2 convolution, then
            stem and stages 1 to 3 (the overview figure has that convolution); "layer4": stem and
            stages 1 to 4, then a 1x1 convolution 2048 to 1024; "patch": 4x4 patches, then three
            stages (compact).
        widths: Channels of the stages.
        blocks: Bottlenecks of the stages.
        ratio: Narrowing inside a bottleneck.
        branch: Channels after the convolutions of the global branch.
        hidden: Width of the first fully connected layer (the paper does not say; 512).
        places: 0: branches average over the map. Else they see `narrow` channels of so many by so
            many places, and know what was where (ours; learns several times faster).
        narrow: Channels of a place.
        multiscale: Local branch and fusion; without it the global branch alone (an ablation).
        fusion: "mean" of the global and five local estimates (the paper), or "learned" weights
            that start there.
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
    places: int = 0
    narrow: int = 48
    multiscale: bool = True
    fusion: Literal["mean", "learned"] = "mean"
    coordinates: bool = False
    covariance: bool = False

    def __post_init__(self) -> None:
        known = get_args(Source)
        if not self.inputs or set(self.inputs) - set(known):
            raise ValueError(f"expected inputs among {', '.join(known)}, got {self.inputs}")


@dataclass(frozen=True)
class CalibrationOutput:
    """Parameters in the coordinates of `Parameters`, before they become k.

    Attributes:
        fused: Fusion of global and local for k1..k5, global for the rest.
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

    def __init__(self, cfg: CalibrationCfg) -> None:
        super().__init__()
        self.cfg = cfg
        maps = ("heatmap" in cfg.inputs) + ("lineness" in cfg.inputs)
        channels = 3 * ("image" in cfg.inputs) + maps + 3 * cfg.coordinates
        first = cfg.widths[0]
        if cfg.reading == "patch":
            self.stem: nn.Module = nn.Conv2d(channels, first, 4, 4)
            self.join: nn.Module = conv_norm(first, first, 1)
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
        self, seen: Float[Tensor, "b c h w"]
    ) -> tuple[Float[Tensor, "b e hs ws"], tuple[Tensor, ...]]:
        """The map F_c and the four stages' features."""
        start = self.stem(seen)
        here = self.join(start)
        stages = [here if self.cfg.reading == "patch" else start]
        for part in self.stages:
            here = part(here)
            stages.append(here)
        return self.last(here), tuple(stages[-4:])


class Branch(nn.Module):
    """Average, or what is where, and two fully connected layers."""

    def __init__(self, channels: int, cfg: CalibrationCfg, places: int, out: int) -> None:
        super().__init__()
        self.places = places
        self.narrow = nn.Conv2d(channels, cfg.narrow, 1) if places else nn.Identity()
        inside = cfg.narrow * places**2 if places else channels
        self.first = nn.Linear(inside, cfg.hidden)
        self.last = nn.Linear(cfg.hidden, out)
        nn.init.normal_(self.last.weight, std=0.01)
        nn.init.zeros_(self.last.bias)

    def forward(self, region: Float[Tensor, "b c h w"]) -> Float[Tensor, "b n"]:
        """One vector for a region of the map."""
        if self.places:
            region = torch.relu(self.narrow(region))
            if region.shape[-2:] != (self.places, self.places):
                size = (self.places, self.places)
                region = functional.interpolate(region, size, mode="bilinear", align_corners=False)
        with torch.autocast(region.device.type, enabled=False):  # precision is all that counts here
            region = region.float()
            flat = region.flatten(1) if self.places else region.mean((2, 3))
            return self.last(torch.relu(self.first(flat)))


class Calibration(nn.Module):
    """Backbone, global branch, local branch, fusion and, ours, a covariance.

    `temperature` widens every predicted standard deviation; it is set after training so that
    intervals hold on pictures of the training set that the network has not seen in that form.
    """

    temperature: Tensor

    def __init__(self, cfg: CalibrationCfg) -> None:
        super().__init__()
        self.cfg = cfg
        self.backbone = Backbone(cfg)
        channels = self.backbone.channels_out
        self.convs = nn.Sequential(
            conv_norm(channels, cfg.branch, 1), conv_norm(cfg.branch, cfg.branch, 3)
        )
        self.glob = Branch(cfg.branch, cfg, cfg.places, N_PARAMETERS)
        self.local = self.fusion = None
        if cfg.multiscale:
            self.local = Branch(channels, cfg, (cfg.places + 1) // 2, _N_K)
            if cfg.fusion == "learned":
                self.fusion = _Fusion()
        entries = N_FREE * (N_FREE + 1) // 2
        self.spread = Branch(cfg.branch, cfg, cfg.places, entries) if cfg.covariance else None
        self.register_buffer("temperature", torch.ones(()))

    def forward(
        self,
        image: Float[Tensor, "b 3 h w"],
        heatmap: Float[Tensor, "b 1 h w"] | None,
        lineness: Float[Tensor, "b 1 h w"] | None,
    ) -> CalibrationOutput:
        """Estimate the lens; see `CalibrationOutput`."""
        map_, stages = self.backbone(self._inputs(image, heatmap, lineness))
        wide = self.convs(map_)
        glob = self.glob(wide).float()
        local = None
        fused = glob
        if self.local is not None:
            local = torch.stack([self.local(r) for r in regions(map_)], 1).float()
            each = torch.cat([glob[:, None, :_N_K], local], 1)
            k = each.mean(1) if self.fusion is None else self.fusion(each)
            fused = torch.cat([k, glob[:, _N_K:]], 1)
        cholesky = None
        if self.spread is not None:
            entries = self.spread(wide.detach()).float()
            cholesky = cholesky_factor(entries) / self.temperature
        return CalibrationOutput(fused, glob, local, cholesky, stages)

    def _inputs(self, image: Tensor, heatmap: Tensor | None, lineness: Tensor | None) -> Tensor:
        parts = [2.0 * image - 1.0] if "image" in self.cfg.inputs else []
        for name, map_ in (("heatmap", heatmap), ("lineness", lineness)):
            if name in self.cfg.inputs:
                assert map_ is not None
                parts.append(map_)
        if self.cfg.coordinates:
            height, width = int(image.shape[-2]), int(image.shape[-1])
            at = pixel_grid(height, width, device=image.device).reshape(height, width, 2)
            square = at.square().sum(-1, keepdim=True)
            planes = torch.cat([at, square], -1).permute(2, 0, 1)
            parts.append(planes.to(image.dtype).expand(image.shape[0], -1, -1, -1))
        return torch.cat(parts, 1)


class _Fusion(nn.Module):
    """Weights of the six estimates for each of k1..k5; a sixth each at the start."""

    def __init__(self) -> None:
        super().__init__()
        self.mix = nn.Linear(6 * _N_K, _N_K)
        nn.init.zeros_(self.mix.bias)
        with torch.no_grad():
            self.mix.weight.copy_(torch.eye(_N_K).repeat(1, 6) / 6)

    def forward(self, each: Float[Tensor, "b 6 5"]) -> Float[Tensor, "b 5"]:
        """One estimate from the global one and the five local ones."""
        return self.mix(each.flatten(1))


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

"""The two sizes: `paper` as published, `compact` for a CPU. And the ablations' variants."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from learned.calibration import CalibrationCfg, Source
from learned.dlp import DlpCfg
from learned.hourglass import PyramidCfg
from learned.larecnet import LarecnetCfg
from learned.losses import LossCfg
from learned.rong import RongCfg
from learned.schedule import OptimCfg

SIZE = 320


@dataclass(frozen=True)
class Preset:
    """Everything that defines a model and its training.

    Attributes:
        name: What weights are tagged with.
        network: LaRecNet, with line perception inside.
        loss: Phase two.
        optim_dlp: Phase one's optimiser.
        optim: Phase two's optimiser.
        rong: The baseline's network.
        whiten: Regress in whitened coordinates instead of k itself.
        geo_stride: Pixels between the points of L_geo (1: paper).
    """

    name: str
    network: LarecnetCfg = field(default_factory=LarecnetCfg)
    loss: LossCfg = field(default_factory=LossCfg)
    optim_dlp: OptimCfg = field(default_factory=OptimCfg)
    optim: OptimCfg = field(default_factory=OptimCfg)
    rong: RongCfg = field(default_factory=RongCfg)
    whiten: bool = False
    geo_stride: int = 1

    def with_schedule(self, *, rate: float | None = None, fall: float | None = None) -> Preset:
        """The preset with another learning rate or another share of its fall, in both phases."""
        changes = {"rate": rate, "fall": fall}
        given = {name: value for name, value in changes.items() if value is not None}
        return replace(
            self, optim_dlp=replace(self.optim_dlp, **given), optim=replace(self.optim, **given)
        )


PAPER = Preset(name="paper")

# The same parts, narrower. Differences from the paper, each because it learns more per second on a
# CPU: patch stem and pixel-shuffle head, lineness besides length, pixel coordinates as further
# inputs of the calibration, branches that know what is where, regression in whitened coordinates
# (where ω says how much each moves pixels), L_geo on every fourth pixel and by its logarithm, so
# that odd wide lenses do not drown all others, a loss of the lens's shape without its scale, L_pix
# at a quarter of the size, AdamW.
COMPACT = Preset(
    name="compact",
    network=LarecnetCfg(
        dlp=DlpCfg(
            width=64,
            stacks=2,
            growth=32,
            stem="patch",
            stem_modules=1,
            head="shuffle",
            target="lineness",
            pyramid=PyramidCfg(bottleneck=0.5, branch=1.0, scales=(0.5,)),
        ),
        calibration=CalibrationCfg(
            inputs=("image", "heatmap", "lineness"),
            reading="patch",
            widths=(64, 128, 256, 384),
            blocks=(2, 3, 3),
            ratio=2,
            branch=256,
            hidden=256,
            places=6,
            fusion="learned",
            coordinates=True,
            covariance=True,
        ),
        uncertainty_width=8,
        pixel_stride=4,
    ),
    loss=LossCfg(
        geo=10.0,
        geo_scale=0.3,
        shape=60.0,
        shape_scale=0.04,
        projection=15.0,
        projection_scale=0.05,
        pix=0.2,
        para=0.3,
        omega=(1.0, 0.8, 0.5, 0.4, 0.4, 0.0, 0.5, 0.8, 0.8),
        nll=0.3,
        huber=1.0,
    ),
    optim_dlp=OptimCfg(
        kind="adamw", rate=2e-3, schedule="trapezoid", warmup=100, weight_decay=0.02, average=0.998
    ),
    optim=OptimCfg(
        kind="adamw", rate=1e-3, schedule="trapezoid", warmup=200, weight_decay=0.02, average=0.998
    ),
    rong=RongCfg(widths=(48, 96, 192, 256), strides=(4, 2, 2, 2)),
    whiten=True,
    geo_stride=4,
)

PRESETS = {preset.name: preset for preset in (PAPER, COMPACT)}


def preset(name: str) -> Preset:
    """The preset of a name.

    Raises:
        ValueError: If there is none.
    """
    if name not in PRESETS:
        raise ValueError(f"expected a preset among {sorted(PRESETS)}, got {name!r}")
    return PRESETS[name]


ABLATIONS = ("BL1", "BL2", "BL3", "BL4", "BL5", "BL6")


def ablation(base: Preset, name: str) -> Preset:
    """A variant of the paper's ablation study, each one thing more than the one before.

    BL1 sees the picture alone and BL2 the heatmap alone; BL3 sees both; BL4 adds the local branch;
    BL5 adds L_geo; BL6 adds L_pix with its uncertainty and is the whole network. Where the preset
    feeds on lineness, it comes with the heatmap. None has the shape or the projection loss, which
    are not the paper's.

    Args:
        base: Preset to vary.
        name: "BL1" to "BL6".

    Raises:
        ValueError: If there is none of that name.
    """
    if name not in ABLATIONS:
        raise ValueError(f"expected an ablation among {ABLATIONS}, got {name!r}")
    level = ABLATIONS.index(name) + 1
    whole = base.network.calibration.inputs
    maps: tuple[Source, ...] = tuple(source for source in whole if source != "image")
    inputs: dict[int, tuple[Source, ...]] = {1: ("image",), 2: maps}
    calibration = replace(
        base.network.calibration,
        inputs=inputs.get(level, whole),
        multiscale=level >= 4,
    )
    loss = replace(
        base.loss,
        geo=base.loss.geo if level >= 5 else 0.0,
        shape=0.0,
        projection=0.0,
        pix=base.loss.pix if level >= 6 else 0.0,
    )
    network = replace(base.network, calibration=calibration)
    return replace(base, name=f"{base.name}-{name}", network=network, loss=loss)

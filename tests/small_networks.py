"""Networks and training pictures small enough for tests."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from learned.dlp import DlpCfg
from learned.hourglass import PyramidCfg
from learned.larecnet import LarecnetCfg
from learned.presets import COMPACT
from learned.rong import RongCfg
from learned.slf.atlas import PHOTOGRAPH, save_atlas
from learned.slf.pack import Annotated, build_atlas

SMALL_DLP = DlpCfg(
    width=8,
    stacks=2,
    depth=2,
    stem="patch",
    stem_modules=1,
    head="shuffle",
    target="lineness",
    pyramid=PyramidCfg(scales=(0.5,)),
)
SMALL_CALIBRATION = replace(
    COMPACT.network.calibration, widths=(8, 8, 16, 16), blocks=(1, 1, 1), branch=8, hidden=8
)
SMALL = LarecnetCfg(
    dlp=SMALL_DLP, calibration=SMALL_CALIBRATION, uncertainty_width=2, pixel_stride=2
)
SMALL_RONG = RongCfg(widths=(8, 8, 8, 8), blocks=1, classes=11)


def write_small_pack(path: Path, count: int = 6) -> Path:
    """Photographs of noise that claim two lines each."""
    rng = np.random.default_rng(0)
    lines = np.array([[5, 10, 60, 12], [20, 50, 22, 8]], np.float32)
    pictures = [
        Annotated(rng.integers(0, 255, (64, 80, 3), dtype=np.uint8), lines, PHOTOGRAPH)
        for _ in range(count)
    ]
    save_atlas(build_atlas(pictures), path)
    return path

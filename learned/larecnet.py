"""LaRecNet: line perception, multiscale calibration, rectification, uncertainty.

Xue et al., "Fisheye Distortion Rectification from Deep Straight Lines".
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from learned.calibration import Calibration, CalibrationCfg, CalibrationOutput
from learned.dlp import DlpCfg, LinePerception
from learned.parameters import Parameters
from learned.rectification import rectify_images
from learned.uncertainty import AttentiveUncertainty


@dataclass(frozen=True)
class LarecnetCfg:
    """The whole network.

    Attributes:
        dlp: Line perception.
        calibration: Multiscale calibration.
        uncertainty_width: Channels C of each stage in the uncertainty module.
        pixel_stride: The rectified picture of L_pix is this much smaller than the input (1: paper).
        frame: Side of the square frame in which the lens is estimated, in pixels; it is what these
            weights were trained at last.
    """

    dlp: DlpCfg = field(default_factory=DlpCfg)
    calibration: CalibrationCfg = field(default_factory=CalibrationCfg)
    uncertainty_width: int = 32
    pixel_stride: int = 1
    frame: int = 320


@dataclass(frozen=True)
class LarecnetOutput:
    """What LaRecNet gives; lenses in half widths.

    Attributes:
        k: Fused parameters k̂.
        estimate: All parameters in the coordinates of `Parameters`, and the backbone's features.
        heatmap: L̂_f, or None where nothing asked for it.
        lineness: How sure of a line, or None likewise.
        rectified: I_r at the input's size over `pixel_stride`, or None where not asked for.
        uncertainty: U_A of the same size, or None likewise.
    """

    k: Float[Tensor, "b 9"]
    estimate: CalibrationOutput
    heatmap: Float[Tensor, "b 1 h w"] | None
    lineness: Float[Tensor, "b 1 h w"] | None
    rectified: Float[Tensor, "b 3 hr wr"] | None = None
    uncertainty: Float[Tensor, "b 1 hr wr"] | None = None


class LaRecNet(nn.Module):
    """Fisheye picture to lens, and to the rectified picture where asked for.

    Line perception is trained before and stays fixed here: no gradients, and its batch norms keep
    their statistics in training mode too.
    """

    def __init__(self, cfg: LarecnetCfg) -> None:
        super().__init__()
        self.cfg = cfg
        self.dlp = LinePerception(cfg.dlp).requires_grad_(False)
        self.parameters_of_lens = Parameters()
        self.calibration = Calibration(cfg.calibration)
        channels = _stage_channels(cfg.calibration)
        self.uncertainty = AttentiveUncertainty(channels, width=cfg.uncertainty_width)
        self.dlp.eval()

    @property
    def uses_lines(self) -> bool:
        """Whether calibration looks at the maps of line perception."""
        return bool(set(self.cfg.calibration.inputs) & {"heatmap", "lineness"})

    def train(self, mode: bool = True) -> LaRecNet:
        """Training mode for all but line perception."""
        super().train(mode)
        self.dlp.eval()
        return self

    def forward(
        self,
        image: Float[Tensor, "b 3 h w"],
        *,
        seen: Float[Tensor, "b 2 h w"] | None = None,
        rectify: bool = False,
    ) -> LarecnetOutput:
        """Estimate the lens of each picture.

        Args:
            image: RGB in [0, 1], height and width divide by `cfg.dlp.multiple`.
            seen: Lineness and heatmap, where line perception has looked at the pictures before.
            rectify: Give the rectified picture and its uncertainty too, for L_pix.

        Returns:
            Lens, parameters of all branches, heatmap.
        """
        heatmap = lineness = rectified = uncertainty = None
        if self.uses_lines:
            if seen is None:
                with torch.no_grad():
                    seen = self.dlp.maps(image)
            lineness, heatmap = seen[:, :1], seen[:, 1:]
        estimate = self.calibration(image, heatmap, lineness)
        k = self.parameters_of_lens.decode(estimate.fused)
        if rectify:
            rectified, uncertainty = self._rectified(image, k, estimate)
        return LarecnetOutput(k, estimate, heatmap, lineness, rectified, uncertainty)

    def _rectified(
        self, image: Tensor, k: Tensor, estimate: CalibrationOutput
    ) -> tuple[Tensor, Tensor]:
        """I_r by the rectification layer and its uncertainty map U_A."""
        stride = self.cfg.pixel_stride
        small = functional.avg_pool2d(image, stride) if stride > 1 else image
        rectified = rectify_images(small, k)
        return rectified, self.uncertainty(estimate.stages, small, rectified.detach())


def _stage_channels(cfg: CalibrationCfg) -> tuple[int, ...]:
    """Channels of the features L1 to L4 of this backbone."""
    return tuple(cfg.widths[-4:])

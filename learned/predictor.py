"""NumPy in, NumPy out: the only door between the networks and the rest of the project."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor

from classical.camera import Division, KannalaBrandt
from learned.inference import folded
from learned.larecnet import LaRecNet
from learned.letterbox import Letterbox, as_tensor, resized
from learned.mirror import mean_estimate
from learned.rong import RongNet
from learned.weights import load_weights, located

LINES_VIEW = 448
"""Longest side at which line perception looks at a picture, pixels: lines are then as wide as in
its training; at 640 the fit gains nothing from it and it takes three times as long."""

_TILE = 512
_OVERLAP = 64


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let torch use one thread: kernels split their sums by the number of threads.

    What is lost in speed is gained in trust: a picture has one answer, to the last bit.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@dataclass(frozen=True)
class LinePrediction:
    """What line perception says of a picture.

    Attributes:
        heatmap: Eq. line-map: min(length, 255) / 255 of the bent line, in pixels of this map.
        lineness: How sure of a line, whatever its length; the better source for curves.
    """

    heatmap: Float[ndarray, "h w"]
    lineness: Float[ndarray, "h w"]


@dataclass(frozen=True)
class LensPrediction:
    """What LaRecNet says of a picture.

    Attributes:
        camera: The picture's camera, gauge m_u = width / 2, or None where the estimate is no
            camera (k1 not positive).
        covariance: Of `camera.to_vector()`; the row of m_u is zero. None where the weights have no
            covariance head.
        lines: The heatmap at the network's size, or None where the weights do not use one.
    """

    camera: KannalaBrandt | None
    covariance: Float[ndarray, "9 9"] | None
    lines: LinePrediction | None


class Predictor:
    """A loaded LaRecNet for many pictures.

    Args:
        network: The network; a folded copy is kept, which is for inference alone.
        card: Its model card.
        device: Where it runs.
    """

    @_one_thread()
    def __init__(
        self, network: LaRecNet, card: dict[str, Any] | None = None, *, device: str = "cpu"
    ) -> None:
        self.network = folded(network).to(device)
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.card = card or {}
        self.device = device

    @classmethod
    def from_weights(cls, path: str | Path | None = None, *, device: str = "cpu") -> Predictor:
        """Load weights: a file, a name of weights that ship, or the default."""
        loaded = load_weights(located(path, "compact"), LaRecNet)
        return cls(loaded.network, loaded.card, device=device)

    @torch.inference_mode()
    @_one_thread()
    def lens(self, image: ndarray) -> LensPrediction:
        """Estimate the lens of a picture of any size, from it and its three mirror images.

        Args:
            image: Grey, RGB or RGBA, (h, w) or (h, w, c); integers or floats in [0, 1].

        Returns:
            Camera and covariance for the picture as it came.
        """
        tensor = as_tensor(image).to(self.device)
        box = Letterbox(tensor.shape[3], tensor.shape[2], self.network.cfg.frame)
        out = mean_estimate(self.network, _fast(box.fill(tensor)))
        k = out.k[0].double().cpu().numpy()
        camera = box.camera(k) if np.isfinite(k).all() and k[0] > 0 and k[6] > 0 else None
        covariance = None
        if out.covariance is not None:
            covariance = box.covariance(out.covariance[0].cpu().numpy())
        lines = None
        if out.seen is not None:
            lineness, heatmap = (box.content(m) for m in out.seen[0].cpu().numpy())
            lines = LinePrediction(heatmap, lineness)
        return LensPrediction(camera, covariance, lines)

    @torch.inference_mode()
    @_one_thread()
    def uncertainty(self, image: ndarray) -> Float[ndarray, "s s"]:
        """U_A: where the rectified picture is hard to get right, with geometric mean 1.

        Args:
            image: As for `lens`.

        Returns:
            Over the network's own square rectified frame, smaller by its `pixel_stride`.
        """
        tensor = as_tensor(image).to(self.device)
        box = Letterbox(tensor.shape[3], tensor.shape[2], self.network.cfg.frame)
        out = self.network(_fast(box.fill(tensor)), rectify=True)
        return out.uncertainty[0, 0].float().cpu().numpy()

    @torch.inference_mode()
    @_one_thread()
    def lines(self, image: ndarray, *, longest: int = LINES_VIEW) -> LinePrediction:
        """Find bent lines at a chosen resolution.

        Args:
            image: As for `lens`.
            longest: The picture is shrunk until no side is longer; it is never enlarged.

        Returns:
            Maps of the whole view, at the size that was looked at.
        """
        tensor = as_tensor(image).to(self.device)
        height, width = tensor.shape[-2:]
        scale = min(1.0, longest / max(height, width))
        small = resized(tensor, max(1, round(height * scale)), max(1, round(width * scale)))
        return self._perceive(small)

    def _perceive(self, image: Tensor) -> LinePrediction:
        """Line perception in overlapping tiles, blended; one tile where the picture is small."""
        height, width = image.shape[-2:]
        dlp = self.network.dlp
        sums = image.new_zeros(2, height, width)
        weight = image.new_zeros(height, width)
        for top, bottom in _spans(height):
            for left, right in _spans(width):
                tile = _padded(image[..., top:bottom, left:right], dlp.cfg.multiple)
                raw = dlp(_fast(tile)).raw
                maps = torch.cat([dlp.heatmap(raw), dlp.lineness(raw)], 1)[0]
                share = _window(bottom - top, right - left).to(maps)
                sums[:, top:bottom, left:right] += share * maps[:, : bottom - top, : right - left]
                weight[top:bottom, left:right] += share
        heatmap, lineness = (sums / weight).cpu().numpy()
        return LinePrediction(heatmap, lineness)


class RongPredictor:
    """The baseline of Rong et al. for many pictures; see `Predictor`."""

    def __init__(self, network: RongNet, card: dict[str, Any] | None = None) -> None:
        self.network = folded(network)
        self.card = card or {}

    @classmethod
    def from_weights(cls, path: str | Path | None = None) -> RongPredictor:
        """Load weights, by default those that ship."""
        loaded = load_weights(located(path, "rong-compact"), RongNet)
        return cls(loaded.network, loaded.card)

    @torch.inference_mode()
    @_one_thread()
    def lens(self, image: ndarray) -> Division:
        """The division model of a picture of any size, centred on it.

        Args:
            image: As for `Predictor.lens`.
        """
        tensor = as_tensor(image)
        height, width = tensor.shape[-2:]
        box = Letterbox(width, height, self.network.cfg.frame)
        lambda_ = float(self.network.estimate(self.network(box.fill(tensor)))[0])
        half = max(width, height) / 2
        return Division(lambda_ / half**2, (width - 1) / 2, (height - 1) / 2, width, height)


def _fast(image: Tensor) -> Tensor:
    return image.contiguous(memory_format=torch.channels_last)


def _spans(length: int) -> list[tuple[int, int]]:
    """Evenly spread tiles over a length, overlapping by at least `_OVERLAP`."""
    if length <= _TILE + _OVERLAP:
        return [(0, length)]
    count = math.ceil((length - _OVERLAP) / (_TILE - _OVERLAP))
    starts = np.linspace(0, length - _TILE, count).round().astype(int)
    return [(int(start), int(start) + _TILE) for start in starts]


def _padded(image: Tensor, multiple: int) -> Tensor:
    """Black to the right and below until the sides divide by `multiple`."""
    height, width = image.shape[-2:]
    pads = (0, -width % multiple, 0, -height % multiple)
    return torch.nn.functional.pad(image, pads)


def _window(height: int, width: int) -> Tensor:
    """Weights that fall towards a tile's edges and stay positive."""

    def ramp(length: int) -> Tensor:
        at = torch.arange(length, dtype=torch.float32)
        edge = torch.minimum(at, length - 1 - at) + 1.0
        return (edge / _OVERLAP).clamp(max=1.0)

    return ramp(height)[:, None] * ramp(width)[None, :]

"""What a real camera does to a clean picture: light, optics, sensor, compression, overlays.

Everything is plain tensor arithmetic per sample, on any device; random numbers come from NumPy, so
a picture is the same wherever it is made.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from learned.polynomial import radius
from learned.slf.optics import Optics
from learned.slf.overlay import draw_overlays

_BLUR_TAPS = 7
_NOISE_BANK = 1 << 20
_BLOCK = 8
# ITU-T T.81, table K.1: quantisation of luminance
_QUANTISATION = (
    (16, 11, 10, 16, 24, 40, 51, 61),
    (12, 12, 14, 19, 26, 58, 60, 55),
    (14, 13, 16, 24, 40, 57, 69, 56),
    (14, 17, 22, 29, 51, 87, 80, 62),
    (18, 22, 37, 56, 68, 109, 103, 77),
    (24, 35, 55, 64, 81, 104, 113, 92),
    (49, 64, 78, 87, 103, 121, 120, 101),
    (72, 92, 95, 98, 112, 100, 103, 99),
)


@dataclass(frozen=True)
class PhotometryCfg:
    """Shares of pictures that get each effect, and how strong it is at most.

    Attributes:
        exposure: Standard deviation of the exposure in stops.
        gamma: Standard deviation of log gamma.
        cast: Standard deviation of the log gain of each colour.
        blur_share: Share of blurred pictures.
        blur_px: Largest standard deviation of the blur in pixels.
        vignette: Largest loss of light at the frame's corner.
        noise: Range of the noise's standard deviation at mid grey.
        jpeg_share: Share of compressed pictures.
        jpeg_quality: Range of the quality.
        halo_share: Share of image circles with a soft edge and a glowing ring.
        surround_share: Share of pictures whose outside is not black.
        overlay_share: Share of pictures with text burnt in.
    """

    exposure: float = 0.35
    gamma: float = 0.15
    cast: float = 0.05
    blur_share: float = 0.4
    blur_px: float = 1.2
    vignette: float = 0.5
    noise: tuple[float, float] = (0.002, 0.04)
    jpeg_share: float = 0.4
    jpeg_quality: tuple[float, float] = (25.0, 95.0)
    halo_share: float = 0.7
    surround_share: float = 0.2
    overlay_share: float = 0.12


def photographed(
    clean: Float[Tensor, "b 3 h w"],
    lens: Optics,
    *,
    rng: np.random.Generator,
    config: PhotometryCfg | None = None,
) -> Float[Tensor, "b 3 h w"]:
    """Turn clean pictures into photographs.

    Args:
        clean: Pictures in [0, 1], black outside the image.
        lens: Their lenses.
        rng: Source of randomness.
        config: Strengths.

    Returns:
        Pictures in [0, 1] rounded to 8 bits.
    """
    config = config or PhotometryCfg()
    image = _blurred(clean, rng, config)
    image = _exposed(image, lens, rng, config)
    image = _edged(image, lens, rng, config)
    image = draw_overlays(image, rng, share=config.overlay_share)
    image = _noisy(image, rng, config)
    image = _compressed(image.clamp_(0, 1), rng, config)
    return image.mul_(255).round_().clamp_(0, 255).div_(255)


def _tensor(value: np.ndarray, like: Tensor) -> Tensor:
    return torch.as_tensor(value, dtype=like.dtype, device=like.device)


def _rows(chosen: np.ndarray, like: Tensor) -> Tensor:
    """Numbers of the chosen samples."""
    return torch.as_tensor(np.nonzero(chosen)[0], device=like.device)


def _blurred(image: Tensor, rng: np.random.Generator, config: PhotometryCfg) -> Tensor:
    batch = len(image)
    chosen = rng.random(batch) < config.blur_share
    sigma = rng.uniform(0.3, config.blur_px, (batch, 1))
    # as often as not a blur of one axis, like motion along a row or column
    motion = rng.random((2, batch, 1)) < 0.2
    if not chosen.any():
        return image
    tap = np.arange(_BLUR_TAPS) - _BLUR_TAPS // 2
    kernels = [np.exp(-0.5 * (tap / np.where(m, 0.15, sigma)) ** 2) for m in motion]
    vertical, horizontal = (
        _tensor(k[chosen] / k[chosen].sum(1, keepdims=True), image).repeat_interleave(3, 0)
        for k in kernels
    )
    rows = _rows(chosen, image)
    part = image[rows]
    flat = part.reshape(1, -1, *part.shape[2:])
    pad = _BLUR_TAPS // 2
    groups = flat.shape[1]
    flat = functional.conv2d(flat, vertical[:, None, :, None], padding=(pad, 0), groups=groups)
    flat = functional.conv2d(flat, horizontal[:, None, None, :], padding=(0, pad), groups=groups)
    out = image.clone()
    out[rows] = flat.view_as(part)
    return out


def _exposed(
    image: Tensor, lens: Optics, rng: np.random.Generator, config: PhotometryCfg
) -> Tensor:
    """Vignetting, exposure, colour cast and gamma."""
    batch = len(image)
    loss = rng.uniform(0, config.vignette, batch) * (rng.random(batch) < 0.6)
    stops = rng.normal(0, config.exposure, (batch, 1)) * np.log(2)
    gain = _tensor(np.exp(stops + rng.normal(0, config.cast, (batch, 3))), image)
    gamma = _tensor(np.exp(rng.normal(0, config.gamma, batch)), image)
    curved = rng.random(batch) < 0.5
    out = image * gain[:, :, None, None]
    rows = _rows(loss > 0, image)
    if len(rows):
        fall = _plane_square(lens[rows], image).mul_(0.5).clamp_max_(1.0)
        fall.mul_(-_tensor(loss, image)[rows, None, None]).add_(1.0)
        out[rows] *= fall[:, None]
    out.clamp_(0, 1)
    # pow is the dearest operation here, and a gamma of 1 is common enough
    rows = _rows(curved, image)
    if len(rows):
        out[rows] = out[rows].pow_(gamma[rows, None, None, None])
    return out


def _edged(image: Tensor, lens: Optics, rng: np.random.Generator, config: PhotometryCfg) -> Tensor:
    """Soft edge and ring of image circles, and what lies outside every image."""
    batch = len(image)
    soft = rng.uniform(0.004, 0.06, batch)
    ring = rng.uniform(0.0, 0.35, (batch, 3)) * rng.uniform(0, 1, (batch, 1))
    ring *= rng.random((batch, 1)) < config.halo_share
    ring_width = rng.uniform(0.004, 0.03, batch)
    surround = np.where(
        rng.random(batch) < 0.75, rng.uniform(0, 0.12, batch), rng.uniform(0, 1, batch)
    )
    surround = surround * (rng.random(batch) < config.surround_share)
    rows = torch.nonzero(torch.isfinite(lens.circle))[:, 0]
    if len(rows):
        # the edge is hard elsewhere, where the frame or the scene ends and not the lens
        inwards, inside_rows = _inwards(lens[rows], image)
        fade = (inwards / _tensor(soft, image)[rows, None, None]).clamp_(0, 1)
        glow = torch.exp(-((inwards / _tensor(ring_width, image)[rows, None, None]) ** 2))
        glow = (glow * inside_rows)[:, None] * _tensor(ring, image)[rows][:, :, None, None]
        image[rows] = image[rows] * fade[:, None] + glow
    rows = _rows(surround > 0, image)
    if len(rows):
        inwards, inside_rows = _inwards(lens[rows], image)
        outside = (inwards < 0) | ~inside_rows
        image[rows] += (outside * _tensor(surround, image)[rows, None, None])[:, None]
    return image


def _inwards(lens: Optics, like: Tensor) -> tuple[Tensor, Tensor]:
    """How far every pixel lies inside the image circle, and whether its row is shown."""
    edge = torch.minimum(radius(lens.theta_max[:, None], lens.vector[:, :5])[:, 0], lens.circle)
    inwards = _plane_square(lens, like).sqrt_().neg_().add_(edge[:, None, None])
    return inwards, _plane_rows(lens, like) <= lens.half_height[:, None, None]


def _noisy(image: Tensor, rng: np.random.Generator, config: PhotometryCfg) -> Tensor:
    """Signal-dependent sensor noise, cut at random places out of a bank."""
    batch, count = len(image), image[0].numel()
    low, high = np.log(config.noise)
    sigma = np.exp(rng.uniform(low, high, batch))
    starts = rng.integers(0, _NOISE_BANK, batch)
    bank = _noise_bank(str(image.device), _NOISE_BANK + count)
    for row, start in enumerate(starts.tolist()):
        level = image[row].clamp_min(0.0).mul_(1.4).add_(0.3).sqrt_().mul_(float(sigma[row]))
        image[row].addcmul_(level, bank[start : start + count].view_as(level))
    return image


@lru_cache(maxsize=4)
def _noise_bank(device: str, count: int) -> Tensor:
    """Standard normal numbers, always the same; their end repeats their beginning."""
    bank = np.random.default_rng(0).standard_normal(_NOISE_BANK, dtype=np.float32)
    return torch.from_numpy(np.resize(bank, count)).to(device)


def _compressed(image: Tensor, rng: np.random.Generator, config: PhotometryCfg) -> Tensor:
    """Quantise 8x8 cosine blocks as JPEG does, on red, green and blue alike."""
    batch = len(image)
    chosen = np.nonzero(rng.random(batch) < config.jpeg_share)[0]
    quality = rng.uniform(*config.jpeg_quality, batch)
    height, width = image.shape[2] // _BLOCK * _BLOCK, image.shape[3] // _BLOCK * _BLOCK
    if len(chosen) == 0 or height == 0 or width == 0:
        return image
    scale = np.where(quality < 50, 50 / quality, 2 - quality / 50)[chosen]
    table = np.maximum(np.array(_QUANTISATION) * scale[:, None, None], 1.0) / 255.0
    step = _tensor(table, image).view(-1, 1, 1, _BLOCK, 1, _BLOCK)
    basis = _tensor(_cosine_basis(), image)
    rows = torch.as_tensor(chosen, device=image.device)
    part = image[rows, :, :height, :width]
    # along rows, then along columns: neither needs another order in memory
    blocks = part.reshape(-1, _BLOCK) @ basis.T
    blocks = torch.matmul(basis, blocks.view(-1, _BLOCK, width))
    blocks = blocks.view(len(rows), 3, height // _BLOCK, _BLOCK, width // _BLOCK, _BLOCK)
    blocks.div_(step).round_().mul_(step)
    blocks = torch.matmul(basis.T, blocks.view(-1, _BLOCK, width))
    image[rows, :, :height, :width] = (blocks.view(-1, _BLOCK) @ basis).view(part.shape)
    return image


def _cosine_basis() -> np.ndarray:
    """Orthonormal type-II cosine transform of eight samples."""
    i = np.arange(_BLOCK)
    basis = np.cos(np.pi * i[:, None] * (2 * i[None] + 1) / (2 * _BLOCK)) * np.sqrt(2 / _BLOCK)
    basis[0] /= np.sqrt(2)
    return basis


def _plane_square(lens: Optics, like: Tensor) -> Tensor:
    """Squared radius of every pixel in the isotropic plane of r(θ)."""
    index = _coordinate(like)
    x = (index - lens.vector[:, 7, None]) / lens.vector[:, 5, None]
    y = (index - lens.vector[:, 8, None]) / lens.vector[:, 6, None]
    return (x * x)[:, None, :] + (y * y)[:, :, None]


def _plane_rows(lens: Optics, like: Tensor) -> Tensor:
    """Distance of every row from the middle of the frame, in half widths."""
    return _coordinate(like).abs()[None, :, None].expand(len(lens), -1, 1)


def _coordinate(like: Tensor) -> Tensor:
    size = like.shape[-1]
    index = torch.arange(size, dtype=like.dtype, device=like.device)
    return (index - (size - 1) / 2) / (size / 2)

"""Sub-pixel edge points: local maxima of the gradient, placed by a parabola.

Canny (PAMI 1986) with the sub-pixel step of Devernay (INRIA RR-2724, 1995). Devernay interpolates
along the gradient between grid points, which biases slanted edges; as in Grompone von Gioi &
Randall (IPOL 2017) we interpolate along the image axis that is nearest to the gradient instead.
Across an ideal blurred edge the gradient is a Gaussian, whose logarithm is a parabola, so the
parabola is put through logarithms and the position is exact there.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

_BORDER = 2  # pixels at the frame where neither gradient nor neighbours are whole
_TINY = 1e-6


@dataclass(frozen=True)
class EdgeConfig:
    """What counts as an edge.

    Attributes:
        sigma: Standard deviation of the Gaussian before differentiation, pixels.
        min_contrast: Smallest step of an edge, grey levels of 255.
        noise_factor: Edges are also this many times above the median gradient of the picture.
        max_density: At most this share of pixels become edge points; the weakest are dropped.
    """

    sigma: float = 1.2
    min_contrast: float = 6.0
    noise_factor: float = 2.0
    max_density: float = 0.08


@dataclass(frozen=True)
class EdgePoints:
    """Points on edges or ridges, not yet in order.

    Attributes:
        points: Pixels (u, v), shape (n, 2).
        normals: Unit vectors across the edge, towards brighter pixels for edges, shape (n, 2).
        contrast: Height of the step in grey levels, or of the ridge, shape (n,).
        cells: Flat index of the pixel that each point belongs to, no two alike, shape (n,).
        height: Rows of the picture.
        width: Columns of the picture.
    """

    points: Float[np.ndarray, "n 2"]
    normals: Float[np.ndarray, "n 2"]
    contrast: Float[np.ndarray, " n"]
    cells: Int[np.ndarray, " n"]
    height: int
    width: int

    def chosen(self, keep: Bool[np.ndarray, " n"]) -> EdgePoints:
        """The points for which `keep` holds."""
        return EdgePoints(
            self.points[keep],
            self.normals[keep],
            self.contrast[keep],
            self.cells[keep],
            self.height,
            self.width,
        )


def detect_edges(
    grey: Float[np.ndarray, "h w"], *, config: EdgeConfig = EdgeConfig()
) -> EdgePoints:
    """Find the edge points of a picture.

    Args:
        grey: Picture in grey levels 0…255, float32.
        config: What counts as an edge.

    Returns:
        Edge points, at most one a pixel; sparse enough to be linked.
    """
    height, width = grey.shape
    if min(height, width) < 2 * _BORDER + 3:
        return empty_edge_points(height, width)
    du, dv, norm = gradient(grey, config.sigma)
    to_contrast = step_per_gradient(config.sigma)
    median = float(np.median(norm[::4, ::4]))
    threshold = max(config.min_contrast / to_contrast, config.noise_factor * median)
    cells, shift_u, shift_v = _local_maxima(du, dv, norm, max(threshold, _TINY))
    strength = norm.ravel()[cells]
    most = max(1000, int(config.max_density * grey.size))
    if len(cells) > most:
        keep = strength >= np.partition(strength, len(cells) - most)[len(cells) - most]
        cells, strength = cells[keep], strength[keep]
        shift_u, shift_v = shift_u[keep], shift_v[keep]
    row = cells // width
    points = np.stack([cells - row * width + shift_u, row + shift_v], axis=1)
    normals = np.stack([du.ravel()[cells] / strength, dv.ravel()[cells] / strength], axis=1)
    return EdgePoints(
        points,
        normals.astype(np.float64),
        strength.astype(np.float64) * to_contrast,
        cells,
        height,
        width,
    )


def gradient(grey: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Derivatives along u and v of the blurred picture and their norm, grey levels a pixel."""
    smooth = cv2.GaussianBlur(grey, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    du, dv = np.zeros_like(smooth), np.zeros_like(smooth)  # as they are at the frame
    np.subtract(smooth[:, 2:], smooth[:, :-2], out=du[:, 1:-1])
    np.subtract(smooth[2:], smooth[:-2], out=dv[1:-1])
    du *= 0.5
    dv *= 0.5
    # not cv2.magnitude, whose last bit depends on where the arrays lie in memory
    norm = du * du
    norm += dv * dv
    return du, dv, np.sqrt(norm, out=norm)


def step_per_gradient(sigma: float) -> float:
    """Height of a sharp step whose measured gradient is 1, grey levels.

    The pixel (variance 1/12) and the difference over two pixels (1/3) blur as the Gaussian does.
    """
    return float(np.sqrt(2 * np.pi * (sigma**2 + 5 / 12)))


def empty_edge_points(height: int, width: int) -> EdgePoints:
    """No points at all."""
    none = np.empty((0, 2))
    return EdgePoints(none, none, np.empty(0), np.empty(0, dtype=np.int64), height, width)


def _local_maxima(
    du: np.ndarray, dv: np.ndarray, norm: np.ndarray, threshold: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cells above the threshold that are maxima along the axis nearest to the gradient.

    Returns:
        Flat indices of the cells, none at the frame, and their sub-pixel shifts along u and v.
    """
    inner = slice(_BORDER, -_BORDER)
    before, after = slice(_BORDER - 1, -_BORDER - 1), slice(_BORDER + 1, 1 - _BORDER)
    centre = norm[inner, inner]
    along_u = np.abs(du[inner, inner]) >= np.abs(dv[inner, inner])
    across = (centre > norm[inner, before]) & (centre >= norm[inner, after])
    down = (centre > norm[before, inner]) & (centre >= norm[after, inner])
    peak = np.zeros(norm.shape, dtype=bool)
    peak[inner, inner] = (centre > threshold) & ((across & along_u) | (down & ~along_u))
    cells = np.flatnonzero(peak)
    flat, horizontal = norm.ravel(), along_u[peak[inner, inner]]
    step = np.where(horizontal, 1, norm.shape[1])
    low, middle, high = (
        np.log(flat[place] + _TINY) for place in (cells - step, cells, cells + step)
    )
    shift = 0.5 * (low - high) / np.minimum(low - 2 * middle + high, -_TINY)
    shift = np.clip(shift, -0.5, 0.5)
    return cells, np.where(horizontal, shift, 0.0), np.where(horizontal, 0.0, shift)

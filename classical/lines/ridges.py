"""Centre lines of a heatmap: sub-pixel ridge points after Steger (PAMI 1998).

On a ridge the second derivative across is strongly negative and the first derivative across
vanishes; a second-order Taylor polynomial gives the place of the zero inside the pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from classical.lines.edges import EdgePoints, empty_edge_points

_REACH = 0.6  # pixels from a pixel's centre that its ridge point may lie off
_TINY = 1e-9


@dataclass(frozen=True)
class RidgeConfig:
    """What counts as a ridge; lengths in pixels of the heatmap.

    Attributes:
        sigma: Standard deviation of the Gaussian before differentiation; about w / √12 for lines of
            width w, a little more against noise.
        min_heat: Smallest smoothed heat on a ridge, as a share of the heatmap's peak …
        min_heat_absolute: … and in units of the heatmap; the larger counts.
    """

    sigma: float = 1.2
    min_heat: float = 0.12
    min_heat_absolute: float = 0.04


def detect_ridges(
    heatmap: Float[np.ndarray, "h w"], *, config: RidgeConfig = RidgeConfig()
) -> EdgePoints:
    """Find the ridge points of a heatmap.

    Args:
        heatmap: Heat per pixel, high on lines, any non-negative scale.
        config: What counts as a ridge.

    Returns:
        Ridge points in pixels of the heatmap; the sign of their normals means nothing and their
        contrast is the smoothed heat.
    """
    height, width = heatmap.shape
    if min(height, width) < 5:
        return empty_edge_points(height, width)
    heat, threshold = smoothed_heat(heatmap, config)
    hot = heat > threshold
    hot[:2] = hot[-2:] = hot[:, :2] = hot[:, -2:] = False
    cells = np.flatnonzero(hot)
    if not len(cells):
        return empty_edge_points(height, width)
    du, dv, duu, duv, dvv = _derivatives(heat.ravel().astype(np.float64), cells, width)
    # eigenvector of the most negative second derivative
    half_difference, half_sum = (duu - dvv) / 2, (duu + dvv) / 2
    root = np.hypot(half_difference, duv)
    across = half_sum - root
    angle = 0.5 * np.arctan2(duv, half_difference) + np.pi / 2
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    slope = normals[:, 0] * du + normals[:, 1] * dv
    shift = -slope / np.minimum(across, -_TINY)
    offset = normals * shift[:, None]
    # a ridge falls off faster across than it bends along
    inside = np.abs(offset).max(axis=1) <= _REACH
    ridge = (across < -_TINY) & inside & (np.abs(across) > 1.5 * np.abs(half_sum + root))
    cells, offset, normals = cells[ridge], offset[ridge], normals[ridge]
    points = np.stack([cells % width, cells // width], axis=1) + offset
    contrast = heat.ravel()[cells].astype(np.float64)
    return EdgePoints(points, normals, contrast, cells, height, width)


def smoothed_heat(
    heatmap: Float[np.ndarray, "h w"], config: RidgeConfig
) -> tuple[Float[np.ndarray, "h w"], float]:
    """The blurred heatmap, float32, and the heat above which a pixel is hot."""
    heat = cv2.GaussianBlur(
        heatmap.astype(np.float32), (0, 0), config.sigma, borderType=cv2.BORDER_CONSTANT
    )
    return heat, max(config.min_heat * float(heat.max()), config.min_heat_absolute)


def _derivatives(heat: np.ndarray, cells: np.ndarray, width: int) -> tuple[np.ndarray, ...]:
    """First and second central differences at cells of a flat picture."""
    centre = heat[cells]
    left, right = heat[cells - 1], heat[cells + 1]
    up, down = heat[cells - width], heat[cells + width]
    diagonal = heat[cells + width + 1] + heat[cells - width - 1]
    diagonal = diagonal - heat[cells + width - 1] - heat[cells - width + 1]
    return (
        (right - left) / 2,
        (down - up) / 2,
        right - 2 * centre + left,
        diagonal / 4,
        down - 2 * centre + up,
    )

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
    heat_of_pixels = heat.ravel().astype(np.float64)
    duu, duv, dvv = _second_derivatives(heat_of_pixels, cells, width)
    # the most negative second derivative; a ridge falls off faster across than it bends along
    half_difference, half_sum = (duu - dvv) / 2, (duu + dvv) / 2
    root = np.sqrt(half_difference * half_difference + duv * duv)
    across = half_sum - root
    ridge = (across < -_TINY) & (np.abs(across) > 1.5 * np.abs(half_sum + root))
    cells, across = cells[ridge], across[ridge]
    # its eigenvector
    angle = 0.5 * np.arctan2(duv[ridge], half_difference[ridge]) + np.pi / 2
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    du, dv = _first_derivatives(heat_of_pixels, cells, width)
    slope = normals[:, 0] * du + normals[:, 1] * dv
    shift = -slope / np.minimum(across, -_TINY)
    offset = normals * shift[:, None]
    inside = np.abs(offset).max(axis=1) <= _REACH
    cells, offset, normals = cells[inside], offset[inside], normals[inside]
    points = np.stack([cells % width, cells // width], axis=1) + offset
    contrast = heat_of_pixels[cells]
    return EdgePoints(points, normals, contrast, cells, height, width)


def smoothed_heat(
    heatmap: Float[np.ndarray, "h w"], config: RidgeConfig
) -> tuple[Float[np.ndarray, "h w"], float]:
    """The blurred heatmap, float32, and the heat above which a pixel is hot."""
    heat = cv2.GaussianBlur(
        heatmap.astype(np.float32), (0, 0), config.sigma, borderType=cv2.BORDER_CONSTANT
    )
    return heat, max(config.min_heat * float(heat.max()), config.min_heat_absolute)


def _first_derivatives(
    heat: np.ndarray, cells: np.ndarray, width: int
) -> tuple[np.ndarray, np.ndarray]:
    """Central differences along u and v at cells of a flat picture."""
    return (heat[cells + 1] - heat[cells - 1]) / 2, (heat[cells + width] - heat[cells - width]) / 2


def _second_derivatives(
    heat: np.ndarray, cells: np.ndarray, width: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Second central differences (uu, uv, vv) at cells of a flat picture."""
    centre = heat[cells]
    diagonal = heat[cells + (width + 1)] + heat[cells - (width + 1)]
    diagonal = diagonal - heat[cells + (width - 1)] - heat[cells - (width - 1)]
    return (
        heat[cells + 1] - 2 * centre + heat[cells - 1],
        diagonal / 4,
        heat[cells + width] - 2 * centre + heat[cells - width],
    )

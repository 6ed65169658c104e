"""What every camera offers, and the conventions that all of them share.

Pixels are (u, v) with the centre of the top-left pixel at (0, 0), as in `cv2.remap`. Rays are unit
vectors with x to the right, y down and z forward; an angle past 90° has z < 0 and is ordinary.
Each mapping returns its values and a mask `valid`; an invalid entry holds a finite stand-in.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float


@runtime_checkable
class Camera(Protocol):
    """A central camera: every pixel looks along one ray through one centre."""

    @property
    def width(self) -> int:
        """Width of the picture in pixels."""
        ...

    @property
    def height(self) -> int:
        """Height of the picture in pixels."""
        ...

    def project(
        self, rays: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        """Map rays to pixels."""
        ...

    def unproject(
        self, points: Float[np.ndarray, "n 2"]
    ) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
        """Map pixels to unit rays."""
        ...


def pixel_grid(width: int, height: int) -> Float[np.ndarray, "n 2"]:
    """Centres of all pixels, row by row, shape (width * height, 2)."""
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    return np.stack([u.ravel(), v.ravel()], axis=1)


def check_size(width: int, height: int) -> None:
    """Raise ValueError unless the picture has at least one pixel."""
    if width < 1 or height < 1:
        raise ValueError(f"Expected a picture size of at least 1x1 pixels, got {width}x{height}.")


def check_points(name: str, points: np.ndarray, columns: int) -> None:
    """Raise ValueError unless `points` has shape (n, columns)."""
    if points.ndim != 2 or points.shape[1] != columns:
        raise ValueError(f"Expected {name} of shape (n, {columns}), got {points.shape}.")

"""Other radially symmetric cameras as Kannala–Brandt lenses, as near as five coefficients come."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from classical.camera.base import Camera
from classical.camera.kannala_brandt import N_COEFFICIENTS, KannalaBrandt

_SAMPLES = 128


@runtime_checkable
class CentredCamera(Camera, Protocol):
    """A camera that is symmetric about its principal point."""

    @property
    def u0(self) -> float:
        """Principal point, pixels."""
        ...

    @property
    def v0(self) -> float:
        """Principal point, pixels."""
        ...


def radial_coefficients(
    theta: Float[np.ndarray, " n"], radius: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " 5"]:
    """The k1..k5 whose r(θ) comes nearest to the given radii, by linear least squares."""
    powers = theta[:, None] ** (2 * np.arange(N_COEFFICIENTS) + 1)
    return np.linalg.lstsq(powers, radius, rcond=1e-10)[0]


def nearest_kannala_brandt(camera: CentredCamera) -> KannalaBrandt:
    """The Kannala–Brandt lens that sees a camera's picture most alike.

    Args:
        camera: A camera with square pixels, symmetric about (u0, v0), such as `Division`.

    Raises:
        ValueError: If the camera sees nothing, or its angles do not grow from the centre outwards.
    """
    corners = [(u, v) for u in (0.0, camera.width - 1.0) for v in (0.0, camera.height - 1.0)]
    farthest = max(np.hypot(u - camera.u0, v - camera.v0) for u, v in corners)
    radius = farthest * (np.arange(_SAMPLES) + 1) / _SAMPLES
    points = np.column_stack([camera.u0 + radius, np.full(_SAMPLES, camera.v0)])
    rays, valid = camera.unproject(points)
    theta = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    if not valid[0] or (np.diff(theta[valid]) <= 0).any():
        raise ValueError("Expected a camera whose angles grow outwards, got one that folds back.")
    half = camera.width / 2
    k = radial_coefficients(theta[valid], radius[valid] / half)
    return KannalaBrandt(k, half, half, camera.u0, camera.v0, camera.width, camera.height)

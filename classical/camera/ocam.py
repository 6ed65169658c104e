"""Scaramuzza's omnidirectional camera: a polynomial for the way out, another for the way back.

The ray of a point at the distance ρ from the centre is (x, y, f(ρ)), f(ρ) = a0 + a1 ρ + a2 ρ² + …
(Scaramuzza et al., ICVS 2006). As in OCamCalib, f is negative in front of the camera, and the way
back is a second polynomial ρ(ψ) in the elevation ψ = arctan(f / ρ), fitted to the first.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from classical.camera.base import check_points, check_size

_NODES = 1024
_SLACK = 1e-4  # radians; the two polynomials differ by a little


@dataclass(frozen=True, eq=False)
class Ocam:
    """A camera as the program OCamCalib describes it, without shear.

    Attributes:
        direct: Coefficients a0, a1, … of f(ρ), ρ in pixels along u.
        inverse: Coefficients of ρ(ψ) in pixels, ψ in radians.
        u0: Centre, pixels.
        v0: Centre, pixels.
        stretch: Pixels along v for one along u (OCamCalib's affine parameter c).
        width: Picture width in pixels.
        height: Picture height in pixels.
    """

    direct: Float[np.ndarray, " n"]
    inverse: Float[np.ndarray, " m"]
    u0: float
    v0: float
    stretch: float
    width: int
    height: int

    def __post_init__(self) -> None:
        check_size(self.width, self.height)
        numbers = np.concatenate([self.direct, self.inverse, [self.u0, self.v0, self.stretch]])
        if not np.isfinite(numbers).all():
            raise ValueError("Expected finite camera parameters, got a NaN or an infinity.")
        if not (len(self.direct) and self.direct[0] < 0 and self.stretch > 0):
            raise ValueError("Expected a camera that looks forward: a0 < 0 and a stretch over 0.")

    @cached_property
    def radius_max(self) -> float:
        """Distance from the centre up to which angles grow, at most the far corner's; pixels."""
        corners = [(u, v) for u in (0.0, self.width) for v in (0.0, self.height)]
        farthest = max(np.hypot(u - self.u0, (v - self.v0) / self.stretch) for u, v in corners)
        radius = np.linspace(0.0, float(farthest), _NODES)
        falls = np.flatnonzero(np.diff(np.arctan2(radius, self._forward(radius))) <= 0)
        return float(radius[falls[0]] if len(falls) else radius[-1])

    def project(
        self, rays: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        """Map rays to pixels by the inverse polynomial, as OCamCalib's world2cam does.

        Valid up to the angle that the direct polynomial has at `radius_max`.
        """
        check_points("rays", rays, 3)
        across = np.hypot(rays[:, 0], rays[:, 1])
        elevation = np.arctan2(-rays[:, 2], across)
        radius = np.polynomial.polynomial.polyval(elevation, self.inverse)
        scale = np.where(across > 0, radius, 0.0) / np.where(across > 0, across, 1.0)
        points = rays[:, :2] * scale[:, None] * [1.0, self.stretch] + [self.u0, self.v0]
        widest = np.arctan2(-self._forward(np.array([self.radius_max])), self.radius_max)
        return points, np.asarray(elevation <= widest + _SLACK)

    def unproject(
        self, points: Float[np.ndarray, "n 2"]
    ) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
        """Map pixels to unit rays by the direct polynomial; valid up to `radius_max`."""
        check_points("points", points, 2)
        x, y = points[:, 0] - self.u0, (points[:, 1] - self.v0) / self.stretch
        radius = np.hypot(x, y)
        rays = np.stack([x, y, self._forward(radius)], axis=1)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return rays, np.asarray(radius <= self.radius_max)

    def _forward(self, radius: np.ndarray) -> np.ndarray:
        """The ray's part along the optical axis, −f(ρ)."""
        return -np.polynomial.polynomial.polyval(radius, self.direct)

"""Rays of pixels and how they turn from pixel to pixel, as flat arrays for the fit.

With (x, y) the offset from the principal point in units of r and ρ its length, a radially symmetric
lens sees ray = (A x, A y, C), A = sin θ / ρ and C = cos θ. All derivatives come from the functions
P = A'/ρ and Q = C'/ρ of the radius: ∂ray/∂(x, y) = (A I + P q qᵀ; Q qᵀ) with q = (x, y).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from classical.camera.kannala_brandt import KannalaBrandt

_LEAST_RADIUS = 1e-4  # half widths; the radial functions are even, so the axis may be nudged
_LEAST_SLOPE = 1e-6


class RayField(NamedTuple):
    """Rays at n pixels in parts; one array a part.

    Attributes:
        x: Offset from the principal point over m_u.
        y: Offset over m_v.
        radius: ρ, at least a little.
        theta: θ(ρ) in radians; of the widest ray where not reached.
        slope: dθ/dρ.
        sine: sin θ.
        A: sin θ / ρ.
        C: cos θ.
        P: A'/ρ.
        Q: C'/ρ.
        m_u: Pixels per unit along u.
        m_v: Pixels per unit along v.
    """

    x: Float[np.ndarray, " n"]
    y: Float[np.ndarray, " n"]
    radius: Float[np.ndarray, " n"]
    theta: Float[np.ndarray, " n"]
    slope: Float[np.ndarray, " n"]
    sine: Float[np.ndarray, " n"]
    A: Float[np.ndarray, " n"]
    C: Float[np.ndarray, " n"]
    P: Float[np.ndarray, " n"]
    Q: Float[np.ndarray, " n"]
    m_u: float
    m_v: float

    @classmethod
    def of_angles(
        cls,
        plane: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]],
        radius: Float[np.ndarray, " n"],
        theta: Float[np.ndarray, " n"],
        slope: Float[np.ndarray, " n"],
        scale: tuple[float, float],
    ) -> RayField:
        """The field of any radial function, from θ and dθ/dρ at each pixel.

        Args:
            plane: x and y.
            radius: ρ, as `plane_radius` gives it.
            theta: θ(ρ), radians.
            slope: dθ/dρ.
            scale: m_u and m_v, pixels.
        """
        sine, cosine = np.sin(theta), np.cos(theta)
        A = sine / radius
        P = cosine * slope
        P -= A
        P /= radius * radius
        return cls(*plane, radius, theta, slope, sine, A, cosine, P, -A * slope, *scale)

    def jacobian(self) -> Float[np.ndarray, "n 3 2"]:
        """∂ray/∂(u, v)."""
        x, y, P = self.x, self.y, self.P
        out = np.empty((len(x), 3, 2))
        out[:, 0, 0], out[:, 1, 1] = P * x * x + self.A, P * y * y + self.A
        out[:, 0, 1] = out[:, 1, 0] = P * x * y
        out[:, 2, 0], out[:, 2, 1] = self.Q * x, self.Q * y
        out /= (self.m_u, self.m_v)
        return out

    def rays(self) -> Float[np.ndarray, "n 3"]:
        """Unit rays."""
        return np.stack([self.A * self.x, self.A * self.y, self.C], axis=1)


def plane_radius(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """ρ of plane points, kept off zero."""
    return np.maximum(np.sqrt(x * x + y * y), _LEAST_RADIUS)


def ray_field(
    camera: KannalaBrandt, u: Float[np.ndarray, " n"], v: Float[np.ndarray, " n"]
) -> tuple[RayField, Bool[np.ndarray, " n"]]:
    """The rays of pixels (u, v), and where the lens reaches the pixel."""
    x, y = (u - camera.u0) / camera.m_u, (v - camera.v0) / camera.m_v
    radius = plane_radius(x, y)
    theta, reached = camera.theta(radius)
    slope = 1 / np.maximum(camera.radius_derivative(theta), _LEAST_SLOPE)
    scale = (float(camera.m_u), float(camera.m_v))
    return RayField.of_angles((x, y), radius, theta, slope, scale), reached

"""Residuals of pixels that a lens does not reach: how far they lie outside what it shows."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from classical.camera import KannalaBrandt
from classical.camera.ray_field import RayField


def overshoot(camera: KannalaBrandt, field: RayField) -> Float[np.ndarray, " n"]:
    """Distance of pixels to the circle that the lens reaches, pixels; negative inside."""
    reach = camera.radius(np.array([camera.theta_max]))[0]
    return (field.radius - reach) * camera.m_u


def overshoot_jacobian(camera: KannalaBrandt, field: RayField) -> Float[np.ndarray, "9 n"]:
    """∂overshoot/∂(k1..k5, m_u, m_v, u0, v0); r' vanishes at θ_max, so θ_max counts as fixed."""
    out = np.empty((9, len(field.x)))
    out[:5] = -camera.m_u * camera.radius_jacobian(np.array([camera.theta_max])).T
    across, down = field.x / field.radius, field.y / field.radius * (camera.m_u / camera.m_v)
    out[5] = overshoot(camera, field) / camera.m_u - across * field.x
    out[6] = -down * field.y
    out[7], out[8] = -across, -down
    return out

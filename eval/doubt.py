"""What a camera's covariance means in the picture: the expected error of each rectified pixel."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from classical.camera import KannalaBrandt
from eval.frame import frame_size
from eval.metrics import FRAME_FOCAL, THETA_CAP, polar_angle

_STEP = 4  # pixels of the frame between samples


def expected_error(
    camera: KannalaBrandt, covariance: Float[ndarray, "9 9"]
) -> Float[ndarray, "rows columns"]:
    """Standard deviation of the rectified position, to first order.

    Args:
        camera: The estimated camera of the photograph.
        covariance: Of `camera.to_vector()`.

    Returns:
        sqrt(trace(J Σ Jᵀ)) in pixels of the 320 px frame, every fourth pixel of that frame, J being
        the derivative of 160 tan θ (cos φ, sin φ) by the camera's parameters at the photograph's
        pixel that is shown there; NaN where the photograph has none.
    """
    width, height = frame_size(camera.width, camera.height)
    u, v = np.meshgrid(np.arange(0, width, _STEP), np.arange(0, height, _STEP))
    place = np.stack([u - (width - 1) / 2, v - (height - 1) / 2], axis=-1).reshape(-1, 2)
    rays = np.column_stack([place, np.full(len(place), FRAME_FOCAL)])
    points, seen = camera.project(rays / np.linalg.norm(rays, axis=1, keepdims=True))
    inside = (points >= -0.5) & (points <= [camera.width - 0.5, camera.height - 0.5])
    jacobian = camera.unproject_jacobian(points)
    shown = seen & inside.all(axis=1) & jacobian.valid & (polar_angle(jacobian.rays) < THETA_CAP)
    depth = np.where(shown, jacobian.rays[:, 2], 1.0)[:, None, None]
    across, along = jacobian.by_parameters[:, :2], jacobian.by_parameters[:, 2:]
    by_plane = across / depth - jacobian.rays[:, :2, None] * along / depth**2
    J = FRAME_FOCAL * by_plane
    variance = np.einsum("nij,jk,nik->n", J, covariance, J)
    error = np.sqrt(np.maximum(variance, 0.0))
    return np.where(shown, error, np.nan).reshape(u.shape)

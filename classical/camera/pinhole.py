"""The pinhole camera: r(θ) = f tan θ, the rectilinear target of every rectification."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from classical.camera.base import check_points, check_size


@dataclass(frozen=True)
class Pinhole:
    """A rectilinear camera without distortion.

    Attributes:
        focal_u: Focal length along u in pixels.
        focal_v: Focal length along v in pixels.
        u0: Principal point, pixels.
        v0: Principal point, pixels.
        width: Picture width in pixels.
        height: Picture height in pixels.
    """

    focal_u: float
    focal_v: float
    u0: float
    v0: float
    width: int
    height: int

    def __post_init__(self) -> None:
        check_size(self.width, self.height)
        if not (np.isfinite([self.focal_u, self.focal_v, self.u0, self.v0]).all()):
            raise ValueError("Expected finite pinhole parameters, got a NaN or an infinity.")
        if self.focal_u <= 0 or self.focal_v <= 0:
            raise ValueError(
                f"Expected positive focal lengths, got {self.focal_u} and {self.focal_v}."
            )

    @classmethod
    def centred(cls, focal: float, width: int, height: int) -> Pinhole:
        """Square pixels and the principal point in the middle of the picture."""
        return cls(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height)

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """The calibration matrix K."""
        return np.array(
            [[self.focal_u, 0.0, self.u0], [0.0, self.focal_v, self.v0], [0.0, 0.0, 1.0]]
        )

    @property
    def horizontal_fov(self) -> float:
        """Angle between the left and the right edge of the picture, radians."""
        left, right = (self.u0 + 0.5) / self.focal_u, (self.width - 0.5 - self.u0) / self.focal_u
        return float(np.arctan(left) + np.arctan(right))

    def project(
        self, rays: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        """Map rays to pixels; valid in front of the camera (z > 0)."""
        check_points("rays", rays, 3)
        valid = np.asarray(rays[:, 2] > 0)
        depth = np.where(valid, rays[:, 2], 1.0)
        points = np.stack(
            [
                self.focal_u * rays[:, 0] / depth + self.u0,
                self.focal_v * rays[:, 1] / depth + self.v0,
            ],
            axis=1,
        )
        return points, valid

    def unproject(
        self, points: Float[np.ndarray, "n 2"]
    ) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
        """Map pixels to unit rays; every finite pixel is valid."""
        check_points("points", points, 2)
        x = (points[:, 0] - self.u0) / self.focal_u
        y = (points[:, 1] - self.v0) / self.focal_v
        rays = np.stack([x, y, np.ones_like(x)], axis=1)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return rays, np.asarray(np.isfinite(points).all(axis=1))

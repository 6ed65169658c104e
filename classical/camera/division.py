"""The one-parameter division model of Fitzgibbon (CVPR 2001)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from classical.camera.base import check_points, check_size


@dataclass(frozen=True)
class Division:
    """Undistorted point = c + (x − c) / (1 + λ r²), with r the distance to c in pixels.

    The model knows the shape of the distortion and no focal length. `focal` is therefore a stated
    convention, by default half the picture's width (f = 160 px in a 320 px frame); the ray of a
    pixel is (x, y, focal (1 + λ r²)) normalised, which also runs past 90°.

    Attributes:
        lambda_: Distortion parameter λ in 1/px²; negative for barrel distortion.
        u0: Centre of distortion, pixels.
        v0: Centre of distortion, pixels.
        width: Picture width in pixels.
        height: Picture height in pixels.
        focal: Assumed focal length in pixels; None means width / 2.
    """

    lambda_: float
    u0: float
    v0: float
    width: int
    height: int
    focal: float | None = None

    def __post_init__(self) -> None:
        check_size(self.width, self.height)
        if not np.isfinite([self.lambda_, self.u0, self.v0]).all():
            raise ValueError("Expected finite division parameters, got a NaN or an infinity.")
        if self.focal is not None and not self.focal > 0:
            raise ValueError(f"Expected a positive focal length, got {self.focal}.")

    @property
    def focal_px(self) -> float:
        """The focal length in use, pixels."""
        return self.width / 2 if self.focal is None else self.focal

    def project(
        self, rays: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        """Map rays to pixels, the closed-form inverse of `unproject`.

        Solves r / (f (1 + λ r²)) = tan θ for the root that grows from the axis; for λ > 0 angles
        past its turning point are invalid.
        """
        check_points("rays", rays, 3)
        f = self.focal_px
        norm = np.linalg.norm(rays, axis=1)
        norm = np.where(norm > 0, norm, 1.0)
        sine = np.hypot(rays[:, 0], rays[:, 1]) / norm
        cosine = rays[:, 2] / norm
        discriminant = cosine**2 - 4 * self.lambda_ * f**2 * sine**2
        denominator = cosine + np.sqrt(np.maximum(discriminant, 0.0))
        valid = np.asarray((discriminant >= 0) & (denominator > 1e-12))
        scale = 2 * f / np.where(valid, denominator, 1.0) / norm
        points = np.stack([rays[:, 0] * scale + self.u0, rays[:, 1] * scale + self.v0], axis=1)
        return points, valid

    def unproject(
        self, points: Float[np.ndarray, "n 2"]
    ) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
        """Map pixels to unit rays; for λ > 0 pixels past the turning point are invalid."""
        check_points("points", points, 2)
        x, y = points[:, 0] - self.u0, points[:, 1] - self.v0
        squared = x**2 + y**2
        rays = np.stack([x, y, self.focal_px * (1 + self.lambda_ * squared)], axis=1)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return rays, np.asarray(self.lambda_ * squared <= 1) & np.isfinite(points).all(axis=1)

    def undistort(
        self, points: Float[np.ndarray, "n 2"]
    ) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        """Straighten pixels in the plane of the picture; valid where 1 + λ r² > 0."""
        check_points("points", points, 2)
        centre = np.array([self.u0, self.v0])
        offset = points - centre
        factor = 1 + self.lambda_ * (offset**2).sum(axis=1)
        valid = np.asarray(factor > 1e-12)
        return centre + offset / np.where(valid, factor, 1.0)[:, None], valid

    def distort(
        self, points: Float[np.ndarray, "n 2"]
    ) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        """Bend undistorted pixels; the inverse of `undistort`."""
        check_points("points", points, 2)
        offset = points - np.array([self.u0, self.v0])
        rays = np.column_stack([offset, np.full(len(offset), self.focal_px)])
        return self.project(rays)

"""The two-parameter division model of Santana-Cedrés et al. (SIIMS 8, 2015; IPOL 6, 2016)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from classical.camera import Division

_TABLE = 2048
_NEWTON_STEPS = 12


@dataclass(frozen=True)
class TwoParameterDivision:
    """Undistorted point = c + (x − c) / (1 + k1 r² + k2 r⁴), r the distance to c in pixels.

    As with `Division` the focal length is a stated convention: the ray of a pixel is
    (x, y, focal (1 + k1 r² + k2 r⁴)), normalised.

    Attributes:
        k1: First parameter, 1/px².
        k2: Second parameter, 1/px⁴.
        u0: Centre of distortion, pixels.
        v0: Centre of distortion, pixels.
        width: Picture width in pixels.
        height: Picture height in pixels.
        focal: Assumed focal length in pixels; None means width / 2.
    """

    k1: float
    k2: float
    u0: float
    v0: float
    width: int
    height: int
    focal: float | None = None

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise ValueError(
                f"Expected a picture of 1x1 px or more, got {self.width}x{self.height}."
            )
        if not np.isfinite([self.k1, self.k2, self.u0, self.v0]).all():
            raise ValueError("Expected finite division parameters, got a NaN or an infinity.")
        if self.focal is not None and not self.focal > 0:
            raise ValueError(f"Expected a positive focal length, got {self.focal}.")

    @property
    def focal_px(self) -> float:
        """The focal length in use, pixels."""
        return self.width / 2 if self.focal is None else self.focal

    @property
    def corner_radius(self) -> float:
        """Distance from the centre to the farthest corner, pixels."""
        return farthest_corner(self.u0, self.v0, self.width, self.height)

    @property
    def is_invertible(self) -> bool:
        """Whether the undistorted radius grows from the centre to the farthest corner."""
        return is_invertible(self.k1, self.k2, self.corner_radius)

    def undistort(
        self, points: Float[np.ndarray, "n 2"]
    ) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        """Straighten pixels; valid where the factor is positive and the mapping still grows."""
        offset = _checked(points, 2) - np.array([self.u0, self.v0])
        factor, growth = self._factor((offset**2).sum(axis=1))
        valid = np.asarray((factor > 1e-12) & (growth > 0))
        moved = offset / np.where(valid, factor, 1.0)[:, None]
        return moved + np.array([self.u0, self.v0]), valid

    def distort(
        self, points: Float[np.ndarray, "n 2"]
    ) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        """Bend undistorted pixels; the inverse of `undistort`."""
        offset = _checked(points, 2) - np.array([self.u0, self.v0])
        return self.project(np.column_stack([offset, np.full(len(offset), self.focal_px)]))

    def unproject(
        self, points: Float[np.ndarray, "n 2"]
    ) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
        """Map pixels to unit rays; pixels past the turning point of the mapping are invalid."""
        offset = _checked(points, 2) - np.array([self.u0, self.v0])
        factor, growth = self._factor((offset**2).sum(axis=1))
        rays = np.column_stack([offset, self.focal_px * factor])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return rays, np.asarray(growth > 0) & np.isfinite(points).all(axis=1)

    def project(
        self, rays: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        """Map rays to pixels: the root of r cos θ = f (1 + k1 r² + k2 r⁴) sin θ, by Newton.

        A table of the angle over the radius gives the start; angles past its end are invalid.
        """
        _checked(rays, 3)
        sine = np.hypot(rays[:, 0], rays[:, 1])
        theta = np.arctan2(sine, rays[:, 2])
        radii, angles = self._table()
        radius = np.interp(theta, angles, radii)
        for _ in range(_NEWTON_STEPS):
            factor, _ = self._factor(radius**2)
            slope = self.focal_px * (2 * self.k1 * radius + 4 * self.k2 * radius**3)
            value = radius * np.cos(theta) - self.focal_px * factor * np.sin(theta)
            derivative = np.cos(theta) - slope * np.sin(theta)
            safe = np.where(np.abs(derivative) > 1e-12, derivative, 1.0)
            radius = np.clip(radius - value / safe, 0.0, radii[-1])
        scale = radius / np.where(sine > 0, sine, 1.0)
        points = rays[:, :2] * scale[:, None] + np.array([self.u0, self.v0])
        return points, np.asarray(theta <= angles[-1]) & np.isfinite(rays).all(axis=1)

    def _factor(self, squared: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """1 + k1 r² + k2 r⁴, and 1 − k1 r² − 3 k2 r⁴, which has the sign of the growth."""
        first, second = self.k1 * squared, self.k2 * squared**2
        return 1.0 + first + second, 1.0 - first - 3.0 * second

    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        """Radii and ray angles from the centre to twice the corner, or to the turning point."""
        radii = np.linspace(0.0, 2.0 * self.corner_radius, _TABLE)
        factor, growth = self._factor(radii**2)
        turned = np.flatnonzero(growth <= 0)
        stop = int(turned[0]) if len(turned) else _TABLE
        return radii[:stop], np.arctan2(radii, self.focal_px * factor)[:stop]


def division(
    k1: float, k2: float, u0: float, v0: float, width: int, height: int
) -> Division | TwoParameterDivision:
    """The simplest model of these parameters: `Division` when k2 is zero."""
    if k2 == 0.0:
        return Division(k1, u0, v0, width, height)
    return TwoParameterDivision(k1, k2, u0, v0, width, height)


def farthest_corner(u0: float, v0: float, width: int, height: int) -> float:
    """Distance from (u0, v0) to the farthest corner of the picture, pixels."""
    return float(np.hypot(max(abs(u0), abs(width - u0)), max(abs(v0), abs(height - v0))))


def is_invertible(k1: float, k2: float, radius: float) -> bool:
    """Whether r / (1 + k1 r² + k2 r⁴) grows on [0, radius] with a positive denominator.

    With a = k1 R², b = k2 R⁴ and t = (r / R)²: 1 + a t + b t² > 0 and 1 − a t − 3 b t² > 0 on
    [0, 1]. The ends give b > −1 − a and b < (1 − a) / 3, which meet at a = −2. The second parabola
    has its minimum 1 + a² / (12 b) inside [0, 1] when b < 0 and 0 < a < −6 b, which binds from
    a = 2 on: there b < −a² / 12 takes the place of the upper end.
    """
    a, b = k1 * radius**2, k2 * radius**4
    upper = (1.0 - a) / 3.0 if a < 2.0 else -(a**2) / 12.0
    return bool(a > -2.0 and -1.0 - a < b < upper)


def _checked(values: np.ndarray, columns: int) -> np.ndarray:
    if values.ndim != 2 or values.shape[1] != columns:
        raise ValueError(f"Expected an array of shape (n, {columns}), got {values.shape}.")
    return values

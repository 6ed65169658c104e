"""The generic fisheye model of Kannala & Brandt (PAMI 2006) with five coefficients.

r(θ) = Σ k_i θ^(2i−1), i = 1..5, and pixel = (m_u r cos φ + u0, m_v r sin φ + v0)
(LaRecNet, Eq. generic-camera-model). A picture fixes only the products m·k, hence one gauge
everywhere: k in units of half the picture's width, m_u = width / 2, m_v / m_u the pixel aspect.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from classical.camera.base import check_points, check_size

N_COEFFICIENTS = 5
N_PARAMETERS = 9  # k1..k5, m_u, m_v, u0, v0
_POWERS = 2 * np.arange(N_COEFFICIENTS) + 1  # exponents of θ
_TABLE_SIZE = 257  # brackets of the inverse; Newton does the rest
_TABLE = np.linspace(0.0, 1.0, _TABLE_SIZE)
_ANGLES = np.linspace(0.0, np.pi, 513)  # a dip of r' between two of them bends nothing visibly
_NEWTON_STEPS = 30
_LAST_STEP = 1e-8  # radians: Newton squares the error, so what is left after it is rounding
_BISECTIONS = 32  # of 6 mrad: to a picoradian
_NEAR_AXIS = 1e-4  # half-widths; below, series replace differences that cancel


class UnprojectionJacobian(NamedTuple):
    """Rays with their derivatives; see `KannalaBrandt.unproject_jacobian`."""

    rays: Float[np.ndarray, "n 3"]
    valid: Bool[np.ndarray, " n"]
    by_points: Float[np.ndarray, "n 3 2"]
    by_parameters: Float[np.ndarray, "n 3 9"]


@dataclass(frozen=True, eq=False)
class KannalaBrandt:
    """A radially symmetric fisheye camera.

    Attributes:
        k: Coefficients k1..k5 of r(θ), shape (5,), half picture widths.
        m_u: Pixels per unit of r along u.
        m_v: Pixels per unit of r along v.
        u0: Principal point, pixels.
        v0: Principal point, pixels.
        width: Picture width in pixels.
        height: Picture height in pixels.
    """

    k: Float[np.ndarray, " 5"]
    m_u: float
    m_v: float
    u0: float
    v0: float
    width: int
    height: int

    def __post_init__(self) -> None:
        check_size(self.width, self.height)
        k = np.array(self.k, dtype=np.float64)
        if k.shape != (N_COEFFICIENTS,):
            raise ValueError(f"Expected k of shape ({N_COEFFICIENTS},), got {k.shape}.")
        if not (np.isfinite(k).all() and np.isfinite([self.m_u, self.m_v, self.u0, self.v0]).all()):
            raise ValueError("Expected finite camera parameters, got a NaN or an infinity.")
        if k[0] <= 0 or self.m_u <= 0 or self.m_v <= 0:
            raise ValueError(
                "Expected k1, m_u and m_v to be positive, got "
                f"k1={k[0]:g}, m_u={self.m_u:g}, m_v={self.m_v:g}."
            )
        k.setflags(write=False)
        object.__setattr__(self, "k", k)

    def __eq__(self, other: object) -> bool:
        """Equal size and bit-equal parameters."""
        if not isinstance(other, KannalaBrandt):
            return NotImplemented
        same_size = (self.width, self.height) == (other.width, other.height)
        return same_size and bool(np.array_equal(self.to_vector(), other.to_vector()))

    def __hash__(self) -> int:
        return hash((self.to_vector().tobytes(), self.width, self.height))

    # ---- construction and conversion -------------------------------------------------------

    @classmethod
    def centred(cls, k: Float[np.ndarray, " 5"], width: int, height: int) -> KannalaBrandt:
        """Square pixels, the principal point in the middle, m_u = m_v = width / 2."""
        half = width / 2
        return cls(k, half, half, (width - 1) / 2, (height - 1) / 2, width, height)

    @classmethod
    def from_vector(cls, vector: Float[np.ndarray, " 9"], width: int, height: int) -> KannalaBrandt:
        """The camera of a vector (k1..k5, m_u, m_v, u0, v0), the inverse of `to_vector`."""
        if vector.shape != (N_PARAMETERS,):
            raise ValueError(f"Expected a vector of shape ({N_PARAMETERS},), got {vector.shape}.")
        m_u, m_v, u0, v0 = (float(value) for value in vector[5:])
        return cls(vector[:5], m_u, m_v, u0, v0, width, height)

    @classmethod
    def from_opencv(
        cls,
        K: Float[np.ndarray, "3 3"],
        D: Float[np.ndarray, " 4"],
        width: int,
        height: int,
    ) -> KannalaBrandt:
        """The same camera from `cv2.fisheye` parameters: k1 m_u = fx, k_{i+1} / k1 = D_i.

        Raises:
            ValueError: If the shapes are wrong or K has skew, which this model lacks.
        """
        K, D = np.asarray(K, dtype=np.float64), np.asarray(D, dtype=np.float64).reshape(-1)
        if K.shape != (3, 3) or D.shape != (4,):
            raise ValueError(f"Expected K (3, 3) and D (4,), got {K.shape} and {D.shape}.")
        if abs(K[0, 1]) > 1e-9 * abs(K[0, 0]):
            raise ValueError(f"Expected a camera matrix without skew, got K[0, 1] = {K[0, 1]:g}.")
        k1 = K[0, 0] / (width / 2)
        k = k1 * np.concatenate([[1.0], D])
        m_v = float(K[1, 1] / k1)
        return cls(k, width / 2, m_v, float(K[0, 2]), float(K[1, 2]), width, height)

    def to_vector(self) -> Float[np.ndarray, " 9"]:
        """The parameters (k1..k5, m_u, m_v, u0, v0)."""
        return np.array([*self.k, self.m_u, self.m_v, self.u0, self.v0], dtype=np.float64)

    def to_opencv(self) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 4"]]:
        """K and D of `cv2.fisheye`: fx = k1 m_u, D_i = k_{i+1} / k1. Exact: it is one model."""
        k1 = self.k[0]
        K = np.array(
            [[k1 * self.m_u, 0.0, self.u0], [0.0, k1 * self.m_v, self.v0], [0.0, 0.0, 1.0]]
        )
        return K, self.k[1:] / k1

    def normalized(self) -> KannalaBrandt:
        """The same camera in the gauge m_u = width / 2."""
        half = self.width / 2
        scale = self.m_u / half
        return KannalaBrandt(
            self.k * scale,
            half,
            self.m_v / scale,
            self.u0,
            self.v0,
            self.width,
            self.height,
        )

    def resized(self, width: int, height: int) -> KannalaBrandt:
        """The camera of the picture resampled to another size; its outer edges stay in place."""
        check_size(width, height)
        scale_u, scale_v = width / self.width, height / self.height
        return KannalaBrandt(
            self.k,
            self.m_u * scale_u,
            self.m_v * scale_v,
            (self.u0 + 0.5) * scale_u - 0.5,
            (self.v0 + 0.5) * scale_v - 0.5,
            width,
            height,
        )

    def cropped(self, x: int, y: int, width: int, height: int) -> KannalaBrandt:
        """The camera of the part whose top-left pixel is (x, y), in the gauge of its own width."""
        cut = KannalaBrandt(self.k, self.m_u, self.m_v, self.u0 - x, self.v0 - y, width, height)
        return cut.normalized()

    # ---- the radial function ---------------------------------------------------------------

    def radius(self, theta: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
        """r(θ) in half widths; θ in radians."""
        return np.asarray(_even_polynomial(self.k, theta) * theta)

    def radius_derivative(self, theta: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
        """dr/dθ in half widths per radian."""
        return np.asarray(_even_polynomial(self.k * _POWERS, theta))

    def radius_jacobian(self, theta: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 5"]:
        """∂r/∂k, shape (n, 5): the odd powers of θ."""
        return theta[:, None] ** _POWERS

    @cached_property
    def theta_max(self) -> float:
        """The largest angle up to which r grows strictly, at most π; radians."""
        slope = self.radius_derivative(_ANGLES)
        falling = np.flatnonzero(slope <= 0)
        if not len(falling):
            return float(np.pi)
        low, high = _ANGLES[falling[0] - 1], _ANGLES[falling[0]]
        c0, c1, c2, c3, c4 = (self.k * _POWERS).tolist()  # plain floats: no array overhead
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            x = middle * middle
            rising = (((c4 * x + c3) * x + c2) * x + c1) * x + c0 > 0
            low, high = (middle, high) if rising else (low, middle)
        return float(low)

    @cached_property
    def is_monotone(self) -> bool:
        """True where every pixel of the picture has an angle: r grows up to the far corner."""
        corners = np.array(
            [[u, v] for u in (-0.5, self.width - 0.5) for v in (-0.5, self.height - 0.5)]
        )
        x, y = self._plane(corners)
        return bool(np.hypot(x, y).max() <= self.radius(np.array([self.theta_max]))[0])

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        theta = _TABLE * self.theta_max
        return theta, self.radius(theta)

    def theta(
        self, radius: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """Invert r(θ) by Newton's method kept inside a bracket.

        Args:
            radius: Distances from the principal point in half widths, shape (n,).

        Returns:
            theta: Angles in [0, `theta_max`], to rounding error; `theta_max` where invalid.
            valid: True where 0 ≤ radius ≤ r(`theta_max`).
        """
        table_theta, table_radius = self._table
        valid = np.asarray((radius >= 0) & (radius <= table_radius[-1]))
        every = bool(valid.all())
        target = radius if every else np.where(valid, radius, table_radius[-1])
        theta = np.interp(target, table_radius, table_theta)
        unsure = np.zeros(len(theta), dtype=bool)
        for most in (self.theta_max / _TABLE_SIZE, _LAST_STEP):  # two free steps nearly always do
            step = (self.radius(theta) - target) / np.maximum(self.radius_derivative(theta), 1e-12)
            theta -= step
            unsure |= np.abs(step) > most
        if unsure.any():
            theta[unsure] = self._guarded_newton(target[unsure])
        return theta if every else np.where(valid, theta, self.theta_max), valid

    def _guarded_newton(self, target: np.ndarray) -> np.ndarray:
        """Newton's method for r(θ) = target that bisects where a step would leave its bracket."""
        table_theta, table_radius = self._table
        cell = np.clip(np.searchsorted(table_radius, target) - 1, 0, _TABLE_SIZE - 2)
        low, high = table_theta[cell], table_theta[cell + 1]
        theta = 0.5 * (low + high)
        for _ in range(_NEWTON_STEPS):
            excess = self.radius(theta) - target
            high, low = np.where(excess > 0, theta, high), np.where(excess <= 0, theta, low)
            slope = self.radius_derivative(theta)
            step = theta - excess / np.where(slope > 0, slope, 1.0)
            inside = (slope > 0) & (step >= low) & (step <= high)
            update = np.where(inside, step, 0.5 * (low + high))
            moved = np.abs(update - theta).max(initial=0.0)
            theta = update
            if moved < 1e-9:  # Newton squares the error: what is left is rounding
                break
        return theta

    # ---- pixels and rays -------------------------------------------------------------------

    def project(
        self, rays: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        """Map rays to pixels.

        Args:
            rays: Directions, not necessarily unit, shape (n, 3).

        Returns:
            points: Pixels, shape (n, 2).
            valid: True where the ray is finite, not zero and within `theta_max` of the axis.
        """
        check_points("rays", rays, 3)
        across = np.hypot(rays[:, 0], rays[:, 1])
        theta = np.arctan2(across, rays[:, 2])
        known = np.isfinite(rays).all(axis=1) & ((across > 0) | (rays[:, 2] != 0))
        theta = np.where(known, theta, 0.0)
        stretch = np.where(known & (across > 0), self.radius(theta), 0.0) / np.where(
            known & (across > 0), across, 1.0
        )
        direction = np.where(known[:, None], rays[:, :2], 0.0) * stretch[:, None]
        points = direction * [self.m_u, self.m_v] + [self.u0, self.v0]
        return points, np.asarray(known & (theta <= self.theta_max))

    def unproject(
        self, points: Float[np.ndarray, "n 2"]
    ) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
        """Map pixels to unit rays, the inverse of `project`.

        Args:
            points: Pixels, shape (n, 2).

        Returns:
            rays: Unit directions, shape (n, 3); at `theta_max` in the same azimuth where invalid.
            valid: True where the lens reaches the pixel.
        """
        check_points("points", points, 2)
        finite = np.asarray(np.isfinite(points).all(axis=1))
        x, y = self._plane(np.where(finite[:, None], points, [self.u0, self.v0]))
        radius = np.hypot(x, y)
        theta, valid = self.theta(radius)
        rays = np.stack([*_azimuth(x, y, radius) * np.sin(theta), np.cos(theta)], axis=1)
        return rays, np.asarray(valid & finite)

    def unproject_jacobian(self, points: Float[np.ndarray, "n 2"]) -> UnprojectionJacobian:
        """Rays with their analytic derivatives, by the implicit function theorem.

        dθ/dr = 1 / r'(θ) and dθ/dk_i = −θ^(2i−1) / r'(θ).

        Args:
            points: Pixels, shape (n, 2).

        Returns:
            rays (n, 3), valid (n,), ∂rays/∂points (n, 3, 2) and ∂rays/∂parameters (n, 3, 9) in the
            order of `to_vector`. Derivatives are zero where invalid.
        """
        check_points("points", points, 2)
        x, y = self._plane(points)
        radius = np.hypot(x, y)
        theta, valid = self.theta(radius)
        sine, cosine = np.sin(theta), np.cos(theta)
        azimuth = _azimuth(x, y, radius)
        slope = self.radius_derivative(theta)
        slope = np.where(slope > 1e-12, slope, 1e-12)

        by_plane = self._ray_by_plane(x, y, radius, sine, cosine, 1 / slope)
        by_theta = np.stack([*azimuth * cosine, -sine], axis=1)
        jacobian = np.empty((len(points), 3, N_PARAMETERS))
        theta_by_k = -self.radius_jacobian(theta) / slope[:, None]
        jacobian[:, :, :5] = by_theta[:, :, None] * theta_by_k[:, None, :]
        jacobian[:, :, 5] = by_plane[:, :, 0] * (-x / self.m_u)[:, None]
        jacobian[:, :, 6] = by_plane[:, :, 1] * (-y / self.m_v)[:, None]
        jacobian[:, :, 7] = -by_plane[:, :, 0] / self.m_u
        jacobian[:, :, 8] = -by_plane[:, :, 1] / self.m_v
        jacobian[~valid] = 0.0
        by_points = by_plane / [self.m_u, self.m_v]
        by_points[~valid] = 0.0
        rays = np.stack([*azimuth * sine, cosine], axis=1)
        return UnprojectionJacobian(rays, valid, by_points, jacobian)

    def project_jacobian(
        self, rays: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 2 3"], Float[np.ndarray, "n 2 9"]]:
        """Analytic derivatives of `project`.

        Args:
            rays: Directions, shape (n, 3).

        Returns:
            ∂points/∂rays (n, 2, 3) and ∂points/∂parameters (n, 2, 9) in the order of `to_vector`.
        """
        check_points("rays", rays, 3)
        x, y, z = rays.T
        across, squared = np.hypot(x, y), (rays**2).sum(axis=1)
        theta = np.arctan2(across, z)
        radius, slope = self.radius(theta), self.radius_derivative(theta)
        near = across < _NEAR_AXIS * np.sqrt(squared)
        safe = np.where(near, 1.0, across)
        depth = np.where(near, z, 1.0)
        stretch = np.where(near, self.k[0] / depth, radius / safe)
        # stretch = r / across; its gradient is (x, y) * bend across the axis
        bend = np.where(
            near,
            (2 * self.k[1] - 2 * self.k[0] / 3) / depth**3,
            (slope * z / squared - stretch) / safe**2,
        )
        along = -slope / squared
        m = np.array([self.m_u, self.m_v])
        by_rays = np.empty((len(rays), 2, 3))
        by_rays[:, 0, 0], by_rays[:, 0, 1] = stretch + x * x * bend, x * y * bend
        by_rays[:, 1, 0], by_rays[:, 1, 1] = x * y * bend, stretch + y * y * bend
        by_rays[:, :, 2] = rays[:, :2] * along[:, None]
        by_rays *= m[:, None]

        by_parameters = np.zeros((len(rays), 2, N_PARAMETERS))
        azimuth = _azimuth(x, y, across).T
        by_parameters[:, :, :5] = (azimuth * m)[:, :, None] * self.radius_jacobian(theta)[:, None]
        by_parameters[:, 0, 5] = azimuth[:, 0] * radius
        by_parameters[:, 1, 6] = azimuth[:, 1] * radius
        by_parameters[:, 0, 7] = by_parameters[:, 1, 8] = 1.0
        return by_rays, by_parameters

    def _plane(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Offsets from the principal point in half widths."""
        return (points[:, 0] - self.u0) / self.m_u, (points[:, 1] - self.v0) / self.m_v

    def _ray_by_plane(
        self,
        x: np.ndarray,
        y: np.ndarray,
        radius: np.ndarray,
        sine: np.ndarray,
        cosine: np.ndarray,
        theta_by_radius: np.ndarray,
    ) -> np.ndarray:
        """∂ray/∂(x, y), shape (n, 3, 2), with ray = (x a, y a, cos θ) and a = sin θ / radius."""
        near = radius < _NEAR_AXIS
        safe = np.where(near, 1.0, radius)
        k1, k2 = self.k[0], self.k[1]
        a = np.where(near, 1 / k1, sine / safe)
        bend = np.where(
            near,
            -2 * (k2 / k1**4 + 1 / (6 * k1**3)),
            (cosine * theta_by_radius * safe - sine) / safe**3,
        )
        out = np.empty((len(x), 3, 2))
        out[:, 0, 0], out[:, 0, 1] = a + x * x * bend, x * y * bend
        out[:, 1, 0], out[:, 1, 1] = x * y * bend, a + y * y * bend
        out[:, 2, 0], out[:, 2, 1] = -a * theta_by_radius * x, -a * theta_by_radius * y
        return out


def _even_polynomial(coefficients: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Σ c_i θ^(2i) by Horner's rule, in place: arrays are short and calls are what costs."""
    squared = theta * theta
    *lower, highest = coefficients.tolist()
    value = squared * highest
    for coefficient in lower[:0:-1]:
        value += coefficient
        value *= squared
    value += lower[0]
    return value


def _azimuth(x: np.ndarray, y: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """(cos φ, sin φ), zero on the axis, shape (2, n)."""
    safe = np.where(radius > 0, radius, 1.0)
    return np.stack([x / safe, y / safe])

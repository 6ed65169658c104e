"""How far curves are from being pictures of straight lines, in pixels of the photograph.

A straight line in space and the camera's centre span a plane; its picture is the set of pixels
whose rays are orthogonal to the plane's normal n. The residual of a pixel p is its Sampson
distance to that set,

    e = n·ray(p) / |∂(n·ray(p))/∂p|,

in pixels of the distorted picture, so that it does not shrink when everything shrinks, and made of
rays, so that it holds past 90°. The normal of each curve is the eigenvector of the smallest
eigenvalue of Σ w ray rayᵀ, a function of the lens: variable projection leaves only the lens in the
problem (Devernay & Faugeras 2001 for the idea of plumb lines; Golub & Pereyra 1973).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from classical.camera import KannalaBrandt
from classical.fit.samples import CurveSamples

_LEAST_RADIUS = 1e-4  # half widths; the radial functions are even, so the axis may be nudged
_LEAST_SLOPE = 1e-6


class Straightness(NamedTuple):
    """Residuals of all samples and, where asked for, their derivatives."""

    residuals: Float[np.ndarray, " n"]
    normals: Float[np.ndarray, "curves 3"]
    reached: Bool[np.ndarray, " n"]
    jacobian: Float[np.ndarray, "n 9"] | None


def straightness(
    camera: KannalaBrandt,
    samples: CurveSamples,
    weights: Float[np.ndarray, " n"],
    *,
    jacobian: bool = False,
) -> Straightness:
    """Sampson distances of the samples to their curves' best great circles.

    Args:
        camera: The lens under which the curves should be straight.
        samples: Points of the curves.
        weights: Weights w of the points in their curve's normal, shape (n,), not negative.
        jacobian: Whether to differentiate by the camera's vector (k1..k5, m_u, m_v, u0, v0).

    Returns:
        residuals: Signed distances in pixels, shape (n,). A pixel out of the lens's reach has its
            distance to the reachable circle instead, which pulls the lens to cover it.
        normals: Unit normals, shape (C, 3).
        reached: True where the lens reaches the pixel, shape (n,).
        jacobian: ∂residuals/∂vector, exact, shape (n, 9), or None.
    """
    field = _RayField.at(camera, samples.points)
    weights = np.where(field.reached, weights, 0.0)
    normals, spread, vectors = _normals(samples, field.rays, weights)
    n = normals[samples.owner]
    inner = (n * field.rays).sum(axis=1)
    gradient = field.gradient(n)
    length = np.maximum(np.hypot(*gradient.T), 1e-12)
    residuals = np.where(field.reached, inner / length, field.overshoot)
    if not jacobian:
        return Straightness(residuals, normals, field.reached, None)

    by_camera, gradient_by_camera = field.derivatives(n)
    normal_by_camera = _normal_derivatives(
        samples, field, weights, inner, n, spread=spread, vectors=vectors, by_camera=by_camera
    )[samples.owner]
    inner_by = by_camera + np.matmul(field.rays[:, None, :], normal_by_camera)[:, 0]
    gradient_by = gradient_by_camera + np.matmul(
        field.ray_by_points.transpose(0, 2, 1), normal_by_camera
    )
    length_by = np.matmul(gradient[:, None, :], gradient_by)[:, 0] / length[:, None]
    full = (inner_by - (inner / length)[:, None] * length_by) / length[:, None]
    full[~field.reached] = field.overshoot_derivatives()[~field.reached]
    return Straightness(residuals, normals, field.reached, full)


def _normals(
    samples: CurveSamples, rays: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Smallest eigenvectors of each curve's scatter; also all eigenvalues and eigenvectors."""
    outer = rays[:, :, None] * (weights[:, None] * rays)[:, None, :]
    spread, vectors = np.linalg.eigh(samples.curve_sums(outer))
    return vectors[:, :, 0], spread, vectors


def _normal_derivatives(
    samples: CurveSamples,
    field: _RayField,
    weights: np.ndarray,
    inner: np.ndarray,
    n: np.ndarray,
    *,
    spread: np.ndarray,
    vectors: np.ndarray,
    by_camera: np.ndarray,
) -> np.ndarray:
    """∂n/∂camera, shape (C, 3, 9): first-order perturbation of the smallest eigenvector."""
    rays_by = field.rays_by_camera()
    scatter_by = samples.curve_sums(
        weights[:, None, None]
        * (rays_by * inner[:, None, None] + field.rays[:, :, None] * by_camera[:, None, :])
    )
    gap = spread[:, :1] - spread[:, 1:]
    gap = np.where(np.abs(gap) > 1e-15, gap, -1e-15)
    other = vectors[:, :, 1:]
    along = np.matmul(other.transpose(0, 2, 1), scatter_by) / gap[:, :, None]
    return np.matmul(other, along)


@dataclass(frozen=True, eq=False)
class _RayField:
    """ray = (A x, A y, C) at the plane's (x, y), A = sin θ / ρ and C = cos θ, with derivatives.

    With φ = n·ray = A s + n_z C and s = n_x x + n_y y, all derivatives come from the radial
    functions P = A'/ρ, Q = C'/ρ, R = P'/ρ, S = Q'/ρ and from ∂A, ∂C, ∂P, ∂Q by k.
    """

    camera: KannalaBrandt
    plane: Float[np.ndarray, "n 2"]
    radius: Float[np.ndarray, " n"]
    theta: Float[np.ndarray, " n"]
    reached: Bool[np.ndarray, " n"]
    slope: Float[np.ndarray, " n"]  # t = dθ/dρ
    A: Float[np.ndarray, " n"]
    P: Float[np.ndarray, " n"]
    Q: Float[np.ndarray, " n"]

    @classmethod
    def at(cls, camera: KannalaBrandt, points: np.ndarray) -> _RayField:
        plane = (points - [camera.u0, camera.v0]) / [camera.m_u, camera.m_v]
        radius = np.maximum(np.hypot(*plane.T), _LEAST_RADIUS)
        theta, reached = camera.theta(radius)
        slope = 1 / np.maximum(camera.radius_derivative(theta), _LEAST_SLOPE)
        sine, cosine = np.sin(theta), np.cos(theta)
        A = sine / radius
        P = (cosine * slope * radius - sine) / radius**3
        return cls(camera, plane, radius, theta, reached, slope, A, P, -A * slope)

    @cached_property
    def rays(self) -> np.ndarray:
        return np.column_stack([self.plane * self.A[:, None], np.cos(self.theta)])

    @property
    def m(self) -> np.ndarray:
        return np.array([self.camera.m_u, self.camera.m_v])

    @cached_property
    def ray_by_points(self) -> np.ndarray:
        """∂ray/∂(u, v), shape (n, 3, 2)."""
        out = np.empty((len(self.plane), 3, 2))
        out[:, :2] = (self.P[:, None] * self.plane)[:, :, None] * self.plane[:, None, :]
        out[:, 0, 0] += self.A
        out[:, 1, 1] += self.A
        out[:, 2] = self.Q[:, None] * self.plane
        return out / self.m

    def gradient(self, n: np.ndarray) -> np.ndarray:
        """∂(n·ray)/∂(u, v), shape (n, 2)."""
        s = (n[:, :2] * self.plane).sum(axis=1)
        pull = self.P * s + n[:, 2] * self.Q
        return (self.A[:, None] * n[:, :2] + pull[:, None] * self.plane) / self.m

    @cached_property
    def overshoot(self) -> np.ndarray:
        """Distance of pixels to the circle that the lens reaches, pixels."""
        reach = self.camera.radius(np.array([self.camera.theta_max]))[0]
        return np.where(self.reached, 0.0, self.radius - reach) * self.camera.m_u

    def overshoot_derivatives(self) -> np.ndarray:
        """∂overshoot/∂camera, shape (n, 9); r' vanishes at θ_max, so θ_max counts as fixed."""
        camera = self.camera
        out = np.zeros((len(self.plane), 9))
        out[:, :5] = -camera.m_u * camera.radius_jacobian(np.array([camera.theta_max]))
        direction = self.plane / self.radius[:, None]
        out[:, 5] = -direction[:, 0] * self.plane[:, 0] + self.overshoot / camera.m_u
        out[:, 6] = -direction[:, 1] * self.plane[:, 1] * camera.m_u / camera.m_v
        out[:, 7] = -direction[:, 0]
        out[:, 8] = -direction[:, 1] * camera.m_u / camera.m_v
        return out

    @cached_property
    def _by_k(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """∂A, ∂C, ∂P, ∂Q by k, each (n, 5)."""
        theta, t, radius = self.theta[:, None], self.slope[:, None], self.radius[:, None]
        sine, cosine = np.sin(theta), np.cos(theta)
        powers = self.camera.radius_jacobian(self.theta)
        theta_by = -powers * t
        exponents = 2 * np.arange(5) + 1
        slope_by = exponents * powers / theta + self._curvature[:, None] * theta_by
        t_by = -(t**2) * slope_by
        A_by = cosine * theta_by / radius
        C_by = -sine * theta_by
        P_by = (
            -sine * theta_by * t * radius + cosine * t_by * radius - cosine * theta_by
        ) / radius**3
        Q_by = -A_by * t - self.A[:, None] * t_by
        return A_by, C_by, P_by, Q_by

    @cached_property
    def _curvature(self) -> np.ndarray:
        """r''(θ), shape (n,)."""
        exponents = 2 * np.arange(1, 5) + 1
        powers = self.theta[:, None] ** (exponents - 2)
        return powers @ (self.camera.k[1:] * exponents * (exponents - 1))

    def _second(self) -> tuple[np.ndarray, np.ndarray]:
        """R = P'/ρ and S = Q'/ρ, each (n,)."""
        t, radius = self.slope, self.radius
        sine, cosine = np.sin(self.theta), np.cos(self.theta)
        t_prime = -(t**3) * self._curvature
        P_prime = (
            (cosine * t_prime - sine * t**2) / radius**2
            - 3 * cosine * t / radius**3
            + 3 * sine / radius**4
        )
        return P_prime / radius, -self.P * t - self.A * t_prime / radius

    def rays_by_camera(self) -> np.ndarray:
        """∂ray/∂(k, m_u, m_v, u0, v0), shape (n, 3, 9)."""
        A_by, C_by, _, _ = self._by_k
        out = np.empty((len(self.plane), 3, 9))
        out[:, :2, :5] = self.plane[:, :, None] * A_by[:, None, :]
        out[:, 2, :5] = C_by
        by_points = self.ray_by_points
        out[:, :, 5:7] = -by_points * self.plane[:, None, :]
        out[:, :, 7:] = -by_points
        return out

    def derivatives(self, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """∂(n·ray)/∂camera (n, 9) and ∂(its pixel gradient)/∂camera (n, 2, 9), n held fixed."""
        A_by, C_by, P_by, Q_by = self._by_k
        across, depth = n[:, :2], n[:, 2:]
        s = (across * self.plane).sum(axis=1)
        gradient = self.gradient(n)
        by_camera = np.empty((len(n), 9))
        by_camera[:, :5] = A_by * s[:, None] + depth * C_by
        by_camera[:, 5:7] = -gradient * self.plane
        by_camera[:, 7:] = -gradient

        gradient_by = np.empty((len(n), 2, 9))
        pull_by = P_by * s[:, None] + depth * Q_by
        gradient_by[:, :, :5] = (
            across[:, :, None] * A_by[:, None, :] + self.plane[:, :, None] * pull_by[:, None, :]
        ) / self.m[:, None]
        hessian = self._hessian(n, s)
        # m_v moves y by −y / m_v, and divides the gradient's v part once more
        gradient_by[:, :, 5:7] = -hessian * self.plane[:, None, :]
        gradient_by[:, 0, 5] -= gradient[:, 0] / self.camera.m_u
        gradient_by[:, 1, 6] -= gradient[:, 1] / self.camera.m_v
        gradient_by[:, :, 7:] = -hessian
        return by_camera, gradient_by

    def _hessian(self, n: np.ndarray, s: np.ndarray) -> np.ndarray:
        """∂²(n·ray)/∂(u, v)², shape (n, 2, 2)."""
        R, S = self._second()
        q, across = self.plane, n[:, :2]
        mixed = across[:, :, None] * q[:, None, :]
        out = self.P[:, None, None] * (mixed + mixed.transpose(0, 2, 1))
        out += (self.P * s + n[:, 2] * self.Q)[:, None, None] * np.eye(2)
        out += (R * s + n[:, 2] * S)[:, None, None] * q[:, :, None] * q[:, None, :]
        return out / (self.m[:, None] * self.m)

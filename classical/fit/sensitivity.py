"""How the residuals of `straightness` move with the lens, exactly.

With q = (x, y) the plane point of a sample, s = n_x x + n_y y and φ = n·ray = A s + n_z C, the
residual is e = φ / L with L = |g| and g = ∂φ/∂(u, v), so

    ∂e = (∂φ − e/L g·∂g) / L.

All derivatives come from the radial functions P = A'/ρ, Q = C'/ρ, R = P'/ρ, S = Q'/ρ and from
∂θ/∂k_i = −θ^(2i−1) dθ/dρ. First the normal is held; then it follows its curve: ∂n is the
first-order perturbation of the smallest eigenvector, and moves e by
(ray − e/L ∂ray/∂(u, v) g)·∂n / L.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from classical.camera import KannalaBrandt
from classical.camera.ray_field import RayField
from classical.fit.circles import Circles, Distances
from classical.fit.samples import CurveSamples

_ODD = np.array([1.0, 3.0, 5.0, 7.0, 9.0])[:, None]
_CURVED = np.array([6.0, 20.0, 42.0, 72.0])  # (2i − 1)(2i − 2) for k2..k5
_LEAST_GAP = 1e-15  # between eigenvalues


class _Terms(NamedTuple):
    """What several derivatives share; one array a part."""

    powers: np.ndarray  # (5, n): θ^(2i−2)
    turn: np.ndarray  # −θ dθ/dρ, so that ∂θ/∂k_i = turn powers_i
    curvature: np.ndarray  # r''(θ)
    cross: np.ndarray  # cos θ / ρ
    swing: np.ndarray  # ∂φ/∂θ with q and n held
    share: np.ndarray  # e / L
    hx: np.ndarray  # h = g over (m_u, m_v)
    hy: np.ndarray
    hn: np.ndarray  # h·(n_x, n_y)
    hq: np.ndarray  # h·q


def straightness_jacobian(
    camera: KannalaBrandt,
    samples: CurveSamples,
    weights: Float[np.ndarray, " n"] | None,
    field: RayField,
    circles: Circles,
    distances: Distances,
) -> tuple[Float[np.ndarray, "9 n"], Float[np.ndarray, "3 9 curves"]]:
    """∂e/∂(k1..k5, m_u, m_v, u0, v0), a row a parameter; all pixels taken for reached.

    The second are the same derivatives of the curves' normals.
    """
    terms = _terms(camera, field, distances)
    out = np.empty((9, len(field.x)))
    _by_k(out, field, distances, terms)
    _by_place(out, field, distances, terms)
    scatter = _scatter_derivatives(field, distances, terms)
    if weights is not None:
        scatter *= weights
    turned = _normal_derivatives(np.add.reduceat(scatter, samples.starts, axis=2), circles)
    for part, by_normal in zip(turned, _by_normal(field, distances, terms), strict=True):
        moved = np.repeat(part, samples.counts, axis=1)
        moved *= by_normal
        out += moved
    return out, turned


def _terms(camera: KannalaBrandt, field: RayField, distances: Distances) -> _Terms:
    squared = field.theta * field.theta
    powers = np.empty((5, len(squared)))
    powers[0] = 1.0
    powers[1] = squared
    np.multiply(squared, squared, out=powers[2])
    np.multiply(powers[2], squared, out=powers[3])
    np.multiply(powers[2], powers[2], out=powers[4])
    cross = field.C / field.radius
    hx, hy = distances.gu / field.m_u, distances.gv / field.m_v
    return _Terms(
        powers,
        turn=-field.theta * field.slope,
        curvature=field.theta * ((camera.k[1:] * _CURVED) @ powers[:4]),
        cross=cross,
        swing=cross * distances.along - field.sine * distances.nz,
        share=distances.distance / distances.length,
        hx=hx,
        hy=hy,
        hn=hx * distances.nx + hy * distances.ny,
        hq=hx * field.x + hy * field.y,
    )


def _by_k(out: np.ndarray, field: RayField, distances: Distances, terms: _Terms) -> None:
    """∂e/∂k = θ^(2i−2) (by_theta + (2i − 1) by_slope) into the first five rows, n held."""
    t, nz = field.slope, distances.nz
    bent = distances.along / (field.radius * field.radius)  # s / ρ²
    g_by_theta = terms.cross * (terms.hn - terms.hq * (nz * t + bent))
    g_by_theta -= terms.hq * bent * field.sine * t
    g_by_t = terms.hq * (bent * field.C - nz * field.A)
    g_by_t *= t * t
    by_slope = terms.share * g_by_t / distances.length
    by_theta = terms.swing - terms.share * (g_by_theta - terms.curvature * g_by_t)
    by_theta *= terms.turn
    by_theta /= distances.length
    np.multiply(_ODD, by_slope, out=out[:5])
    out[:5] += by_theta
    out[:5] *= terms.powers


def _by_place(out: np.ndarray, field: RayField, distances: Distances, terms: _Terms) -> None:
    """∂e/∂(m_u, m_v, u0, v0) into the last four rows, n held; needs the Hessian of φ times g."""
    t, P = field.slope, field.P
    t_prime = -(t**2) * t * terms.curvature
    R = (field.C * t_prime - field.sine * t * t) / field.radius - 3 * P
    R /= field.radius * field.radius
    S = -P * t - field.A * t_prime / field.radius
    bend = (R * distances.along + distances.nz * S) * terms.hq + P * terms.hn
    steep = P * terms.hq
    for axis, (q, n, h, g, m) in enumerate(
        (
            (field.x, distances.nx, terms.hx, distances.gu, field.m_u),
            (field.y, distances.ny, terms.hy, distances.gv, field.m_v),
        )
    ):
        hessian_g = (steep * n + bend * q + distances.pull * h) / m
        by_centre = (terms.share * hessian_g - g) / distances.length
        out[7 + axis] = by_centre
        # m_v moves y by −y / m_v, and divides the gradient's v part once more
        out[5 + axis] = by_centre * q + terms.share * g * h / distances.length


def _scatter_derivatives(field: RayField, distances: Distances, terms: _Terms) -> np.ndarray:
    """∂(ray rayᵀ)/∂camera times n of every sample, shape (9, 3, n): ∂ray φ + ray ∂φ."""
    x, y, P, inner = field.x, field.y, field.P, distances.inner
    out = np.empty((9, 3, len(x)))
    reach = terms.cross * inner + field.A * terms.swing
    reach *= terms.turn
    base = (x * reach, y * reach, terms.turn * (field.C * terms.swing - field.sine * inner))
    for row, part in enumerate(base):
        np.multiply(terms.powers, part, out=out[:5, row])
    mixed, flat = P * x * y * inner, field.A * inner
    depth = field.Q * inner
    for axis, (q, g, m) in enumerate(((x, distances.gu, field.m_u), (y, distances.gv, field.m_v))):
        along = field.A * g
        part = out[7 + axis]
        part[axis] = P * q * q * inner + flat
        part[1 - axis] = mixed
        part[2] = depth * q
        part /= -m
        part[0] -= along * x
        part[1] -= along * y
        part[2] -= field.C * g
        np.multiply(part, q, out=out[5 + axis])
    return out


def _normal_derivatives(scatter: np.ndarray, circles: Circles) -> np.ndarray:
    """∂n/∂camera of every curve from ∂scatter·n (9, 3, C): shape (3, 9, C)."""
    gap = circles.spread[:, :1] - circles.spread[:, 1:]
    gap = np.where(np.abs(gap) > _LEAST_GAP, gap, -_LEAST_GAP)
    other = circles.vectors[:, :, 1:]
    inverse = np.matmul(other / gap[:, None], other.transpose(0, 2, 1))
    return np.ascontiguousarray(np.matmul(inverse, scatter.transpose(2, 1, 0)).transpose(1, 2, 0))


def _by_normal(
    field: RayField, distances: Distances, terms: _Terms
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """∂e/∂n in three parts: (ray − e/L ∂ray/∂(u, v) g) / L."""
    share, length = terms.share, distances.length
    stretch = share * field.P * terms.hq
    held = field.A - stretch
    turn = share * field.A
    return (
        (held * field.x - turn * terms.hx) / length,
        (held * field.y - turn * terms.hy) / length,
        (field.C - share * field.Q * terms.hq) / length,
    )

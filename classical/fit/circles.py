"""The great circles that curves follow best, and how far their samples lie from them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from classical.camera.ray_field import RayField
from classical.fit.samples import CurveSamples

_FULL = np.array([0, 1, 2, 1, 3, 4, 2, 4, 5])  # a symmetric 3x3 matrix from its six entries


class Circles(NamedTuple):
    """The great circles that curves follow best.

    Attributes:
        normals: Unit normals, shape (C, 3).
        spread: Eigenvalues of each curve's scatter Σ w ray rayᵀ, ascending, shape (C, 3).
        vectors: Its eigenvectors as columns, shape (C, 3, 3).
    """

    normals: Float[np.ndarray, "curves 3"]
    spread: Float[np.ndarray, "curves 3"]
    vectors: Float[np.ndarray, "curves 3 3"]


class Distances(NamedTuple):
    """Sampson distances of samples from their circles, in parts; one array a part.

    Attributes:
        nx: x of the circle's normal.
        ny: y of it.
        nz: z of it.
        along: n_x x + n_y y.
        inner: n·ray.
        pull: P along + n_z Q, the gradient's share along (x, y).
        gu: ∂(n·ray)/∂u.
        gv: ∂(n·ray)/∂v.
        length: Length of that gradient.
        distance: inner / length, pixels.
    """

    nx: Float[np.ndarray, " n"]
    ny: Float[np.ndarray, " n"]
    nz: Float[np.ndarray, " n"]
    along: Float[np.ndarray, " n"]
    inner: Float[np.ndarray, " n"]
    pull: Float[np.ndarray, " n"]
    gu: Float[np.ndarray, " n"]
    gv: Float[np.ndarray, " n"]
    length: Float[np.ndarray, " n"]
    distance: Float[np.ndarray, " n"]


def best_circles(
    field: RayField, samples: CurveSamples, weights: Float[np.ndarray, " n"] | None = None
) -> Circles:
    """The great circle of each curve: smallest eigenvector of its scatter."""
    rx, ry, rz = field.A * field.x, field.A * field.y, field.C
    wx, wy, wz = (rx, ry, rz) if weights is None else (weights * rx, weights * ry, weights * rz)
    products = np.stack([wx * rx, wx * ry, wx * rz, wy * ry, wy * rz, wz * rz])
    sums = np.add.reduceat(products, samples.starts, axis=1)
    spread, vectors = np.linalg.eigh(sums.T[:, _FULL].reshape(-1, 3, 3))
    return Circles(vectors[:, :, 0], spread, vectors)


def sampson_distances(
    field: RayField, normals: Float[np.ndarray, "curves 3"], samples: CurveSamples
) -> Distances:
    """Distances of the samples from the circles with these normals."""
    nx, ny, nz = np.repeat(normals.T, samples.counts, axis=1)
    along = nx * field.x
    along += ny * field.y
    inner = field.A * along
    inner += nz * field.C
    pull = field.P * along
    pull += nz * field.Q
    gu = field.A * nx
    gu += pull * field.x
    gu /= field.m_u
    gv = field.A * ny
    gv += pull * field.y
    gv /= field.m_v
    length = np.maximum(np.sqrt(gu * gu + gv * gv), 1e-12)
    return Distances(nx, ny, nz, along, inner, pull, gu, gv, length, inner / length)

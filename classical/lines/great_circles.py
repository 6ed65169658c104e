"""Curves as great circles of rays, in the form in which they are compared and followed.

With n the normal of the circle and r the ray of a pixel, e = (n·r) / |∂(n·r)/∂pixel| is the
distance of the pixel from the line's image to first order (Sampson), in pixels of the photograph.
For fixed weights the sum of its squares is nᵀ A n with A = Σ r rᵀ / |∂(n·r)/∂pixel|², and n is the
smallest eigenvector of this 3x3 matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from classical.camera import Division, KannalaBrandt, Pinhole
from classical.camera.ray_field import ray_field
from classical.lines.curve import Curve, thinned_curves

_SPACING = 4.0  # pixels between the points that stand for a curve
_STEP = 0.5  # pixels, for derivatives of rays
_REWEIGHTINGS = 2


@dataclass(frozen=True)
class CirclePieces:
    """Curves as statistics of their rays; arrays have one row a piece.

    Attributes:
        scatter: A of the module's docstring, shape (p, 3, 3).
        count: Points behind it, shape (p,).
        rms: Distance from the piece's own circle, pixels, shape (p,).
        length: Pixels, shape (p,).
        ends: Pixels of the first and the last point, shape (p, 2, 2).
        end_rays: Their rays, shape (p, 2, 3).
        middle: Mean ray, shape (p, 3).
        members: Indices of the curves of each.
    """

    scatter: Float[np.ndarray, "p 3 3"]
    count: Float[np.ndarray, " p"]
    rms: Float[np.ndarray, " p"]
    length: Float[np.ndarray, " p"]
    ends: Float[np.ndarray, "p 2 2"]
    end_rays: Float[np.ndarray, "p 2 3"]
    middle: Float[np.ndarray, "p 3"]
    members: list[list[int]]

    @property
    def normals(self) -> Float[np.ndarray, "p 3"]:
        """Unit normals of the circles."""
        return np.linalg.eigh(self.scatter)[1][:, :, 0]


def sampson_rays(
    points: Float[np.ndarray, "n 2"], camera: KannalaBrandt | Division | Pinhole
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 2"]]:
    """Rays of pixels and their derivatives, by central differences where need be; NaN if unseen."""
    if isinstance(camera, KannalaBrandt):
        field, valid = ray_field(camera, points[:, 0], points[:, 1])
        return np.where(valid[:, None], field.rays(), np.nan), field.jacobian()
    rays, valid = camera.unproject(points)
    derivative = np.empty((len(points), 3, 2))
    for axis in (0, 1):
        step = np.zeros(2)
        step[axis] = _STEP
        ahead, valid_ahead = camera.unproject(points + step)
        behind, valid_behind = camera.unproject(points - step)
        derivative[:, :, axis] = (ahead - behind) / (2 * _STEP)
        valid = valid & valid_ahead & valid_behind
    return np.where(valid[:, None], rays, np.nan), derivative


def describe_curves(
    curves: Sequence[Curve], camera: KannalaBrandt | Division | Pinhole
) -> tuple[CirclePieces, list[int]]:
    """Statistics of the curves that the camera sees, and the indices of the others."""
    if not curves:
        none = np.empty((0, 3))
        return CirclePieces(
            np.empty((0, 3, 3)), none[:, 0], none[:, 0], none[:, 0], np.empty((0, 2, 2)),
            np.empty((0, 2, 3)), none, [],
        ), []  # fmt: skip
    coarse, count = thinned_curves(curves, [_SPACING] * len(curves))
    rays, derivative = sampson_rays(coarse, camera)
    finite = np.isfinite(rays[:, 0])
    visible = np.logical_and.reduceat(finite, np.cumsum(count) - count)
    seen, unseen = np.flatnonzero(visible).tolist(), np.flatnonzero(~visible).tolist()
    inside = np.repeat(visible, count)
    rays, derivative, count = rays[inside], derivative[inside], count[visible]
    last = np.cumsum(count) - 1
    starts = last + 1 - count
    scatter = _scatter(rays, derivative, starts, count)
    return CirclePieces(
        scatter,
        count.astype(np.float64),
        own_rms(scatter, count),
        np.array([curves[k].length for k in seen]),
        np.array([(curves[k].points[0], curves[k].points[-1]) for k in seen]).reshape(-1, 2, 2),
        np.stack([rays[starts], rays[last]], axis=1),
        np.add.reduceat(rays, starts) / count[:, None] if seen else np.empty((0, 3)),
        [[k] for k in seen],
    ), unseen


def _scatter(
    rays: np.ndarray, derivative: np.ndarray, starts: np.ndarray, count: np.ndarray
) -> np.ndarray:
    """A of each curve, weighted for its own circle, shape (C, 3, 3)."""
    if not len(starts):
        return np.empty((0, 3, 3))
    outer = rays[:, :, None] * rays[:, None, :]
    scatter = np.add.reduceat(outer, starts)
    for _ in range(_REWEIGHTINGS):
        normal = np.repeat(np.linalg.eigh(scatter)[1][:, :, 0], count, axis=0)
        slope = np.matmul(normal[:, None], derivative)[:, 0]
        weight = 1 / np.maximum((slope**2).sum(axis=1), 1e-20)
        scatter = np.add.reduceat(outer * weight[:, None, None], starts)
    return scatter


def own_rms(scatter: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Root mean square distance of each piece from its own circle, pixels."""
    return np.sqrt(np.maximum(np.linalg.eigvalsh(scatter)[:, 0], 0) / np.maximum(count - 2, 1))

"""How far curves are from being pictures of straight lines, in pixels of the photograph.

A straight line in space and the camera's centre span a plane; its picture is the set of pixels
whose rays are orthogonal to the plane's normal n. The residual of a pixel p is its Sampson
distance to that set,

    e = n·ray(p) / |∂(n·ray(p))/∂p|,

in pixels of the distorted picture, so that it does not shrink when everything shrinks, and made of
rays, so that it holds past 90°. The normal of each curve is the eigenvector of the smallest
eigenvalue of Σ w ray rayᵀ, a function of the lens: variable projection leaves only the lens in the
problem (Devernay & Faugeras 2001 for the idea of plumb lines; Golub & Pereyra 1973).

Arrays hold one quantity of all samples each: they are short, so the number of calls is the cost.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from classical.camera import KannalaBrandt
from classical.camera.ray_field import RayField, ray_field
from classical.fit.circles import Circles, Distances, best_circles, sampson_distances
from classical.fit.overshoot import overshoot, overshoot_jacobian
from classical.fit.samples import CurveSamples
from classical.fit.sensitivity import straightness_jacobian


@dataclass(frozen=True, eq=False)
class Straightness:
    """Residuals of all samples and, when asked for, their derivatives.

    Attributes:
        residuals: Signed distances in pixels, shape (n,). A pixel out of the lens's reach has its
            distance to the reachable circle instead, which pulls the lens to cover it.
        reached: True where the lens reaches the pixel, shape (n,).
    """

    residuals: Float[np.ndarray, " n"]
    reached: Bool[np.ndarray, " n"]
    _camera: KannalaBrandt
    _samples: CurveSamples
    _weights: Float[np.ndarray, " n"] | None
    _field: RayField
    _circles: Circles
    _distances: Distances

    @property
    def normals(self) -> Float[np.ndarray, "curves 3"]:
        """Unit normals of the curves' great circles."""
        return self._circles.normals

    @property
    def normal_jacobian(self) -> Float[np.ndarray, "3 9 curves"]:
        """∂normals/∂(k1..k5, m_u, m_v, u0, v0), exact."""
        return self._derivatives[1]

    @cached_property
    def _derivatives(self) -> tuple[np.ndarray, np.ndarray]:
        return straightness_jacobian(
            self._camera, self._samples, self._weights, self._field, self._circles, self._distances
        )

    @cached_property
    def jacobian(self) -> Float[np.ndarray, "n 9"]:
        """∂residuals/∂(k1..k5, m_u, m_v, u0, v0), exact."""
        columns = self._derivatives[0]
        if not self.reached.all():
            outside = ~self.reached
            columns[:, outside] = overshoot_jacobian(self._camera, self._field)[:, outside]
        return columns.T


def straightness(
    camera: KannalaBrandt,
    samples: CurveSamples,
    weights: Float[np.ndarray, " n"] | None = None,
) -> Straightness:
    """Sampson distances of the samples to their curves' best great circles.

    Args:
        camera: The lens under which the curves should be straight.
        samples: Points of the curves.
        weights: Weights w of the points in their curve's normal, shape (n,), not negative; None
            means that all count alike.
    """
    field, reached = ray_field(camera, samples.u, samples.v)
    every = bool(reached.all())
    if not every:
        weights = reached * (1.0 if weights is None else weights)
    circles = best_circles(field, samples, weights)
    distances = sampson_distances(field, circles.normals, samples)
    residuals = distances.distance
    if not every:
        residuals = np.where(reached, residuals, overshoot(camera, field))
    return Straightness(residuals, reached, camera, samples, weights, field, circles, distances)

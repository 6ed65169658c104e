"""What another estimate says of the shape of a lens, whatever its scale.

The two are known unequally well: a picture often holds nothing of its scale, but lines tell the
shape. (tan θ)' = s tan θ changes the scale alone (see `scale`), so log tan θ at some radii of the
picture holds both apart: their mean is the scale, what is left the shape. A Gaussian over k1..k5
does not, for a lens of another scale has other ratios of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from classical.camera import KannalaBrandt
from classical.fit.observations import Observation, student_excess
from classical.fit.prior import FREE, LensPrior

_REST = (6, 7, 8)  # m_v, u0, v0 of (k1..k5, m_u, m_v, u0, v0)
_CENTRE = (7, 8)
_KNOTS = np.array([0.2, 0.4, 0.6, 0.8, 1.0])  # of the widest angle
_WIDEST = 1.13  # radians; tan θ runs away beyond
_CORNER = 1.3  # half picture widths
_ANGLES = 200
_CAP = 1.5  # radians that a lens under trial is counted for at a knot
_LEAST_SLOPE = 0.3  # of r(θ) over k1: where a lens nearly turns, θ says nothing of its shape
_LEAST_VARIANCE = 1e-8  # of log tan θ
# knots that rise and fall together are the scale: the other four directions, orthonormal
_SHAPES = np.linalg.qr(np.column_stack([np.ones(5), np.eye(5)[:, :4]]))[0][:, 1:].T


@dataclass(frozen=True, eq=False)
class ShapeObservation:
    """Shape, aspect and principal point of a lens; `near` a lens it is an `Observation`.

    Attributes:
        source: Who made it.
        radii: Where log tan θ is compared, half picture widths, shape (5,).
        value: Four coordinates of the shape, then m_v, u0, v0, shape (7,).
        covariance: Of `value`, shape (7, 7).
        is_sure: False: it loses weight with the distance, as under Student's t.
    """

    source: str
    radii: Float[np.ndarray, " 5"]
    value: Float[np.ndarray, " 7"]
    covariance: Float[np.ndarray, "7 7"]
    is_sure: bool = False

    def surprise(self, camera: KannalaBrandt) -> float:
        """Squared Mahalanobis distance of a camera from what was observed."""
        off = _coordinates(camera.normalized(), self.radii)[0] - self.value
        return float(off @ np.linalg.solve(self.covariance, off))

    def near(self, camera: KannalaBrandt) -> Observation:
        """The linear observation, with the weight that it keeps, beside this camera."""
        camera = camera.normalized()
        here, by_camera = _coordinates(camera, self.radii)
        return Observation(
            self.source,
            by_camera,
            self.value - here + by_camera @ camera.to_vector(),
            self.covariance * student_excess(self.surprise(camera), len(self.value)),
            is_sure=False,
        )


def of_belief_shape(
    belief: LensPrior,
    source: str,
    width: int,
    height: int,
    *,
    doubt: float = 1.0,
    centring: float = 0.0,
) -> ShapeObservation:
    """What another estimate says of the lens but for its scale.

    Args:
        belief: The estimate.
        source: Who made it.
        width: Picture width in pixels.
        height: Picture height in pixels.
        doubt: By how much its deviations are widened.
        centring: Deviation of principal points in half picture widths, for an estimate that takes
            lenses to be centred better than they are.
    """
    camera = KannalaBrandt.from_vector(belief.mean, width, height).normalized()
    corner, _ = camera.theta(np.array([_CORNER]))
    angles = np.linspace(0.0, min(_WIDEST, float(corner[0])), _ANGLES)
    steep = camera.radius_derivative(angles) >= _LEAST_SLOPE * camera.k[0]
    radii = camera.radius(angles[np.flatnonzero(np.logical_and.accumulate(steep))[-1]] * _KNOTS)
    value, by_camera = _coordinates(camera, radii)
    covariance = by_camera[:, FREE] @ belief.covariance[np.ix_(FREE, FREE)] @ by_camera[:, FREE].T
    own = np.r_[np.full(len(_SHAPES), _LEAST_VARIANCE), np.zeros(len(_REST))]
    centre = np.isin(np.r_[np.full(len(_SHAPES), -1), _REST], _CENTRE)
    extra = own + centre * (centring * width / 2) ** 2
    return ShapeObservation(source, radii, value, covariance * doubt**2 + np.diag(extra))


def _coordinates(
    camera: KannalaBrandt, radii: Float[np.ndarray, " 5"]
) -> tuple[Float[np.ndarray, " 7"], Float[np.ndarray, "7 9"]]:
    """Shape, m_v, u0, v0 of a camera in the gauge m_u = width / 2, and their derivatives.

    ∂θ/∂k_i at a fixed radius is −θ^(2i−1) / r'(θ).
    """
    theta = np.clip(camera.theta(radii)[0], 1e-3, _CAP)
    slope = np.maximum(camera.radius_derivative(theta), _LEAST_SLOPE * camera.k[0])
    by_theta = 1 / (np.sin(theta) * np.cos(theta))  # of log tan θ
    by_k = -camera.radius_jacobian(theta) * (by_theta / slope)[:, None]
    value = np.concatenate([_SHAPES @ np.log(np.tan(theta)), camera.to_vector()[list(_REST)]])
    by_camera = np.zeros((len(value), 9))
    by_camera[: len(_SHAPES), :5] = _SHAPES @ by_k
    by_camera[np.arange(len(_SHAPES), len(value)), _REST] = 1.0
    return value, by_camera

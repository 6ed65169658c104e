"""What is known of a lens beside its curves: the image circle, a network, the user.

Each is a linear observation of the camera's vector and sharpens the prior by one Kalman update.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from classical.camera import KannalaBrandt
from classical.fit.prior import FREE, LensPrior
from classical.lines.image_circle import ImageCircle

_M_V, _CENTRE = 6, (7, 8)  # of (k1..k5, m_u, m_v, u0, v0)
_KNOWN_FIELD = 0.01  # relative deviation of what a user knows of field or focal length
_ALIKE = 2.0  # observations of one kind err alike: together they count for so many
_ODD = 2 * np.arange(5) + 1
_RIM, _WIDEST = 0.8, 1.6  # half picture widths; radians
_STUDENT = 4.0  # degrees of freedom of a belief that may be plainly wrong


@dataclass(frozen=True, eq=False)
class Observation:
    """matrix @ camera.to_vector() = value, give or take a covariance, in the gauge m_u = width / 2.

    Attributes:
        source: What it comes from, in words.
        matrix: Shape (m, 9), zero in the column of m_u.
        value: Shape (m,).
        covariance: Shape (m, m).
        is_sure: Whether it is held to however far the curves lead away from it; else it loses
            weight with the distance, as under Student's t.
    """

    source: str
    matrix: Float[np.ndarray, "m 9"]
    value: Float[np.ndarray, " m"]
    covariance: Float[np.ndarray, "m m"]
    is_sure: bool = True

    def surprise(self, camera: KannalaBrandt) -> float:
        """Squared Mahalanobis distance of a camera from what was observed."""
        off = self.matrix @ camera.normalized().to_vector() - self.value
        return float(off @ np.linalg.solve(self.covariance, off))

    def near(self, camera: KannalaBrandt) -> Observation:
        """The observation with the weight that it keeps beside this camera."""
        if self.is_sure:
            return self
        excess = (_STUDENT + self.surprise(camera)) / (_STUDENT + len(self.value))
        return replace(self, covariance=self.covariance * max(1.0, excess))

    def precision_along(self, direction: Float[np.ndarray, " 9"]) -> float:
        """Information about a shift of the camera's vector along a direction."""
        seen = self.matrix @ direction
        return float(seen @ np.linalg.solve(self.covariance, seen))


def observed(prior: LensPrior, observation: Observation) -> LensPrior:
    """The belief after an observation."""
    H, C = observation.matrix, prior.covariance
    gain = np.linalg.solve(H @ C @ H.T + observation.covariance, H @ C).T
    mean = prior.mean + gain @ (observation.value - H @ prior.mean)
    covariance = C - gain @ H @ C
    return LensPrior(mean, (covariance + covariance.T) / 2)


def of_circles(circles: Sequence[ImageCircle | None], width: int) -> Observation | None:
    """Principal point and aspect from the image circles of pictures of one lens.

    Args:
        circles: One a picture, None where it shows none.
        width: Picture width in pixels.
    """
    found = [circle for circle in circles if circle is not None]
    if not found:
        return None
    values = np.array([[*circle.centre, circle.aspect] for circle in found])
    precisions = np.array([np.linalg.inv(circle.covariance) for circle in found])
    spread = np.linalg.inv(precisions.sum(axis=0))
    value = spread @ np.einsum("nij,nj->i", precisions, values)
    units = np.array([1.0, 1.0, width / 2])  # aspect to m_v
    spread = spread * max(1.0, len(found) / _ALIKE) * np.outer(units, units)
    return Observation("image circle", _rows([*_CENTRE, _M_V]), value * units, spread)


def of_belief(
    belief: LensPrior, source: str, *, doubt: float = 1.0, centring: float = 0.0
) -> Observation:
    """Another estimate of the whole lens.

    Args:
        belief: The estimate.
        source: Who made it.
        doubt: By how much its deviations are widened.
        centring: Deviation of principal points in half picture widths, for an estimate that takes
            lenses to be centred better than they are.
    """
    half = belief.mean[5]  # m_u, by the gauge
    centre = np.isin(FREE, _CENTRE) * (centring * half) ** 2
    covariance = belief.covariance[np.ix_(FREE, FREE)] * doubt**2 + np.diag(centre)
    return Observation(source, _rows(FREE.tolist()), belief.mean[FREE], covariance, is_sure=False)


def of_belief_field(belief: LensPrior, source: str, *, doubt: float = 1.0) -> Observation:
    """What another estimate says of the field of view alone: r at the angle of its middle rim.

    An estimate of the whole lens may err in the shape of r(θ) and still know how wide it is.
    """
    angles = np.linspace(0.0, _WIDEST, 400)
    radii = np.maximum.accumulate(angles[:, None] ** _ODD @ belief.mean[:5])
    row = np.zeros((1, 9))
    row[0, :5] = float(np.interp(_RIM, radii, angles)) ** _ODD
    spread = row @ belief.covariance @ row.T * doubt**2
    return Observation(source, row, row @ belief.mean, spread, is_sure=False)


def of_focal(focal: float, width: int) -> Observation:
    """A focal length in pixels: r'(0) = k1 m_u."""
    k1 = focal / (width / 2)
    return Observation(
        "the focal length given", _rows([0]), np.array([k1]), np.array([[(_KNOWN_FIELD * k1) ** 2]])
    )


def of_field(fov: float, radius: float, width: int, source: str) -> Observation:
    """A field of view: r(fov / 2) is so many pixels along the picture's width.

    Args:
        fov: Full angle in radians.
        radius: Pixels from the principal point at which half of it is reached.
        width: Picture width in pixels.
        source: What it comes from.
    """
    matrix = np.zeros((1, 9))
    matrix[0, :5] = (fov / 2) ** _ODD
    value = radius / (width / 2)
    return Observation(source, matrix, np.array([value]), np.array([[(_KNOWN_FIELD * value) ** 2]]))


def _rows(columns: Sequence[int]) -> Float[np.ndarray, "m 9"]:
    return np.eye(9)[list(columns)]

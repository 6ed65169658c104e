"""A lens that took a picture reaches all that the picture shows.

r(θ) may turn near the rim of the picture, where no line need run: bends then hold the lens within
and leave open where it turns. An estimate whose r turns half a degree too soon leaves the outermost
pixels without a ray, and nothing but the picture itself tells that they have one.

A picture does not end just where its lens turns: there r' is 0, and a whole ring of the scene would
fall on a line. So the lens is believed to reach a little farther than the picture, and is held to
the picture's rim itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from classical.camera import KannalaBrandt
from classical.camera.ray_field import ray_field
from classical.fit.observations import observed
from classical.fit.overshoot import overshoot, overshoot_jacobian
from classical.fit.prior import LensPrior
from classical.fit.scale import held_scale

FALLS_SHORT = "the lens found does not reach the rim of the picture"
_MARGIN = 0.03  # by which a lens reaches beyond the rim, as a share of its radius, …
_DOUBT = 0.005  # … and the standard deviation of that belief
_FARTHEST = 3.0  # standard deviations within which an estimate may yet be moved to the rim
_STEPS = 3
_NEGLIGIBLE = 1e-3  # pixels
_SHOWN = np.radians(75.0)  # no frame takes in more by itself


class Reaching(NamedTuple):
    """A camera, and whether it reaches the rim."""

    camera: KannalaBrandt
    reaches: bool


class _Shortage(NamedTuple):
    """How many pixels a lens falls short of a radius (negative beyond), and its gradient."""

    pixels: float
    gradient: Float[np.ndarray, " 9"]
    radius: float


def within_reach(
    camera: KannalaBrandt, covariance: Float[np.ndarray, "9 9"], rim: Float[np.ndarray, "n 2"]
) -> Reaching:
    """The nearest lens that reaches all that the pictures show.

    The rim tells no scale, so that is held. It is for lenses that turn near their axis: one that
    turns far out, at the soft border of its image circle, loses nothing that a flat picture shows.

    Args:
        camera: The estimate.
        covariance: Of its vector.
        rim: The outermost pixels that the pictures show.
    """
    if not len(rim) or camera.theta_max >= _SHOWN:
        return Reaching(camera, True)
    camera = camera.normalized()
    belief = LensPrior(camera.to_vector(), covariance)
    return reaching(camera, observed(belief, held_scale(camera)).covariance, rim)


def reaching(
    camera: KannalaBrandt, covariance: Float[np.ndarray, "9 9"], rim: Float[np.ndarray, "n 2"]
) -> Reaching:
    """The lens nearest to `camera`, by its covariance, that reaches the rim.

    Where r turns it changes in the second order only with the angle, so how far a lens reaches is
    linear in its vector: the belief is one Kalman update, and the rim itself one of no doubt.

    Args:
        camera: The estimate in the gauge m_u = width / 2.
        covariance: Of its vector.
        rim: The outermost pixels that the picture shows.

    Returns:
        `camera` itself where it turns well beyond the rim or not at all, and where all lenses that
        reach the rim are too far away to be believed.
    """
    if _shortage(camera, rim, _MARGIN).pixels <= 0:
        return Reaching(camera, True)
    at_rim = _shortage(camera, rim, 0.0)
    variance = float(at_rim.gradient @ covariance @ at_rim.gradient)
    if not variance > 0 or at_rim.pixels > _FARTHEST * np.sqrt(variance):
        return Reaching(camera, at_rim.pixels <= 0)
    moved = _moved(camera, covariance, rim, _MARGIN, _DOUBT)
    for _ in range(_STEPS):
        if _shortage(moved, rim, 0.0).pixels <= 0:
            return Reaching(moved, True)
        moved = _moved(moved, covariance, rim, 0.0, 0.0)
    return Reaching(camera, at_rim.pixels <= 0)


def _moved(
    camera: KannalaBrandt,
    covariance: Float[np.ndarray, "9 9"],
    rim: Float[np.ndarray, "n 2"],
    margin: float,
    doubt: float,
) -> KannalaBrandt:
    """The camera after one observation: it reaches the rim and a margin, give or take a doubt."""
    short = _shortage(camera, rim, margin)
    along = covariance @ short.gradient
    spread = float(short.gradient @ along) + (doubt * short.radius) ** 2
    vector = camera.to_vector() - along * ((short.pixels + _NEGLIGIBLE) / spread)
    return KannalaBrandt.from_vector(vector, camera.width, camera.height)


def _shortage(camera: KannalaBrandt, rim: Float[np.ndarray, "n 2"], margin: float) -> _Shortage:
    """By how much the lens fails to reach the farthest point of the rim and a margin beyond."""
    axis = np.array([camera.u0, camera.v0])
    farthest = rim[np.argmax(np.hypot(*((rim - axis) / [camera.m_u, camera.m_v]).T))]
    u, v = axis + (farthest - axis) * (1 + margin)
    field, _ = ray_field(camera, np.array([u]), np.array([v]))
    return _Shortage(
        float(overshoot(camera, field)[0]),
        overshoot_jacobian(camera, field)[:, 0],
        float(field.radius[0] * camera.m_u),
    )

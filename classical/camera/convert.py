"""From one camera model to the nearest of another, and how near that is.

Kannala–Brandt is converted to the one-parameter division model (two numbers to fit: λ and the focal
length that comes with it) and to Scaramuzza's polynomial; any radially symmetric camera to
Kannala–Brandt.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from classical.camera.base import Camera, pixel_grid
from classical.camera.division import Division
from classical.camera.kannala_brandt import N_COEFFICIENTS, KannalaBrandt
from classical.camera.ocam import Ocam

_SAMPLES = 128
_GRID = 48  # points a side at which a conversion is judged
_OCAM_DEGREES = range(4, 13)  # OCamCalib's own default is 4
_OCAM_INVERSE_DEGREES = range(5, 21)
_OCAM_ERROR = 0.01  # pixels; the lowest degree with less is taken, as OCamCalib's findinvpoly does
_FARTHEST = np.pi * 0.98  # the polynomial f has a pole at 180°


class Residual(NamedTuple):
    """How far a converted camera puts points from where they belong, over the picture; pixels."""

    rms_px: float
    max_px: float


@runtime_checkable
class CentredCamera(Camera, Protocol):
    """A camera that is symmetric about its principal point."""

    @property
    def u0(self) -> float:
        """Principal point, pixels."""
        ...

    @property
    def v0(self) -> float:
        """Principal point, pixels."""
        ...


def conversion_residual(lens: KannalaBrandt, converted: Camera) -> Residual:
    """Distances between where the two cameras see the same rays, both ways.

    Taken on a grid over the picture, where `lens` reaches; a ray that `converted` does not see
    counts with the distance to where it would put it.

    Raises:
        ValueError: If the lens reaches no point of the grid.
    """
    columns = np.linspace(0, lens.width - 1, _GRID)
    rows = np.linspace(0, lens.height - 1, _GRID)
    points = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    rays, valid = lens.unproject(points)
    if not valid.any():
        raise ValueError("Expected a lens that reaches some of its picture, got none.")
    there = converted.project(rays[valid])[0] - points[valid]
    back = lens.project(converted.unproject(points[valid])[0])[0] - points[valid]
    errors = np.maximum(np.hypot(*there.T), np.hypot(*back.T))
    return Residual(float(np.sqrt((errors**2).mean())), float(errors.max()))


def radial_coefficients(
    theta: Float[np.ndarray, " n"], radius: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " 5"]:
    """The k1..k5 whose r(θ) comes nearest to the given radii, by linear least squares."""
    powers = theta[:, None] ** (2 * np.arange(N_COEFFICIENTS) + 1)
    return np.linalg.lstsq(powers, radius, rcond=1e-10)[0]


def nearest_kannala_brandt(camera: CentredCamera, *, aspect: float = 1.0) -> KannalaBrandt:
    """The Kannala–Brandt lens that sees a camera's picture most alike.

    Args:
        camera: A camera symmetric about (u0, v0), such as `Division` or `Ocam`.
        aspect: Its pixels along v for one along u.

    Raises:
        ValueError: If the camera sees nothing, or its angles do not grow from the centre outwards.
    """
    corners = [(u, v) for u in (0.0, camera.width - 1.0) for v in (0.0, camera.height - 1.0)]
    farthest = max(np.hypot(u - camera.u0, (v - camera.v0) / aspect) for u, v in corners)
    radius = farthest * (np.arange(_SAMPLES) + 1) / _SAMPLES
    points = np.column_stack([camera.u0 + radius, np.full(_SAMPLES, camera.v0)])
    rays, valid = camera.unproject(points)
    theta = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    if not valid[0] or (np.diff(theta[valid]) <= 0).any():
        raise ValueError("Expected a camera whose angles grow outwards, got one that folds back.")
    half = camera.width / 2
    k = radial_coefficients(theta[valid], radius[valid] / half)
    return KannalaBrandt(k, half, half * aspect, camera.u0, camera.v0, camera.width, camera.height)


def nearest_division(lens: KannalaBrandt) -> Division:
    """The one-parameter division model that sees the picture most alike, with its focal length.

    Least squares of distances in the picture over its pixels; see `conversion_residual` for what is
    left. Square pixels are assumed, as the model has no other.

    Raises:
        ValueError: If the lens reaches no pixel.
    """
    from scipy.optimize import least_squares  # slow to import, and `learned` does without

    step = max(1, min(lens.width, lens.height) // _GRID)
    points = pixel_grid(lens.width // step, lens.height // step) * step
    rays, valid = lens.unproject(points)
    points, rays = points[valid], rays[valid]
    if len(points) == 0:
        raise ValueError("Expected a lens that reaches some of its picture, got none.")
    half = lens.width / 2

    def model(parameters: np.ndarray) -> Division:
        scaled, log_focal = (float(value) for value in parameters)
        focal = float(np.exp(log_focal))
        size = (lens.width, lens.height)
        return Division(scaled / half**2, lens.u0, lens.v0, *size, focal=focal)

    def residuals(parameters: np.ndarray) -> np.ndarray:
        return (model(parameters).project(rays)[0] - points).ravel()

    start = np.array([-0.25, np.log(lens.k[0] * lens.m_u)])
    return model(least_squares(residuals, start, x_scale=[0.1, 0.1]).x)


def nearest_ocam(lens: KannalaBrandt) -> Ocam:
    """Scaramuzza's polynomials of the lowest degrees that come within 0.01 px, or the nearest.

    Linear least squares, weighted so that errors count as pixels.
    """
    aspect = lens.m_v / lens.m_u
    corners = [(u, v) for u in (0.0, lens.width) for v in (0.0, lens.height)]
    farthest = max(np.hypot(u - lens.u0, (v - lens.v0) / aspect) for u, v in corners)
    theta_end, reached = lens.theta(np.array([farthest / lens.m_u]))
    end = min(float(theta_end[0]), _FARTHEST) if reached[0] else min(lens.theta_max, _FARTHEST)
    theta = np.linspace(0.0, end, 4 * _SAMPLES + 1)[1:]
    radius = lens.m_u * lens.radius(theta)
    slope = lens.m_u * lens.radius_derivative(theta)
    forward = radius / np.tan(theta)
    by_forward = slope * radius / (radius**2 + forward**2)  # pixels a unit of f: dθ = −ρ df / …
    no_linear = np.array([0, *range(2, _OCAM_DEGREES.stop)])  # f'(0) = 0, or the lens has a tip
    direct = _lowest_degree(
        _OCAM_DEGREES, lambda degree: no_linear[:degree], radius, -forward, by_forward
    )
    everything = np.arange(_OCAM_INVERSE_DEGREES.stop)
    axis = np.concatenate([[0.0], theta])
    inverse = _lowest_degree(
        _OCAM_INVERSE_DEGREES,
        lambda degree: everything[: degree + 1],
        axis - np.pi / 2,
        np.concatenate([[0.0], radius]),
        np.ones_like(axis),
    )
    return Ocam(direct, inverse, lens.u0, lens.v0, aspect, lens.width, lens.height)


def _lowest_degree(
    degrees: range,
    powers_of: Callable[[int], np.ndarray],
    x: np.ndarray,
    y: np.ndarray,
    weight: np.ndarray,
) -> np.ndarray:
    """Coefficients of the first polynomial within `_OCAM_ERROR`, or of the best."""
    best, least = np.zeros(1), np.inf
    scale = np.abs(x).max()
    for degree in degrees:
        powers = powers_of(degree)
        basis = (x[:, None] / scale) ** powers
        found = np.linalg.lstsq(basis * weight[:, None], y * weight, rcond=None)[0]
        error = float(np.abs((basis @ found - y) * weight).max())
        if error < least:
            best, least = np.zeros(powers[-1] + 1), error
            best[powers] = found / scale ** powers.astype(float)
        if error < _OCAM_ERROR:
            break
    return best

"""The image circle of a fisheye lens: where its picture ends on a larger sensor.

The circle is cut by the lens barrel, around the optical axis. Its centre so tells the principal
point, which straight lines hardly tell (a shift looks like a turn of the camera), and its shape
the aspect of the pixels. What is dark at the border of the scene only hides a piece of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from scipy.optimize import least_squares

_SIZE = 640  # longest side of the picture in which the border is sought, pixels
_RAYS = 720
_TRIALS = 200
_ASPECT_DEVIATION = 0.03  # belief before the border is seen
_LEAST_ASPECT = 0.85
# standard deviations at which border points lose weight, and within which they are on the circle
_INNER_TAIL, _OUTER_TAIL, _ON_IT = 1.0, 3.0, 2.5


@dataclass(frozen=True)
class ImageCircleConfig:
    """What counts as an image circle; lengths as shares of its radius.

    Attributes:
        darkest: Grey level up to which a surround may go.
        contrasts: Grey levels by which the picture inside must exceed the surround. At a sharp
            border all give one circle; how far they differ tells how soft it is.
        spread: Standard deviation of a border point; dark things in the scene move some of them
            inwards, so points inside lose their weight sooner than points outside.
        decentring: Standard deviation of the optical axis from the centre of the circle.
        least_coverage: Turn over which border points must be seen, radians …
        least_share: … and share of the points with a dark surround that must lie on one circle.
        max_offset: Largest distance of the centre from the picture's, as a share of its width.
        pieces: Border points err alike over stretches; so many stretches are independent.
    """

    darkest: float = 40.0
    contrasts: tuple[float, float] = (12.0, 30.0)
    spread: float = 0.006
    decentring: float = 0.01
    least_coverage: float = 1.0
    least_share: float = 0.5
    max_offset: float = 0.12
    pieces: int = 24


@dataclass(frozen=True, eq=False)
class ImageCircle:
    """The border of the picture on the sensor: ((u − u0) / r)² + ((v − v0) / (a r))² = 1.

    Attributes:
        centre: (u0, v0) in pixels, shape (2,).
        radius: r in pixels, along u.
        aspect: a = m_v / m_u.
        covariance: Of (u0, v0, a), as they stand for the camera's, shape (3, 3).
        coverage: Turn over which the border is seen, radians.
    """

    centre: Float[np.ndarray, " 2"]
    radius: float
    aspect: float
    covariance: Float[np.ndarray, "3 3"]
    coverage: float


def find_image_circle(
    image: UInt8[np.ndarray, "h w *c"], *, config: ImageCircleConfig = ImageCircleConfig()
) -> ImageCircle | None:
    """Find the border between the picture and the dark surround that the lens leaves.

    Args:
        image: Grey (h, w) or RGB (h, w, 3), 8 bits.
        config: What counts as an image circle.

    Returns:
        The circle in pixels of `image`, or None where there is none.
    """
    height, width = image.shape[:2]
    scale = min(1.0, _SIZE / max(height, width))
    size = (max(8, round(width * scale)), max(8, round(height * scale)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    bright = cv2.medianBlur(reduce(cv2.max, cv2.split(small)), 3)
    dark = _surround_level(bright, config)
    if dark is None:
        return None
    fits = []
    for contrast in config.contrasts:
        points = _border_points(bright, dark + contrast, config)
        fit = None if points is None else _fitted(points, config)
        if fit is None:
            return None
        fits.append(fit)
    first, second = fits
    softness = np.subtract(first.value, second.value)
    covariance = first.covariance + np.outer(softness, softness)
    u0, v0, radius, aspect = first.value
    middle = np.array([(size[0] - 1) / 2, (size[1] - 1) / 2])
    if np.abs(first.value[:2] - middle).max() > config.max_offset * size[0]:
        return None
    stretch = np.array([width / size[0], height / size[1]])
    ratio = stretch[1] / stretch[0]
    units = np.array([*stretch, ratio])
    kept = np.ix_([0, 1, 3], [0, 1, 3])
    decentred = np.diag([config.decentring * radius, config.decentring * radius, 1e-3]) ** 2
    return ImageCircle(
        (np.array([u0, v0]) + 0.5) * stretch - 0.5,
        float(radius * stretch[0]),
        float(aspect * ratio),
        (covariance[kept] + decentred) * np.outer(units, units),
        first.coverage,
    )


def _surround_level(bright: UInt8[np.ndarray, "h w"], config: ImageCircleConfig) -> float | None:
    """Grey level of the dark corners, or None unless two or more are dark."""
    patch = max(3, min(bright.shape) // 40)
    ends = (slice(patch), slice(-patch, None))
    levels = [float(np.quantile(bright[rows, columns], 0.9)) for rows in ends for columns in ends]
    dark = [level for level in levels if level <= config.darkest]
    return max(dark) if len(dark) >= 2 else None


def _border_points(
    bright: UInt8[np.ndarray, "h w"], level: float, config: ImageCircleConfig
) -> Float[np.ndarray, "n 2"] | None:
    """The outermost point above the level on each ray from the middle that ends below it."""
    height, width = bright.shape
    middle = ((width - 1) / 2, (height - 1) / 2)
    reach = int(np.ceil(np.hypot(*middle))) + 1
    flags = cv2.WARP_POLAR_LINEAR | cv2.INTER_LINEAR
    polar = cv2.warpPolar(bright, (reach, _RAYS), middle, reach, flags).astype(np.float64)
    angle = np.arange(_RAYS) * (2 * np.pi / _RAYS)
    cosine, sine = np.cos(angle), np.sin(angle)
    end = np.minimum(
        middle[0] / np.maximum(np.abs(cosine), 1e-9), middle[1] / np.maximum(np.abs(sine), 1e-9)
    )  # where the ray leaves the picture
    seen = (polar > level) & (np.arange(reach) <= end[:, None])
    last = reach - 1 - np.argmax(seen[:, ::-1], axis=1)
    room = max(2.0, 0.01 * min(width, height))
    rays = np.flatnonzero(seen.any(axis=1) & (last < end - room))
    if len(rays) < _RAYS * config.least_coverage / (2 * np.pi):
        return None
    here, beyond = polar[rays, last[rays]], polar[rays, last[rays] + 1]
    radius = last[rays] + np.clip((here - level) / np.maximum(here - beyond, 1e-9), 0, 1)
    return np.column_stack([middle[0] + radius * cosine[rays], middle[1] + radius * sine[rays]])


class _Ellipse(NamedTuple):
    """(u0, v0, r, a) with its covariance and the turn over which it is seen."""

    value: Float[np.ndarray, " 4"]
    covariance: Float[np.ndarray, "4 4"]
    coverage: float


def _fitted(points: Float[np.ndarray, "n 2"], config: ImageCircleConfig) -> _Ellipse | None:
    """A robust ellipse with upright axes through the border points; None if few agree."""
    start = _consensus(points, config)
    if start is None:
        return None
    spread = config.spread * start[2]
    belief = np.sqrt(len(points) / config.pieces) / _ASPECT_DEVIATION  # counts as one piece

    def residuals(x: np.ndarray) -> np.ndarray:
        return (np.hypot(points[:, 0] - x[0], (points[:, 1] - x[1]) / x[3]) - x[2]) / spread

    def with_belief(x: np.ndarray) -> np.ndarray:
        return np.append(residuals(x), belief * (x[3] - 1))

    def loss(squared: np.ndarray) -> np.ndarray:
        tail = np.where(np.append(inside, False), _INNER_TAIL, _OUTER_TAIL) ** 2
        ratio = 1 + squared / tail
        return np.stack([tail * np.log(ratio), 1 / ratio, -1 / (tail * ratio**2)])

    x, jacobian = start, np.empty((0, 4))
    for _ in range(3):
        inside = residuals(x) < 0
        found = least_squares(
            with_belief,
            x,
            loss=loss,  # pyright: ignore[reportArgumentType]
            x_scale=[start[2]] * 3 + [1.0],
            max_nfev=20,
        )
        x, jacobian = found.x, found.jac
    on_it = np.abs(residuals(x)) < _ON_IT
    direction = np.arctan2((points[on_it, 1] - x[1]) / x[3], points[on_it, 0] - x[0])
    coverage = len(np.unique(np.floor(direction * 90 / np.pi))) * (np.pi / 90)
    enough = coverage >= config.least_coverage and on_it.mean() >= config.least_share
    if not enough or not _LEAST_ASPECT < x[3] < 1 / _LEAST_ASPECT:
        return None
    information = jacobian.T @ jacobian * (config.pieces / len(points))
    return _Ellipse(x, np.linalg.inv(information), coverage)


def _consensus(
    points: Float[np.ndarray, "n 2"], config: ImageCircleConfig
) -> Float[np.ndarray, " 4"] | None:
    """The circle through three border points that most points lie on: (u0, v0, r, 1)."""
    rng = np.random.default_rng(0)
    first, second, third = points[rng.integers(0, len(points), (3, _TRIALS))]
    a, b = second - first, third - first
    cross = 2 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    bent = np.abs(cross) > 0.05 * np.hypot(*a.T) * np.hypot(*b.T)
    if not bent.any():
        return None
    first, a, b, cross = first[bent], a[bent], b[bent], cross[bent]
    aa, bb = (a * a).sum(axis=1), (b * b).sum(axis=1)
    offset = (
        np.stack([b[:, 1] * aa - a[:, 1] * bb, a[:, 0] * bb - b[:, 0] * aa], 1) / cross[:, None]
    )
    centre, radius = first + offset, np.hypot(*offset.T)
    few = points[:: max(1, len(points) // 180)]
    off = np.abs(np.hypot(*(few[None] - centre[:, None]).transpose(2, 0, 1)) - radius[:, None])
    count = (off < 3 * config.spread * radius[:, None]).sum(axis=1)
    best = int(np.argmax(count))
    return np.array([*centre[best], radius[best], 1.0])

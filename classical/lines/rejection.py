"""Curves that are no image of a straight line, told without knowing the lens.

The image of a line under a radially symmetric lens bends to one side, bulges away from the centre
of distortion, and bends no more than a great circle seen through a strong fisheye. The border of
the image circle obeys this too, so it is told by the dark or even surround beyond it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from classical.lines.circle import CircleConfig

_MASK_SIZE = 400  # longest side of the picture in which the surround is sought, pixels


@dataclass(frozen=True)
class RejectionConfig:
    """What no lens could have made.

    Attributes:
        centre_shift: Largest offset of the distortion centre from the picture's centre, as a share
            of the picture's shorter side.
        strongest_angle: Field angle at the outermost pixel of the strongest lens, radians.
        excess_bend: Bends up to this many times that of the strongest lens are let pass.
        slack: Bend in the wrong direction that is let pass, pixels, …
        slack_per_length: … plus this share of the chord.
        rim: Width of the zone around the border of the image circle, as a share of its radius.
        frame: Width of the zone along the picture's frame, pixels.
        circle: What counts as the border of an image circle.
    """

    centre_shift: float = 0.1
    strongest_angle: float = 1.75
    excess_bend: float = 1.25
    slack: float = 0.6
    slack_per_length: float = 0.002
    rim: float = 0.02
    frame: float = 4.0
    circle: CircleConfig = field(default_factory=CircleConfig)


@dataclass(frozen=True)
class Surround:
    """The even region around an image circle.

    Attributes:
        width: Picture width, pixels.
        height: Picture height, pixels.
        inside: Distance from each pixel of a reduced picture to the surround, in pixels of the
            full picture; infinite if there is no surround.
        scale: Reduced pixels per pixel.
        radius: Distance from the picture's centre to the farthest pixel inside.
    """

    width: int
    height: int
    inside: Float[np.ndarray, "h w"]
    scale: float
    radius: float


def find_surround(grey: Float[np.ndarray, "h w"]) -> Surround:
    """Find the even region that touches the picture's corners, if there is one.

    Args:
        grey: Grey levels 0…255, float32.
    """
    height, width = grey.shape
    scale = min(1.0, _MASK_SIZE / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    small = np.clip(cv2.medianBlur(small, 3), 0, 255).astype(np.uint8)
    outside = _flood_corners(small)
    half_diagonal = 0.5 * float(np.hypot(height, width))
    if outside.mean() < 0.01:
        return Surround(width, height, np.full(small.shape, np.inf), scale, half_diagonal)
    inside = cv2.distanceTransform((~outside).astype(np.uint8), cv2.DIST_L2, 5) / scale
    v, u = np.nonzero(~outside)
    offset = np.hypot(u - (size[0] - 1) / 2, v - (size[1] - 1) / 2)
    radius = float(np.quantile(offset, 0.999)) / scale if len(offset) else half_diagonal
    return Surround(width, height, inside, scale, min(radius, half_diagonal))


def _flood_corners(small: np.ndarray, tolerance: int = 6) -> np.ndarray:
    """Pixels connected to a corner through small steps of brightness."""
    height, width = small.shape
    mask = np.zeros((height + 2, width + 2), np.uint8)
    flags = 4 | cv2.FLOODFILL_MASK_ONLY | cv2.FLOODFILL_FIXED_RANGE | (1 << 8)
    for u, v in ((0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)):
        patch = small[max(0, v - 4) : v + 5, max(0, u - 4) : u + 5]
        if patch.max() <= 48 and mask[v + 1, u + 1] == 0:
            step = max(tolerance, int(patch.max()) - int(small[v, u]) + 8)
            cv2.floodFill(small, mask, (u, v), 0, step, step, flags)
    return mask[1:-1, 1:-1] > 0


def beside_surround(
    points: Float[np.ndarray, "m 2"],
    offsets: Int[np.ndarray, " p1"],
    surround: Surround,
    *,
    config: RejectionConfig,
) -> Bool[np.ndarray, " p"]:
    """True for curves that run along the border of the image circle or beyond it."""
    height, width = surround.inside.shape
    cell = np.round((points + 0.5) * surround.scale - 0.5).astype(int)
    u, v = np.clip(cell[:, 0], 0, width - 1), np.clip(cell[:, 1], 0, height - 1)
    margin = config.rim * surround.radius + 1.5 / surround.scale
    near = (surround.inside[v, u] < margin).astype(float)
    return np.asarray(np.add.reduceat(near, offsets[:-1]) > 0.5 * np.diff(offsets))


def beside_frame(
    points: Float[np.ndarray, "m 2"],
    offsets: Int[np.ndarray, " p1"],
    width: int,
    height: int,
    *,
    config: RejectionConfig,
) -> Bool[np.ndarray, " p"]:
    """True for curves that run along the frame of the picture."""
    u, v = points.T
    edge = np.minimum(np.minimum(u, width - 1 - u), np.minimum(v, height - 1 - v))
    near = (edge < config.frame).astype(float)
    return np.asarray(np.add.reduceat(near, offsets[:-1]) > 0.5 * np.diff(offsets))


def impossible_bend(
    points: Float[np.ndarray, "m 2"],
    offsets: Int[np.ndarray, " p1"],
    width: int,
    height: int,
    radius: float,
    *,
    config: RejectionConfig,
) -> Bool[np.ndarray, " p"]:
    """True for curves that bend as no line can under a lens centred near the picture's middle.

    The bow of each curve (its height above the chord) is compared with the bows of the great
    circles through its ends, for equidistant lenses from none to the strongest and for centres on
    a 3x3 grid.

    Args:
        points: Points in order along curves, shape (m, 2).
        offsets: Curve p is points[offsets[p] : offsets[p + 1]], shape (p + 1,).
        width: Picture width, pixels.
        height: Picture height, pixels.
        radius: Distance of the outermost pixel that the lens reaches from the centre, pixels.
        config: What no lens could have made.
    """
    ends = points[offsets[:-1]], points[offsets[1:] - 1]
    chord = ends[1] - ends[0]
    length = np.maximum(np.hypot(*chord.T), 1e-9)
    bow = 1.5 * _mean_rise(points, offsets, ends[0], chord / length[:, None])
    focal = radius / config.strongest_angle
    shift = config.centre_shift * min(width, height)
    bows = [np.zeros(len(bow))]
    for du in (-shift, 0.0, shift):
        for dv in (-shift, 0.0, shift):
            centre = np.array([(width - 1) / 2 + du, (height - 1) / 2 + dv])
            bows.append(_great_circle_bow(ends[0] - centre, ends[1] - centre, focal))
    slack = config.slack + config.slack_per_length * length
    low = config.excess_bend * np.min(bows, axis=0) - slack
    high = config.excess_bend * np.max(bows, axis=0) + slack
    return np.asarray((bow < low) | (bow > high))


def _mean_rise(
    points: np.ndarray, offsets: np.ndarray, start: np.ndarray, direction: np.ndarray
) -> np.ndarray:
    """Mean signed height of each curve above its chord; 2/3 of the bow of a parabola."""
    counts = np.diff(offsets)
    sums = np.add.reduceat(points, offsets[:-1]) / counts[:, None] - start
    return direction[:, 0] * sums[:, 1] - direction[:, 1] * sums[:, 0]


def _great_circle_bow(a: np.ndarray, b: np.ndarray, focal: float) -> np.ndarray:
    """Signed height above its chord of the line's image through a and b, equidistant lens."""
    middle = _equidistant_ray(a, focal) + _equidistant_ray(b, focal)
    across = np.hypot(middle[:, 0], middle[:, 1])
    radius = focal * np.arctan2(across, middle[:, 2])
    point = middle[:, :2] * (radius / np.maximum(across, 1e-12))[:, None]
    chord, rel = b - a, point - a
    length = np.maximum(np.hypot(*chord.T), 1e-9)
    return (chord[:, 0] * rel[:, 1] - chord[:, 1] * rel[:, 0]) / length


def _equidistant_ray(offset: np.ndarray, focal: float) -> np.ndarray:
    """Unit ray of a point `offset` pixels from the centre, r = f θ."""
    radius = np.hypot(*offset.T)
    theta = np.minimum(radius / focal, np.pi)
    planar = offset * (np.sin(theta) / np.maximum(radius, 1e-12))[:, None]
    return np.column_stack([planar, np.cos(theta)])

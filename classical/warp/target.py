"""The rectilinear camera that a fisheye picture is turned into.

A pinhole cannot show 90°, and already near 80° it stretches the rim without bound; so the frame is
chosen in the plane z = 1 from the border of the picture with its angles capped, which gives a sane
camera for any lens.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from classical.camera import Pinhole
from classical.camera.base import check_size
from classical.warp.maps import AnyCamera

MAX_FOV = 175.0  # degrees; the widest frame that can be asked for
CORNER_ANGLE_FULL = math.radians(65.0)  # largest angle of the frame with balance 0
CORNER_ANGLE_WIDE = math.radians(75.0)  # largest angle taken in with balance 1
_BORDER_SAMPLES = 128  # a side
_CENTRE_GRID = 9
_REFINEMENTS = 12
_FAR = np.array([-1.0, -1.0, 1.0, 1.0]) * 1e9  # pixels; where the picture alone is the bound
_SAFETY = 1e-4  # relative; keeps the frame off the border by less than a pixel


def pinhole_target(
    camera: AnyCamera,
    *,
    focal: float | None = None,
    fov: float | None = None,
    balance: float | None = None,
    size: tuple[int, int] | None = None,
) -> Pinhole:
    """Choose the pinhole camera of the rectified picture, with square pixels.

    At most one of `focal`, `fov` and `balance` may be given; without any, balance is 0. With
    `focal` or `fov` the optical axis is in the middle of the frame (the paper's protocol:
    `focal=160, size=(320, 320)`). With `balance` the frame also moves to where the picture is.

    Args:
        camera: The camera of the fisheye picture.
        focal: Focal length in pixels of the new frame.
        fov: Horizontal field of view of the new frame in degrees, below 175.
        balance: 0 shows the largest frame without an empty pixel, its corners at most 65° off the
            axis; 1 shows all of the picture that lies within 75° of the axis; between, the focal
            length changes geometrically.
        size: (width, height) of the new frame; None keeps the size of the picture.

    Raises:
        ValueError: If more than one of the three is given, a value is out of range, or no part of
            the picture can be shown by a pinhole.
    """
    width, height = size if size is not None else (camera.width, camera.height)
    check_size(width, height)
    if sum(option is not None for option in (focal, fov, balance)) > 1:
        raise ValueError(
            "Expected at most one of focal, fov and balance, got "
            f"focal={focal}, fov={fov}, balance={balance}."
        )
    if focal is not None:
        return Pinhole.centred(focal, width, height)
    if fov is not None:
        if not 0 < fov <= MAX_FOV:
            raise ValueError(f"Expected a field of view in (0, {MAX_FOV:g}] degrees, got {fov}.")
        return Pinhole.centred(width / 2 / math.tan(math.radians(fov) / 2), width, height)
    balance = 0.0 if balance is None else balance
    if not 0 <= balance <= 1:
        raise ValueError(f"Expected a balance in [0, 1], got {balance}.")
    return _balanced(camera, balance, width, height)


def _balanced(camera: AnyCamera, balance: float, width: int, height: int) -> Pinhole:
    """Between the largest full frame and the one that holds everything."""
    half = np.array([width / 2, height / 2])
    full_centre, full_focal = _full_frame(camera, half)
    if balance == 0:
        centre, focal = full_centre, full_focal
    else:
        wide = _border(camera, CORNER_ANGLE_WIDE)
        low, high = wide.min(axis=0), wide.max(axis=0)
        wide_focal = min(float((half / np.maximum((high - low) / 2, 1e-9)).min()), full_focal)
        centre = (1 - balance) * full_centre + balance * (low + high) / 2
        focal = full_focal ** (1 - balance) * wide_focal**balance
    principal = half - 0.5 - focal * centre
    return Pinhole(focal, focal, float(principal[0]), float(principal[1]), width, height)


def _full_frame(camera: AnyCamera, half: Float[np.ndarray, "2"]) -> tuple[np.ndarray, float]:
    """Centre in the plane z = 1 and focal length of the largest frame without an empty pixel.

    Around a point of the picture, the largest frame of the given shape is bounded by the nearest
    border point in the maximum norm (the picture has no holes); the point is found by a grid over
    the picture and shrinking steps around the best.
    """
    border = _border(camera, CORNER_ANGLE_FULL) / half
    candidates = _plane(camera, _grid(camera, CORNER_ANGLE_FULL), CORNER_ANGLE_FULL)[0] / half
    if len(candidates) == 0:
        raise ValueError(
            "Expected a part of the picture within "
            f"{math.degrees(CORNER_ANGLE_FULL):g}° of the optical axis, got none."
        )
    room = _room(candidates, border)
    # among equals the one next to the optical axis, so that a centred lens gives a centred frame
    near = np.linalg.norm(candidates, axis=1)
    best = int(np.lexsort([near, -np.round(room / room.max(), 6)])[0])
    centre, reach = candidates[best], float(room[best])
    step = float(np.ptp(candidates, axis=0).max()) / _CENTRE_GRID
    for _ in range(_REFINEMENTS):
        around = centre + step * _STAR
        room = _room(around, border)
        best = int(room.argmax())
        if room[best] > reach * (1 + 1e-6):
            centre, reach = around[best], float(room[best])
        else:
            step /= 2
    return centre * half, (1 + _SAFETY) / reach


_STAR = np.array([[x, y] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0) if x or y])


def _room(
    centres: Float[np.ndarray, "m 2"], border: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, " m"]:
    """Distance of each centre from the border, a closed polygon, in the maximum norm.

    Along a side the norm is least at an end or where a diagonal through the centre crosses it.
    """
    x, y = np.moveaxis(border[None] - centres[:, None], -1, 0)
    room = np.maximum(np.abs(x), np.abs(y)).min(axis=1)
    for across in (x - y, x + y):
        onwards = np.roll(across, -1, axis=1) - across
        at = np.clip(-across / np.where(onwards == 0, 1.0, onwards), 0.0, 1.0)
        crossing = [axis + at * (np.roll(axis, -1, axis=1) - axis) for axis in (x, y)]
        room = np.minimum(room, np.abs(crossing).max(axis=0).min(axis=1))
    return room


def _border(camera: AnyCamera, cap: float) -> Float[np.ndarray, "n 2"]:
    """The outline of the picture in the plane z = 1, its angles at most `cap`."""
    low, high = _window(camera, cap)
    along = np.linspace(0.0, 1.0, _BORDER_SAMPLES, endpoint=False)
    u = np.concatenate([along, np.ones_like(along), 1 - along, np.zeros_like(along)])
    v = np.concatenate([np.zeros_like(along), along, np.ones_like(along), 1 - along])
    return _plane(camera, low + np.stack([u, v], axis=1) * (high - low), cap)[1]


def _grid(camera: AnyCamera, cap: float) -> Float[np.ndarray, "n 2"]:
    """Points spread over the picture, the one next to the optical axis among them."""
    low, high = _window(camera, cap)
    along = np.linspace(0.0, 1.0, _CENTRE_GRID + 2)[1:-1]
    steps = np.stack([axis.ravel() for axis in np.meshgrid(along, along)], axis=1)
    axis = np.clip([camera.u0, camera.v0], low, high)
    return np.vstack([low + steps * (high - low), axis])


def _window(camera: AnyCamera, cap: float) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the part of the picture around what lies within `cap` of the axis.

    A lens may see no more than a few pixels of a large picture, or a sliver at its side.
    """
    angle = min(cap, getattr(camera, "theta_max", cap)) * (1 - 1e-9)
    sine, cosine = math.sin(angle), math.cos(angle)
    towards = np.array(
        [[-sine, 0, cosine], [0, -sine, cosine], [sine, 0, cosine], [0, sine, cosine]]
    )
    points, seen = camera.project(towards)
    left, top, right, bottom = np.where(seen, points[[0, 1, 2, 3], [0, 1, 0, 1]], _FAR)
    low = np.maximum([left, top], -0.5)
    high = np.minimum([right, bottom], [camera.width - 0.5, camera.height - 0.5])
    if (low >= high).any():
        raise ValueError(
            f"Expected a part of the picture within {math.degrees(cap):g}° of the optical axis, "
            "got none."
        )
    return low, high


def _plane(camera: AnyCamera, points: np.ndarray, cap: float) -> tuple[np.ndarray, np.ndarray]:
    """Pixels in the plane z = 1: those within `cap` of the axis, and all of them capped."""
    rays, valid = camera.unproject(points)
    across = np.hypot(rays[:, 0], rays[:, 1])
    theta = np.arctan2(across, rays[:, 2])
    stretch = np.tan(np.minimum(theta, cap)) / np.where(across > 0, across, 1.0)
    plane = rays[:, :2] * stretch[:, None]
    return plane[valid & (theta < cap)], plane

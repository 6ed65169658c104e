"""Geometric error of an estimated lens: RPE, its aligned twin, focal and angular error.

All lengths are pixels of one frame: 320 px wide, pinhole of focal length 160 px (the paper's
protocol), whatever the size of the photograph. A lens is anything with
`unproject(points) -> (rays, valid)` and `project`; `None` stands for "left alone", the photograph
as it came.
"""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from classical.camera import Pinhole

FRAME_WIDTH = 320
"""Width of the frame in which every length is given, in pixels."""

FRAME_FOCAL = 160.0
"""Focal length of the pinhole camera of that frame, in pixels."""

THETA_MAX = np.radians(60.0)
"""True angle up to which pixels are compared: tan θ, and every error with it, explodes beyond."""

THETA_CAP = np.radians(85.0)
"""Largest angle an estimate is charged for; the plane ends at 90°, and one pixel must not rule."""


@runtime_checkable
class Lens(Protocol):
    """What the metrics need of a camera."""

    def unproject(
        self, points: Float[ndarray, "n 2"], /
    ) -> tuple[Float[ndarray, "n 3"], Bool[ndarray, " n"]]:
        """Map pixels to unit rays and tell which of them have one."""
        ...

    def project(
        self, rays: Float[ndarray, "n 3"], /
    ) -> tuple[Float[ndarray, "n 2"], Bool[ndarray, " n"]]:
        """Map rays to pixels and tell which of them have one."""
        ...


def pixel_grid(width: int, height: int, *, spacing: float = 1.0) -> Float[ndarray, "n 2"]:
    """Centres of equal cells that tile a photograph, so that a mean over them is one over its area.

    Args:
        width: Width of the photograph in pixels.
        height: Height of the photograph in pixels.
        spacing: Side of a cell in pixels of the 320 px frame: 1 gives each pixel of a picture
            320 px wide, and as many cells for a larger photograph.

    Returns:
        Pixels (u, v) of the photograph, the top-left pixel's centre being (0, 0).
    """
    columns = max(1, round(FRAME_WIDTH / spacing))
    rows = max(1, round(columns * height / width))
    u = (np.arange(columns) + 0.5) * (width / columns) - 0.5
    v = (np.arange(rows) + 0.5) * (height / rows) - 0.5
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def compared_pixels(
    truth: Lens,
    width: int,
    height: int,
    *,
    theta_max: float = THETA_MAX,
    spacing: float = 1.0,
) -> Float[ndarray, "n 2"]:
    """Pixels on which two lenses are compared: those the true lens sees at θ ≤ `theta_max`."""
    points = pixel_grid(width, height, spacing=spacing)
    chosen = points[within(truth, points, theta_max)]
    if len(chosen) == 0:
        raise ValueError(f"expected pixels within {np.degrees(theta_max):.0f}° of the axis, got 0")
    return chosen


def within(truth: Lens, points: Float[ndarray, "n 2"], theta_max: float) -> Bool[ndarray, " n"]:
    """Which pixels the true lens sees at θ ≤ `theta_max`."""
    rays, valid = truth.unproject(points)
    return valid & (polar_angle(rays) <= theta_max)


def polar_angle(rays: Float[ndarray, "n 3"]) -> Float[ndarray, " n"]:
    """Angle to the optical axis in radians, exact near 0 and past 90°."""
    return np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])


def rectified(
    lens: Lens | None, points: Float[ndarray, "n 2"], width: int, height: int
) -> Float[ndarray, "n 2"]:
    """Where a lens sends the pixels of a photograph in the rectified frame.

    Args:
        lens: Camera of the photograph; `None` leaves the pixels alone, only scaled to the frame.
        points: Pixels of the photograph, shape (n, 2).
        width: Width of the photograph in pixels.
        height: Height of the photograph in pixels.

    Returns:
        Positions relative to the principal point of the frame, in its pixels: 160 tan θ along the
        azimuth. θ is cut at `THETA_CAP`; a pixel without a ray stands at that angle too, in its
        ray's azimuth where it has one and else away from the centre of the photograph.
    """
    outward = points - [(width - 1) / 2, (height - 1) / 2]
    if lens is None:
        return outward * (FRAME_WIDTH / width)
    return _place(*lens.unproject(points), outward)


def _place(rays: ndarray, valid: ndarray, outward: ndarray) -> Float[ndarray, "n 2"]:
    """Intersect rays with the plane of the frame, as `rectified` says."""
    direction = np.where(np.isfinite(rays[:, :2]), rays[:, :2], 0.0)
    known = np.linalg.norm(direction, axis=1, keepdims=True) > 0.0
    direction = np.where(known | valid[:, None], direction, outward)
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    azimuth = direction / np.where(length > 0.0, length, 1.0)
    theta = np.where(valid, polar_angle(np.where(valid[:, None], rays, 0.0)), np.pi)
    return FRAME_FOCAL * np.tan(np.minimum(theta, THETA_CAP))[:, None] * azimuth


def align(
    source: Float[ndarray, "n 2"], target: Float[ndarray, "n 2"]
) -> tuple[float, Float[ndarray, "2 2"], Float[ndarray, " 2"]]:
    """Similarity that brings `source` nearest to `target` in the least-squares sense.

    Umeyama, PAMI 1991, in the plane, where a complex number is a scaled rotation; no reflection.

    Returns:
        scale: Factor of the similarity; 0 where `source` is a single point.
        rotation: Rotation matrix, shape (2, 2).
        shift: Translation: target ≈ scale · source @ rotation.T + shift.
    """
    from_mean, to_mean = source.mean(axis=0), target.mean(axis=0)
    a = (source - from_mean) @ [1.0, 1.0j]
    b = (target - to_mean) @ [1.0, 1.0j]
    spread = np.vdot(a, a).real
    factor = np.vdot(a, b) / spread if spread > 0.0 else 0.0
    scale = float(abs(factor))
    unit = factor / scale if scale > 0.0 else 1.0
    rotation = np.array([[unit.real, -unit.imag], [unit.imag, unit.real]])
    return scale, rotation, to_mean - scale * rotation @ from_mean


def distances(
    place: Float[ndarray, "n 2"], target: Float[ndarray, "n 2"], *, aligned: bool
) -> Float[ndarray, " n"]:
    """Distance between the estimated and the true place of each pixel in the rectified frame.

    Args:
        place: Where the estimate sends the pixels (`rectified`).
        target: Where the truth sends them.
        aligned: Move the estimate by the best similarity (`align`) first.

    Returns:
        Distances in pixels of the 320 px frame, shape (n,).
    """
    if aligned:
        scale, rotation, shift = align(place, target)
        place = scale * place @ rotation.T + shift
    return np.linalg.norm(place - target, axis=1)


def rpe(
    estimate: Lens | None,
    truth: Lens,
    *,
    width: int,
    height: int,
    theta_max: float = THETA_MAX,
    spacing: float = 1.0,
) -> float:
    """Reprojection error of the paper: mean ‖T⁻¹(p; k) − T⁻¹(p; k̂)‖ in the rectified frame.

    The mean runs over all cells of `pixel_grid`, equal in area and on the FISHEYE photograph, that
    the TRUE lens sees at θ ≤ `theta_max`; so the set is the same for every method. It is a mean of
    distances, not of squares, in pixels of a frame 320 px wide with a pinhole of f = 160 px at its
    centre. A failure (`None`) is the photograph left alone: its pixels scaled to 320 px.
    """
    points = compared_pixels(truth, width, height, theta_max=theta_max, spacing=spacing)
    place, target = (rectified(lens, points, width, height) for lens in (estimate, truth))
    return float(distances(place, target, aligned=False).mean())


def aligned_error(
    estimate: Lens | None,
    truth: Lens,
    *,
    width: int,
    height: int,
    theta_max: float = THETA_MAX,
    spacing: float = 1.0,
) -> float:
    """`rpe` after the best similarity: what is left when scale, turn and shift are forgiven.

    The same mean of distances over the same pixels as `rpe`; the similarity of `align` (rotation,
    one scale, translation; no reflection) moves the estimate, so the unit stays the truth's pixel.
    A division model without focal length is judged by this and not by `rpe`.
    """
    points = compared_pixels(truth, width, height, theta_max=theta_max, spacing=spacing)
    place, target = (rectified(lens, points, width, height) for lens in (estimate, truth))
    return float(distances(place, target, aligned=True).mean())


def angular_error(
    estimate: Lens | None,
    truth: Lens,
    *,
    width: int,
    height: int,
    theta_max: float = THETA_MAX,
    spacing: float = 1.0,
) -> float:
    """Mean angle in degrees between the estimated and the true ray, over the pixels of `rpe`.

    A failure is the photograph taken for a pinhole picture of f = 160 px in a 320 px frame; a pixel
    without a ray counts like one at `THETA_CAP` (see `rectified`).
    """
    points = compared_pixels(truth, width, height, theta_max=theta_max, spacing=spacing)
    return float(np.degrees(angles(estimate, truth, points, width, height)).mean())


def angles(
    estimate: Lens | None,
    truth: Lens,
    points: Float[ndarray, "n 2"],
    width: int,
    height: int,
) -> Float[ndarray, " n"]:
    """Angle between the estimated and the true ray of each pixel, radians; see `angular_error`."""
    chord = np.linalg.norm(
        _rays(estimate, points, width, height) - _rays(truth, points, width, height), axis=1
    )
    return 2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0))  # exact where the arccosine is not


def _rays(lens: Lens | None, points: ndarray, width: int, height: int) -> Float[ndarray, "n 3"]:
    """Unit rays of pixels; where the lens has none, that of the place it is charged for."""
    if lens is None:
        lens = Pinhole.centred(width / 2, width, height)
    rays, valid = lens.unproject(points)
    if valid.all():
        return rays
    place = _place(rays, valid, points - [(width - 1) / 2, (height - 1) / 2])
    charged = np.column_stack([place, np.full(len(place), FRAME_FOCAL)])
    charged /= np.linalg.norm(charged, axis=1, keepdims=True)
    return np.where(valid[:, None], rays, charged)


def central_focal(lens: Lens) -> float:
    """Focal length on the optical axis in pixels of the photograph, along u: dr/dθ at θ = 0.

    Read off `project`, so it means the same for every model: k1 m_u for Kannala–Brandt, the stated
    convention for a division model, which knows no focal length of its own.
    """
    step = 1e-4
    points, _ = lens.project(np.array([[-step, 0.0, 1.0], [step, 0.0, 1.0]]))
    return float(np.linalg.norm(points[1] - points[0]) / (2.0 * np.arctan(step)))


def focal_error(estimate: Lens, truth: Lens) -> float:
    """Signed error of the central focal length in per cent of the true one."""
    return 100.0 * (central_focal(estimate) / central_focal(truth) - 1.0)

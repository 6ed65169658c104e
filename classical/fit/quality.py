"""How wrong a fitted lens may be, in pixels of the rectified picture, and in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from classical.camera import KannalaBrandt
from classical.fit.result import FittedCurve, Status
from classical.lines.pieces import arc_length

LARGEST_ERROR = 3.0
"""Error under which answers that are ok should be, pixels of a 320 frame, f = 160 px."""

TAIL = 3.0
"""Times the predicted error that a true one may well be; few are more."""

_FRAME_FOCAL = 160.0  # px: a frame 320 wide, 90° across
_WIDEST = np.radians(60.0)
_WIDEST_COMPARED = np.radians(80.0)  # of another lens, where positions run away
_GRID = 24  # points a side at which the error is predicted


def predicted_error(camera: KannalaBrandt, covariance: Float[np.ndarray, "9 9"]) -> float:
    """Expected distance of rectified positions from the truth after the best similarity.

    The covariance is carried through ∂(rectified position)/∂camera; what a similarity of the
    rectified plane can undo (scale, rotation, shift) is projected out.

    Args:
        camera: The estimate.
        covariance: Of its vector, shape (9, 9).

    Returns:
        Root mean square over the picture's pixels up to 60°, pixels of a 320 frame, f = 160 px.
    """
    positions, by_camera = rectified_grid(camera)
    if len(positions) < 4:
        return float("nan")
    flat = by_camera.reshape(-1, 9)  # (n * 2, 9), u and v of each point in turn
    basis, _ = np.linalg.qr(_similarities(positions))
    flat = flat - basis @ (basis.T @ flat)
    return float(np.sqrt(max(np.sum((flat @ covariance) * flat), 0.0) / len(positions)))


def disagreement(camera: KannalaBrandt, other: KannalaBrandt) -> float:
    """Distance of the rectified positions of two lenses after the best similarity.

    Args:
        camera: A lens; pixels that it sees up to 60° count.
        other: Another lens of the same picture.

    Returns:
        Root mean square, pixels of a 320 frame, f = 160 px.
    """
    positions, _ = rectified_grid(camera)
    points = _grid(camera)
    rays, valid = camera.unproject(points)
    seen = valid & (rays[:, 2] >= np.cos(_WIDEST))
    there, valid = other.unproject(points[seen])
    kept = valid & (there[:, 2] >= np.cos(_WIDEST_COMPARED))
    if kept.sum() < 4:
        return float("nan")
    moved = _FRAME_FOCAL * there[kept, :2] / there[kept, 2:]
    off = (moved - positions[kept]).ravel()
    basis, _ = np.linalg.qr(_similarities(moved))
    off = off - basis @ (basis.T @ off)
    return float(np.sqrt(off @ off / kept.sum()))


def _grid(camera: KannalaBrandt) -> np.ndarray:
    u = np.linspace(0, camera.width - 1, _GRID)
    v = np.linspace(0, camera.height - 1, _GRID)
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def rectified_grid(camera: KannalaBrandt) -> tuple[np.ndarray, np.ndarray]:
    """Rectified positions of a grid of pixels up to 60°, and ∂positions/∂camera.

    Args:
        camera: A lens.

    Returns:
        Positions (n, 2) from the principal point, pixels of a 320 frame with f = 160 px, and their
        derivatives by the camera's vector (n, 2, 9).
    """
    points = _grid(camera)
    jacobian = camera.unproject_jacobian(points)
    seen = jacobian.valid & (jacobian.rays[:, 2] >= np.cos(_WIDEST))
    rays, by_camera = jacobian.rays[seen], jacobian.by_parameters[seen]
    depth = rays[:, 2:]
    positions = _FRAME_FOCAL * rays[:, :2] / depth
    derivatives = (
        _FRAME_FOCAL * by_camera[:, :2] - positions[:, :, None] * by_camera[:, 2:]
    ) / depth[:, :, None]
    return positions, derivatives


def _similarities(positions: np.ndarray) -> np.ndarray:
    """Directions of scale, rotation and shift, shape (n * 2, 4)."""
    x, y = positions.T
    one, zero = np.ones_like(x), np.zeros_like(x)
    columns = [(x, y), (-y, x), (one, zero), (zero, one)]
    return np.stack([np.stack(pair, axis=1).ravel() for pair in columns], axis=1)


_FEWEST_CURVES = 4
_LEAST_LENGTH = 1.0  # total length of straight curves, picture widths
_LEAST_SHARE = 0.35  # of the curves' length
_HOPELESS_ERROR = 20.0


def judge(
    curves: Sequence[Sequence[FittedCurve]], camera: KannalaBrandt, error: float
) -> tuple[Status, str]:
    """Say in words how far a fit can be trusted.

    Args:
        curves: Fitted curves of each picture.
        camera: The estimate.
        error: `predicted_error` of it by its `calibrated` covariance.
    """
    most = TAIL * error
    inliers = [curve for picture in curves for curve in picture if curve.inlier]
    straight, total = _lengths(curves)
    length, share = straight / camera.width, straight / max(total, 1e-9)
    if len(inliers) < _FEWEST_CURVES:
        return "failed", f"only {len(inliers)} curves can be made straight, {_FEWEST_CURVES} needed"
    if not most < _HOPELESS_ERROR:
        return "failed", f"the curves leave the lens open: the error may be {most:.1f} px"
    if length < _LEAST_LENGTH:
        return "degraded", f"few straight lines: {length:.1f} picture widths in all"
    if share < _LEAST_SHARE:
        return "degraded", f"only {share:.0%} of the curves' length could be made straight"
    if most > LARGEST_ERROR:
        return "degraded", f"the lines tell little: the error may be {most:.1f} px"
    return "ok", f"{len(inliers)} straight lines agree"


def straight_share(curves: Sequence[Sequence[FittedCurve]]) -> float:
    """Share of the curves' length that the lens made straight; 0 without curves."""
    straight, total = _lengths(curves)
    return straight / max(total, 1e-9)


def _lengths(curves: Sequence[Sequence[FittedCurve]]) -> tuple[float, float]:
    """Length of the straight curves and of all, pixels."""
    every = [curve for picture in curves for curve in picture]
    if not every:
        return 0.0, 0.0
    offsets = np.cumsum([0, *(len(curve.points) for curve in every)])
    lengths = arc_length(np.concatenate([curve.points for curve in every]), offsets)[1]
    straight = lengths[[curve.inlier for curve in every]]
    return float(straight.sum()), float(lengths.sum())

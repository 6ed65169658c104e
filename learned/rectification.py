"""The rectification layer: the fisheye projection T, its inverse, and the differentiable warp.

Points are centred on the frame and measured in half image widths, so a full frame is
[−1, 1] x [−H/W, H/W]: exactly the coordinates of `grid_sample(align_corners=False)` but for the
factor W/H of the second one. A lens is the vector k = (k1..k5, m_u, m_v, u0, v0) in the same unit;
the target pinhole has its principal point at the centre and focal length `focal`, which is 1 in
the paper's protocol (f = W/2).
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from learned.polynomial import monotone_limit, radius, theta_from_radius

_SMALLEST_RADIUS = 1e-12
THETA_LIMIT = math.radians(80.0)


def pixel_grid(
    height: int, width: int, *, stride: int = 1, device: torch.device | str = "cpu"
) -> Float[Tensor, "n 2"]:
    """Centres of every `stride`-th pixel, centred, in half widths, row by row."""
    offset = (stride - 1) / 2
    v = torch.arange(height // stride, device=device) * stride + offset
    u = torch.arange(width // stride, device=device) * stride + offset
    y, x = torch.meshgrid(v - (height - 1) / 2, u - (width - 1) / 2, indexing="ij")
    return torch.stack([x, y], -1).reshape(-1, 2) / (width / 2)


def distort(
    points: Float[Tensor, "b n 2"], k: Float[Tensor, "b 9"], *, focal: float = 1.0
) -> tuple[Float[Tensor, "b n 2"], Bool[Tensor, "b n"]]:
    """T of Eq. rectify: rectified points to fisheye points; the inverse of `undistort`.

    θ = atan(|p_r| / focal), p_f = r(θ) p_r / |p_r| scaled by (m_u, m_v) plus (u0, v0), with r of
    Eq. generic-camera-model.

    Args:
        points: Rectified points, centred, in half widths.
        k: Lens per batch row.
        focal: Focal length of the pinhole, in half widths.

    Returns:
        points: Fisheye points, centred, in half widths.
        valid: True where r rises up to the point's angle.
    """
    length = points.square().sum(-1).clamp_min(_SMALLEST_RADIUS).sqrt()
    theta = torch.atan2(length, torch.full_like(length, focal))
    scale = radius(theta, k[:, :5]) / length
    valid = theta <= monotone_limit(k[:, :5])[:, None]
    return points * scale[..., None] * k[:, None, 5:7] + k[:, None, 7:9], valid


def undistort(
    points: Float[Tensor, "b n 2"],
    k: Float[Tensor, "b 9"],
    *,
    focal: float = 1.0,
    theta_limit: float = THETA_LIMIT,
) -> tuple[Float[Tensor, "b n 2"], Float[Tensor, "b n"]]:
    """T⁻¹: fisheye points to rectified points; the inverse of `distort`.

    The tangent grows without bound towards 90°, so angles are held at `theta_limit` (our
    addition). Gradients with respect to k are those of the implicit function r(θ; k) = r.

    Args:
        points: Fisheye points, centred, in half widths.
        k: Lens per batch row.
        focal: Focal length of the pinhole, in half widths.
        theta_limit: Largest angle of a rectified point, in radians.

    Returns:
        points: Rectified points, centred, in half widths.
        theta: Incident angles before the limit, in radians.
    """
    plane, length = _plane(points, k)
    theta, _ = theta_from_radius(length, k[:, :5], monotone_limit(k[:, :5]))
    scale = focal * torch.tan(theta.clamp(max=theta_limit)) / length
    return plane * scale[..., None], theta


def reprojected(
    points: Float[Tensor, "b n 2"],
    theta: Float[Tensor, "b n"],
    k: Float[Tensor, "b 9"],
    other: Float[Tensor, "b 9"],
) -> Float[Tensor, "b n 2"]:
    """Where another lens images the rays that a lens has at pixels; past 90°, too.

    Args:
        points: Fisheye points, centred, in half widths.
        theta: Their incident angles under `k`, from `undistort`.
        k: The lens of the points.
        other: The other lens, to which the result has gradients.

    Returns:
        Fisheye points, centred, in half widths.
    """
    plane, length = _plane(points, k)
    scale = radius(theta, other[:, :5]) / length
    return plane * scale[..., None] * other[:, None, 5:7] + other[:, None, 7:9]


def _plane(points: Tensor, k: Tensor) -> tuple[Tensor, Tensor]:
    """Fisheye points in units of r(θ), around the principal point, and their distances from it."""
    plane = (points - k[:, None, 7:9]) / k[:, None, 5:7]
    return plane, plane.square().sum(-1).clamp_min(_SMALLEST_RADIUS).sqrt()


def rectify_images(
    images: Float[Tensor, "b c h w"],
    k: Float[Tensor, "b 9"],
    *,
    size: tuple[int, int] | None = None,
    focal: float = 1.0,
) -> Float[Tensor, "b c hr wr"]:
    """The rectification layer: warp fisheye pictures by Eq. rectify, bilinearly.

    Differentiable in the pictures and in k. Black where the picture has nothing and beyond the
    angle at which r(θ) stops to rise.

    Args:
        images: Fisheye pictures.
        k: Lens per picture, in half widths of these pictures.
        size: Height and width of the result; its frame spans the same angle at any size.
        focal: Focal length of the result in half widths of the result.

    Returns:
        Rectified pictures.
    """
    height, width = images.shape[-2:]
    rows, columns = size or (height, width)
    target = pixel_grid(rows, columns, device=images.device).to(k.dtype)
    points, valid = distort(target.expand(len(images), -1, -1), k, focal=focal)
    grid = torch.stack([points[..., 0], points[..., 1] * (width / height)], -1)
    grid = torch.where(valid[..., None], grid, torch.full_like(grid, 4.0))
    # far outside, float32 loses the position and the backward pass its meaning
    grid = grid.clamp(-4.0, 4.0).reshape(-1, rows, columns, 2)
    return functional.grid_sample(images, grid.to(images.dtype), align_corners=False)

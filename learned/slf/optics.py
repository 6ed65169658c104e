"""Rays of pixels and pixels of rays for a batch of lenses, fast enough for training on the fly."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from torch import Tensor

from learned.polynomial import radius, theta_from_radius
from learned.slf.lenses import LensBatch

_TABLE_NODES = 1024
_BEYOND = 0.02
_LEAST_COSINE = 1e-3
SIDEWAYS = 1e3
"""Place on the plane z = 1 of rays that do not meet it."""


@dataclass(frozen=True)
class Optics:
    """Lenses in front of frames of `size` x `size` pixels, on a device.

    Attributes:
        vector: Camera vectors in half widths, as in `SlfBatch.k`.
        theta_max: Largest incident angle in radians.
        circle: Radius of the image circle, infinite where there is none.
        half_height: Half height of the visible rectangle, in half widths.
        size: Width and height of the frame in pixels.
    """

    vector: Float[Tensor, "b 9"]
    theta_max: Float[Tensor, " b"]
    circle: Float[Tensor, " b"]
    half_height: Float[Tensor, " b"]
    size: int

    def __len__(self) -> int:
        """Number of lenses."""
        return self.vector.shape[0]

    def __getitem__(self, rows: Tensor) -> "Optics":
        """Some of the lenses."""
        return Optics(
            vector=self.vector[rows],
            theta_max=self.theta_max[rows],
            circle=self.circle[rows],
            half_height=self.half_height[rows],
            size=self.size,
        )


def optics(lenses: LensBatch, *, size: int, device: torch.device | str = "cpu") -> Optics:
    """Move lenses to a device and give them a frame."""

    def moved(value: ndarray) -> Tensor:
        return torch.from_numpy(value).to(device, torch.float32)

    return Optics(
        vector=moved(lenses.vector),
        theta_max=moved(lenses.theta_max),
        circle=moved(lenses.circle),
        half_height=moved(lenses.half_height),
        size=size,
    )


@dataclass(frozen=True)
class RayTables:
    """The inverse of r(θ), exact at equally spaced radii; made for many lenses at once.

    Attributes:
        top: Largest radius, at a corner of the frame, shape (b,).
        sine: sin θ / r from r = 0 to `top`, shape (b, nodes).
        cosine: cos θ, likewise.
    """

    top: Float[Tensor, " b"]
    sine: Float[Tensor, "b nodes"]
    cosine: Float[Tensor, "b nodes"]

    def __getitem__(self, rows: Tensor) -> "RayTables":
        """Those of some of the lenses."""
        return RayTables(self.top[rows], self.sine[rows], self.cosine[rows])


def ray_tables(lens: Optics, *, oversampling: int = 1) -> RayTables:
    """Tables for `pixel_rays` and `plane_points` with the same oversampling."""
    coordinate = _frame_coordinate(lens.size, oversampling, lens.vector)[[0, -1]]
    x, y = _on_plane(lens, coordinate)
    top = torch.sqrt(x * x + y * y).amax(dim=(1, 2))
    share = torch.linspace(0.0, 1.0, _TABLE_NODES, dtype=top.dtype, device=top.device)
    r = top[:, None] * share
    theta, _ = theta_from_radius(r, lens.vector[:, :5], lens.theta_max)
    sine = torch.sin(theta) / r.clamp_min(1e-9)
    sine[:, 0] = 1.0 / lens.vector[:, 0]
    return RayTables(top, sine, torch.cos(theta))


def pixel_rays(
    lens: Optics, *, oversampling: int = 1, tables: RayTables | None = None
) -> tuple[Float[Tensor, "b 3 h w"], Bool[Tensor, "b h w"]]:
    """Unit viewing directions of all pixels.

    The inverse of r(θ) is solved exactly on a table of radii and read linearly in between, which is
    good to 1e−6 rad and many times faster than a root per pixel.

    Args:
        lens: Lenses and frame size.
        oversampling: Rays per pixel and axis.
        tables: `ray_tables` of the lenses, where they are at hand.

    Returns:
        rays: Unit directions (x right, y down, z forward), (b, 3, h, w) with h = w = oversampling
            times the frame's size.
        valid: True where the lens images something inside the visible rectangle.
    """
    tables = tables or ray_tables(lens, oversampling=oversampling)
    coordinate = _frame_coordinate(lens.size, oversampling, lens.vector)
    x, y = _on_plane(lens, coordinate)
    r = torch.sqrt(x * x + y * y)
    valid = _is_imaged(lens, r, coordinate)
    at, share = _cells(r, tables.top)
    rays = torch.empty((len(lens), 3, *r.shape[1:]), dtype=r.dtype, device=r.device)
    scale = _lerp(tables.sine, at, share)
    torch.mul(x, scale, out=rays[:, 0])
    torch.mul(y, scale, out=rays[:, 1])
    rays[:, 2] = _lerp(tables.cosine, at, share)
    return rays, valid


def plane_points(
    lens: Optics, *, oversampling: int = 1, tables: RayTables | None = None
) -> Float[Tensor, "b 2 h w"]:
    """Where the rays of all pixels meet the plane z = 1.

    Args:
        lens: Lenses and frame size.
        oversampling: Rays per pixel and axis.
        tables: `ray_tables` of the lenses, where they are at hand.

    Returns:
        x and y, (b, 2, h, w); far outside (`SIDEWAYS`) where the lens images nothing or the ray
        does not meet the plane.
    """
    tables = tables or ray_tables(lens, oversampling=oversampling)
    coordinate = _frame_coordinate(lens.size, oversampling, lens.vector)
    # a centred lens sees four times the same quarter
    centred = len(coordinate) % 2 == 0 and not lens.vector[:, 7:9].any()
    part = coordinate[len(coordinate) // 2 :] if centred else coordinate
    x, y = _on_plane(lens, part)
    r = torch.sqrt(x * x + y * y)
    outside = ~_is_imaged(lens, r, part)
    ahead = tables.cosine > _LEAST_COSINE
    tangent = torch.where(
        ahead,
        tables.sine / tables.cosine.clamp_min(_LEAST_COSINE),
        SIDEWAYS / tables.top[:, None],
    )
    scale = _lerp(tangent, *_cells(r, tables.top))
    points = torch.stack([x * scale, y * scale], dim=1).masked_fill_(outside[:, None], SIDEWAYS)
    return _unfolded(points) if centred else points


def _on_plane(lens: Optics, coordinate: Tensor) -> tuple[Tensor, Tensor]:
    """Columns x (b, 1, n) and rows y (b, n, 1) in the isotropic plane of r(θ)."""
    x = (coordinate - lens.vector[:, 7, None]) / lens.vector[:, 5, None]
    y = (coordinate - lens.vector[:, 8, None]) / lens.vector[:, 6, None]
    return x[:, None, :], y[:, :, None]


def _is_imaged(lens: Optics, r: Tensor, row: Tensor) -> Tensor:
    """Whether pixels lie in the image circle and the visible rectangle."""
    edge = radius(lens.theta_max[:, None], lens.vector[:, :5])[:, 0]
    inside = r <= torch.minimum(edge, lens.circle)[:, None, None]
    return inside.logical_and_((row.abs() <= lens.half_height[:, None])[:, :, None])


def _cells(r: Tensor, top: Tensor) -> tuple[Tensor, Tensor]:
    """Cell of a table for every radius, and its place in the cell; `r` is used up."""
    position = r.mul_(((_TABLE_NODES - 1) / top)[:, None, None])
    cell = position.floor().clamp_(0, _TABLE_NODES - 2)
    return cell.long().flatten(1), position.sub_(cell)


def _unfolded(quarter: Float[Tensor, "b 2 h w"]) -> Float[Tensor, "b 2 h2 w2"]:
    """The whole plane from its quarter of positive coordinates."""
    sign = quarter.new_tensor([[-1.0, 1.0], [1.0, -1.0]]).view(2, 2, 1, 1)
    lower = torch.cat([quarter.flip(3) * sign[0], quarter], dim=3)
    return torch.cat([lower.flip(2) * sign[1], lower], dim=2)


def project(
    lens: Optics, points: Float[Tensor, "n 3"], row: Int[Tensor, " n"]
) -> tuple[Float[Tensor, "n 2"], Bool[Tensor, " n"]]:
    """Image points in front of or beside the lenses.

    Args:
        lens: Lenses and frame size.
        points: Points in camera coordinates, any length but zero.
        row: Lens of each point.

    Returns:
        pixels: (u, v) per point.
        valid: True where the point is seen: inside frame, visible rectangle and image circle.
    """
    x, y, z = points.T.contiguous()
    table = torch.cat(
        [lens.vector, lens.theta_max[:, None], lens.circle[:, None], lens.half_height[:, None]], 1
    )
    k1, k2, k3, k4, k5, m_u, m_v, u0, v0, theta_max, circle, half_height = (
        table.T.contiguous().index_select(1, row)
    )
    across = torch.sqrt(x * x + y * y)
    theta = torch.atan2(across, z)
    # beyond the lens the polynomial may run anywhere, so it is held just outside
    held = torch.minimum(theta, theta_max + _BEYOND)
    t = held * held
    r = ((((k5 * t + k4) * t + k3) * t + k2) * t + k1) * held
    # on the axis the direction is undefined and the radius is zero
    scale = r / across.clamp_min(1e-12)
    u, v = scale * x * m_u + u0, scale * y * m_v + v0
    valid = (theta <= theta_max) & (r <= circle) & (u.abs() <= 1.0) & (v.abs() <= half_height)
    pixels = torch.stack([u, v], 1) * (lens.size / 2) + (lens.size - 1) / 2
    return pixels, valid


def unproject(
    lens: Optics, pixels: Float[Tensor, "n 2"], row: Int[Tensor, " n"]
) -> tuple[Float[Tensor, "n 3"], Bool[Tensor, " n"]]:
    """Unit rays of single pixels; the inverse of `project`.

    Args:
        lens: Lenses and frame size.
        pixels: Points (u, v).
        row: Lens of each point.

    Returns:
        rays: Unit directions in camera coordinates.
        valid: True inside the image circle.
    """
    vector = lens.vector[row]
    plane = (pixels - (lens.size - 1) / 2) / (lens.size / 2)
    plane = (plane - vector[:, 7:9]) / vector[:, 5:7]
    r = torch.linalg.vector_norm(plane, dim=1)
    theta, valid = theta_from_radius(r[:, None], vector[:, :5], lens.theta_max[row])
    sine = torch.sin(theta) / r.clamp_min(1e-9)[:, None]
    return torch.cat([plane * sine, torch.cos(theta)], dim=1), valid[:, 0]


def _frame_coordinate(size: int, oversampling: int, like: Tensor) -> Tensor:
    """Coordinates of ray columns in half widths from the middle of the frame."""
    count = size * oversampling
    index = torch.arange(count, dtype=like.dtype, device=like.device)
    return (index - (count - 1) / 2) / (count / 2)


def _lerp(table: Tensor, at: Tensor, share: Tensor) -> Tensor:
    low = table.gather(1, at).view_as(share)
    return torch.lerp(low, table.gather(1, at + 1).view_as(share), share)

"""Pieces of one line joined under a camera: curves that lie on one great circle.

With n the normal of the circle and r the ray of a pixel, e = (n·r) / |∂(n·r)/∂pixel| is the
distance of the pixel from the line's image to first order (Sampson), in pixels of the photograph.
For fixed weights the sum of its squares is nᵀ A n with A = Σ r rᵀ / |∂(n·r)/∂pixel|², and the A of
two curves add up: a pair is tried by the smallest eigenvector of a 3x3 matrix. Polarity plays no
part, so the edges of a chessboard, which flip at every corner, are joined to whole lines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from classical.camera import Division, KannalaBrandt, Pinhole
from classical.camera.ray_field import ray_field
from classical.lines.curve import Curve, thinned_curves

_SPACING = 4.0  # pixels between the points that are used to compare curves
_STEP = 0.5  # pixels, for derivatives of rays
_REWEIGHTINGS = 2
_BOUND_SLACK = 1.01  # for rounding


@dataclass(frozen=True)
class JoinConfig:
    """When curves are taken for pieces of one line.

    Attributes:
        max_rms: Largest root mean square distance of either piece from the common circle, pixels …
        noise_factor: … or so many times that from its own circle, which grows with the camera's
            error; the larger counts.
        max_gap_share: Widest gap as a share of the longer piece …
        max_gap_share_short: … and of the shorter piece.
        max_gap: Gaps up to this are always let pass, pixels.
        max_overlap: Largest part of the shorter piece that may lie beside the longer one.
        rounds: Of pairwise joining.
    """

    max_rms: float = 0.5
    noise_factor: float = 2.0
    max_gap_share: float = 1.0
    max_gap_share_short: float = 2.0
    max_gap: float = 12.0
    max_overlap: float = 0.15
    rounds: int = 8


@dataclass(frozen=True)
class _Pieces:
    """Curves as statistics of their rays; arrays have one row a piece."""

    scatter: np.ndarray  # (p, 3, 3), A of the module's docstring
    count: np.ndarray  # (p,) points behind it
    rms: np.ndarray  # (p,) distance from the piece's own circle, pixels
    length: np.ndarray  # (p,) pixels
    ends: np.ndarray  # (p, 2, 2) pixels
    end_rays: np.ndarray  # (p, 2, 3)
    middle: np.ndarray  # (p, 3) mean ray
    members: list[list[int]]  # indices of curves


def join_curves(
    curves: list[Curve],
    camera: KannalaBrandt | Division | Pinhole,
    *,
    config: JoinConfig = JoinConfig(),
) -> list[Curve]:
    """Join curves that lie on one great circle, close to each other along it.

    Args:
        curves: Curves of one picture.
        camera: The camera of the picture as far as it is known.
        config: When curves are taken for one.

    Returns:
        Curves, of which joined ones hold the points of all their pieces in order along the circle;
        the longest first. Curves that the camera does not see are returned as they are.
    """
    pieces, unseen = _describe(curves, camera)
    for _ in range(config.rounds):
        pairs = _best_pairs(pieces, config)
        if not len(pairs):
            break
        pieces = _merge(pieces, pairs)
    alone = [curves[group[0]] for group in pieces.members if len(group) == 1]
    joined = _joined([[curves[k] for k in g] for g in pieces.members if len(g) > 1], camera)
    return sorted(alone + joined + [curves[k] for k in unseen], key=lambda curve: -curve.length)


def sampson_rays(
    points: Float[np.ndarray, "n 2"], camera: KannalaBrandt | Division | Pinhole
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 2"]]:
    """Rays of pixels and their derivatives, by central differences where need be; NaN if unseen."""
    if isinstance(camera, KannalaBrandt):
        field, valid = ray_field(camera, points[:, 0], points[:, 1])
        return np.where(valid[:, None], field.rays(), np.nan), field.jacobian()
    rays, valid = camera.unproject(points)
    derivative = np.empty((len(points), 3, 2))
    for axis in (0, 1):
        step = np.zeros(2)
        step[axis] = _STEP
        ahead, valid_ahead = camera.unproject(points + step)
        behind, valid_behind = camera.unproject(points - step)
        derivative[:, :, axis] = (ahead - behind) / (2 * _STEP)
        valid = valid & valid_ahead & valid_behind
    return np.where(valid[:, None], rays, np.nan), derivative


def _describe(
    curves: list[Curve], camera: KannalaBrandt | Division | Pinhole
) -> tuple[_Pieces, list[int]]:
    """Statistics of the curves that the camera sees, and the indices of the others."""
    if not curves:
        none = np.empty((0, 3))
        return _Pieces(
            np.empty((0, 3, 3)), none[:, 0], none[:, 0], none[:, 0], np.empty((0, 2, 2)),
            np.empty((0, 2, 3)), none, [],
        ), []  # fmt: skip
    coarse, count = thinned_curves(curves, [_SPACING] * len(curves))
    rays, derivative = sampson_rays(coarse, camera)
    finite = np.isfinite(rays[:, 0])
    visible = np.logical_and.reduceat(finite, np.cumsum(count) - count)
    seen, unseen = np.flatnonzero(visible).tolist(), np.flatnonzero(~visible).tolist()
    inside = np.repeat(visible, count)
    rays, derivative, count = rays[inside], derivative[inside], count[visible]
    last = np.cumsum(count) - 1
    starts = last + 1 - count
    scatter = _scatter(rays, derivative, starts, count)
    return _Pieces(
        scatter,
        count.astype(np.float64),
        _own_rms(scatter, count),
        np.array([curves[k].length for k in seen]),
        np.array([(curves[k].points[0], curves[k].points[-1]) for k in seen]).reshape(-1, 2, 2),
        np.stack([rays[starts], rays[last]], axis=1),
        np.add.reduceat(rays, starts) / count[:, None] if seen else np.empty((0, 3)),
        [[k] for k in seen],
    ), unseen


def _scatter(
    rays: np.ndarray, derivative: np.ndarray, starts: np.ndarray, count: np.ndarray
) -> np.ndarray:
    """A of each curve, weighted for its own circle, shape (C, 3, 3)."""
    if not len(starts):
        return np.empty((0, 3, 3))
    outer = rays[:, :, None] * rays[:, None, :]
    scatter = np.add.reduceat(outer, starts)
    for _ in range(_REWEIGHTINGS):
        normal = np.repeat(np.linalg.eigh(scatter)[1][:, :, 0], count, axis=0)
        slope = np.matmul(normal[:, None], derivative)[:, 0]
        weight = 1 / np.maximum((slope**2).sum(axis=1), 1e-20)
        scatter = np.add.reduceat(outer * weight[:, None, None], starts)
    return scatter


def _own_rms(scatter: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Root mean square distance of each piece from its own circle, pixels."""
    return np.sqrt(np.maximum(np.linalg.eigvalsh(scatter)[:, 0], 0) / np.maximum(count - 2, 1))


def _best_pairs(pieces: _Pieces, config: JoinConfig) -> list[tuple[int, int]]:
    """Disjoint pairs of pieces of one line, the surest first."""
    if len(pieces.members) < 2:
        return []
    i, j, gap = _near_pairs(pieces, config)
    limit = np.maximum(config.max_rms, config.noise_factor * pieces.rms)
    # a circle through both must pass near each: a bound that most pairs break
    most = pieces.count * limit * limit
    common = pieces.scatter[i] + pieces.scatter[j]
    possible = ~_exceeds(common, _BOUND_SLACK * (most[i] + most[j]))
    i, j, gap = i[possible], j[possible], gap[possible]
    normal = np.linalg.eigh(common[possible])[1][:, :, 0]
    misfit = np.zeros(len(i))
    for side in (i, j):
        squared = np.einsum("ki,kij,kj->k", normal, pieces.scatter[side], normal)
        rms = np.sqrt(np.maximum(squared, 0) / pieces.count[side])
        misfit = np.maximum(misfit, rms / limit[side])
    fits = misfit <= 1
    fits[fits] = _overlap(pieces, i[fits], j[fits], normal[fits]) <= config.max_overlap
    cost = misfit + gap / np.maximum(pieces.length[i], pieces.length[j])
    pairs, taken = [], set()
    for k in np.flatnonzero(fits)[np.argsort(cost[fits], kind="stable")].tolist():
        a, b = int(i[k]), int(j[k])
        if a not in taken and b not in taken:
            pairs.append((a, b))
            taken |= {a, b}
    return pairs


def _near_pairs(pieces: _Pieces, config: JoinConfig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of pieces with a gap that their lengths allow, and the gap."""
    squared = np.full((len(pieces.members), len(pieces.members)), np.inf)
    ends = np.ascontiguousarray(pieces.ends.transpose(1, 2, 0))  # (2, 2, p)
    for one in ends:
        for other in ends:
            du, dv = one[:, :, None] - other[:, None, :]
            du *= du
            dv *= dv
            du += dv
            np.minimum(squared, du, out=squared)
    gap = np.sqrt(squared)
    longer = np.maximum.outer(pieces.length, pieces.length)
    shorter = np.minimum.outer(pieces.length, pieces.length)
    room = np.minimum(config.max_gap_share * longer, config.max_gap_share_short * shorter)
    i, j = np.nonzero(np.triu(gap <= np.maximum(room, config.max_gap), 1))
    return i, j, gap[i, j]


def _exceeds(matrices: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """True where all eigenvalues of symmetric 3x3 matrices exceed a bound, by leading minors."""
    xx, yy, zz = (matrices[:, k, k] - bound for k in range(3))
    xy, xz, yz = matrices[:, 0, 1], matrices[:, 0, 2], matrices[:, 1, 2]
    minor = xx * yy - xy * xy
    determinant = zz * minor - xx * yz * yz - yy * xz * xz + 2 * xy * xz * yz
    return (xx > 0) & (minor > 0) & (determinant > 0)


def _overlap(pieces: _Pieces, i: np.ndarray, j: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Part of the shorter piece that lies beside the longer one, by angle along the circle."""
    axis = pieces.middle[i] + pieces.middle[j]
    axis -= (axis * normal).sum(axis=1, keepdims=True) * normal
    other = np.cross(normal, axis)
    low, high = [], []
    for side in (i, j):
        rays = pieces.end_rays[side]
        angle = np.arctan2(
            np.einsum("kei,ki->ke", rays, other), np.einsum("kei,ki->ke", rays, axis)
        )
        low.append(angle.min(axis=1))
        high.append(angle.max(axis=1))
    shared = np.minimum(high[0], high[1]) - np.maximum(low[0], low[1])
    shorter = np.minimum(high[0] - low[0], high[1] - low[1])
    return np.maximum(shared, 0) / np.maximum(shorter, 1e-9)


def _merge(pieces: _Pieces, pairs: list[tuple[int, int]]) -> _Pieces:
    """Pieces with each pair replaced by its sum."""
    first, second = np.array(pairs).T
    scatter, count = pieces.scatter.copy(), pieces.count.copy()
    scatter[first] += scatter[second]
    count[first] += count[second]
    middle = pieces.middle.copy()
    middle[first] += middle[second]
    ends, end_rays, length = pieces.ends.copy(), pieces.end_rays.copy(), pieces.length.copy()
    members = [list(group) for group in pieces.members]
    for a, b in pairs:
        places = np.concatenate([pieces.ends[a], pieces.ends[b]])
        rays = np.concatenate([pieces.end_rays[a], pieces.end_rays[b]])
        apart = ((places[:, None] - places[None]) ** 2).sum(axis=-1)
        far = list(np.unravel_index(int(apart.argmax()), apart.shape))
        ends[a], end_rays[a] = places[far], rays[far]
        length[a] = max(float(np.sqrt(apart.max())), length[a] + length[b])
        members[a] = members[a] + members[b]
    keep = np.setdiff1d(np.arange(len(members)), second)
    return _Pieces(
        scatter[keep],
        count[keep],
        _own_rms(scatter[keep], count[keep]),
        length[keep],
        ends[keep],
        end_rays[keep],
        middle[keep],
        [members[k] for k in keep],
    )


def _joined(groups: list[list[Curve]], camera: KannalaBrandt | Division | Pinhole) -> list[Curve]:
    """One curve of all points of each group, in order along their circle."""
    if not groups:
        return []
    points = [np.concatenate([curve.points for curve in group]) for group in groups]
    rays = np.split(
        camera.unproject(np.concatenate(points))[0], np.cumsum([len(each) for each in points])[:-1]
    )
    joined = []
    for group, places, directions in zip(groups, points, rays, strict=True):
        normal = np.linalg.eigh(directions.T @ directions)[1][:, 0]
        axis = directions.mean(axis=0)
        angle = np.arctan2(directions @ np.cross(normal, axis), directions @ axis)
        weight = np.array([len(curve.points) for curve in group], dtype=float)
        sigma = np.sqrt(np.average([curve.sigma**2 for curve in group], weights=weight))
        strength = np.average([curve.strength for curve in group], weights=weight)
        order = np.argsort(angle, kind="stable")
        joined.append(Curve(places[order], float(sigma), float(strength)))
    return joined

"""Pieces of one line joined under a camera: curves that lie on one great circle.

The matrices A of two pieces add up (`great_circles`), so a pair is tried by the smallest
eigenvector of a 3x3 matrix. Polarity plays no part, so the edges of a chessboard, which flip at
every corner, are joined to whole lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from classical.camera import Division, KannalaBrandt, Pinhole
from classical.lines.curve import Curve
from classical.lines.great_circles import CirclePieces, describe_curves, own_rms

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


def join_curves(
    curves: Sequence[Curve],
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
    pieces, unseen = describe_curves(curves, camera)
    for _ in range(config.rounds):
        pairs = _best_pairs(pieces, config)
        if not len(pairs):
            break
        pieces = _merge(pieces, pairs)
    alone = [curves[group[0]] for group in pieces.members if len(group) == 1]
    joined = _joined([[curves[k] for k in g] for g in pieces.members if len(g) > 1], camera)
    return sorted(alone + joined + [curves[k] for k in unseen], key=lambda curve: -curve.length)


def _best_pairs(pieces: CirclePieces, config: JoinConfig) -> list[tuple[int, int]]:
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


def _near_pairs(
    pieces: CirclePieces, config: JoinConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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


def _overlap(pieces: CirclePieces, i: np.ndarray, j: np.ndarray, normal: np.ndarray) -> np.ndarray:
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


def _merge(pieces: CirclePieces, pairs: list[tuple[int, int]]) -> CirclePieces:
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
    return CirclePieces(
        scatter[keep],
        count[keep],
        own_rms(scatter[keep], count[keep]),
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
        is_hinted = all(curve.is_hinted for curve in group)
        joined.append(Curve(places[order], float(sigma), float(strength), is_hinted))
    return joined

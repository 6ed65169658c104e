"""Edge points linked into chains: ordered sequences without branches.

Every point has two ports, one on each side along its tangent, and each port takes at most one
link. A port and the port it would like best are linked when the liking is mutual (best = nearest
and straightest); so a chain ends where edges meet. The chains are put in order by one depth-first
search, without a loop over points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, depth_first_order

from classical.lines.edges import EdgePoints
from classical.lines.pieces import gather_ranges

_REACH = 2  # links span at most this many pixels along each axis
_MAX_SLANT = 0.75  # largest sine between a link and the tangent at either end
_MIN_AGREEMENT = 0.7  # smallest cosine between the tangents of linked points
_SLANT_COST = 3.0  # weight of the squared distance across against the squared length of a link
_ROUNDS = 3  # of mutual matching


@dataclass(frozen=True)
class Chains:
    """Sequences of indices, one after another in one array.

    Attributes:
        order: Indices of points, in order along each chain, shape (m,).
        offsets: Chain c is order[offsets[c] : offsets[c + 1]], shape (c + 1,).
    """

    order: Int[np.ndarray, " m"]
    offsets: Int[np.ndarray, " c1"]

    def __len__(self) -> int:
        return len(self.offsets) - 1


def link_points(edges: EdgePoints, *, directed: bool = True, min_points: int = 8) -> Chains:
    """Link points to chains.

    Args:
        edges: Points with normals, at most one a pixel.
        directed: True if the sign of a normal means something (edges: dark to bright), so that
            linked points must agree in it; False for ridges.
        min_points: Shorter chains are dropped.

    Returns:
        Chains of at least `min_points` points; no point is in two of them.
    """
    first, second, cost = _candidate_pairs(edges, directed)
    return _in_order(_match(len(edges.points), first, second, cost), min_points)


def _candidate_pairs(
    edges: EdgePoints, directed: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ports of neighbouring points that may be linked, in pairs, and their cost.

    Port p of point i, 1 ahead and 0 behind, is 2 i + p.
    """
    pad = _REACH
    stride = edges.width + 2 * pad
    cells = (edges.cells // edges.width + pad) * stride + edges.cells % edges.width + pad
    index = np.full((edges.height + 2 * pad) * stride, -1, dtype=np.int32)
    index[cells] = np.arange(len(cells), dtype=np.int32)
    u, v = np.array(edges.points.T, dtype=np.float32, order="C")
    normal_u, normal_v = np.array(edges.normals.T, dtype=np.float32, order="C")
    tangent_u, tangent_v = -normal_v, normal_u
    found = []
    for down, right in _half_neighbourhood(_REACH):
        neighbour = index[cells + (down * stride + right)]
        i = np.flatnonzero(neighbour >= 0)
        j = neighbour[i].astype(np.int64)
        du, dv = u[j] - u[i], v[j] - v[i]
        i_u, i_v, j_u, j_v = tangent_u[i], tangent_v[i], tangent_u[j], tangent_v[j]
        ahead_i, ahead_j = i_u * du + i_v * dv, j_u * du + j_v * dv
        agreement = i_u * j_u + i_v * j_v
        squared = np.maximum(du * du + dv * dv, 1e-4)
        squared_i, squared_j = ahead_i * ahead_i, ahead_j * ahead_j
        limit = (1 - _MAX_SLANT**2) * squared
        fits = (squared_i > limit) & (squared_j > limit)
        fits &= (agreement if directed else np.abs(agreement)) > _MIN_AGREEMENT
        fits &= (ahead_i > 0) == ((ahead_j > 0) ^ (agreement < 0))
        cost = squared + _SLANT_COST * (2 * squared - squared_i - squared_j)
        found.append(
            ((2 * i + (ahead_i > 0))[fits], (2 * j + (ahead_j <= 0))[fits], cost[fits]),
        )
    first, second, cost = (np.concatenate(column) for column in zip(*found, strict=True))
    return first, second, cost


def _half_neighbourhood(reach: int) -> list[tuple[int, int]]:
    """Offsets (down, right) of a square window, one of each opposite pair."""
    span = range(-reach, reach + 1)
    return [(down, right) for down in span for right in span if (down, right) > (0, 0)]


def _match(count: int, first: np.ndarray, second: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Mutual best matching of ports.

    Returns:
        For each port the one it is linked to, or -1; shape (2 count,).
    """
    a, b, key = first, second, _keys(cost)
    links = np.full(2 * count, -1, dtype=np.int64)
    best = np.empty(2 * count, dtype=np.int64)
    for _ in range(_ROUNDS):
        best[:] = np.iinfo(np.int64).max
        np.minimum.at(best, a, key)
        np.minimum.at(best, b, key)
        mutual = (best[a] == key) & (best[b] == key)
        links[a[mutual]], links[b[mutual]] = b[mutual], a[mutual]
        free = (links[a] < 0) & (links[b] < 0)
        a, b, key = a[free], b[free], key[free]
        if not len(a):
            break
    return links


def _keys(cost: np.ndarray) -> np.ndarray:
    """Integers ordered as positive float32 numbers are; of equal ones the last is the smallest.

    The bits of positive floats are ordered as they are; what is below them tells equal ones apart.
    """
    bits = cost.view(np.int32).astype(np.int64) << 32
    bits |= np.arange(len(cost) - 1, -1, -1)
    return bits


def _in_order(links: np.ndarray, min_points: int) -> Chains:
    """Read paths out of the links, from the earlier of their ends, by their earliest points.

    Closed paths are cut open at their earliest point.
    """
    order, offsets = _open_paths(links)
    unseen = np.ones(len(links) // 2, dtype=bool)
    unseen[order] = False
    closed = np.flatnonzero(unseen)
    if len(closed):
        more, more_offsets = _open_paths(_cut_open(links, closed))
        order = np.concatenate([order, closed[more]])
        offsets = np.concatenate([offsets, offsets[-1] + more_offsets[1:]])
    kept = np.flatnonzero(np.diff(offsets) >= min_points)
    if not len(kept):
        return Chains(np.empty(0, dtype=np.int64), np.zeros(1, dtype=np.int64))
    earliest = np.minimum.reduceat(order, offsets[:-1])[kept]
    kept = kept[np.argsort(earliest)]
    selected, chains = gather_ranges(offsets[kept], offsets[kept + 1])
    return Chains(order[selected], chains)


def _open_paths(links: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points along the paths that have ends, one path after another, and the paths' offsets."""
    count = len(links) // 2
    degree = (links >= 0).reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(degree < 2)
    if not len(ends):
        return np.empty(0, dtype=np.int64), np.zeros(1, dtype=np.int64)
    # a ladder beside the points: from each rung first to an end, with all its path, then on
    rungs = count + np.arange(len(ends))
    ladder = np.stack([ends, rungs + 1], axis=1).ravel()[:-1]
    indices = np.concatenate([links[links >= 0] // 2, ladder])
    degree = np.concatenate([[0], degree, np.full(len(ends), 2)])
    degree[-1] = 1
    size = count + len(ends)
    graph = csr_array((np.ones(len(indices)), indices, np.cumsum(degree)), shape=(size, size))
    visited = depth_first_order(graph, count, return_predecessors=False)
    is_point = visited < count
    order = visited[is_point].astype(np.int64)
    starts = np.flatnonzero(is_point[1:] & ~is_point[:-1]) + 1
    return order, np.append(np.cumsum(is_point)[starts] - 1, len(order))


def _cut_open(links: np.ndarray, closed: np.ndarray) -> np.ndarray:
    """The links of the points of closed paths alone, one of each path removed."""
    small = np.full(len(links) // 2, -1, dtype=np.int64)
    small[closed] = np.arange(len(closed))
    partner = links.reshape(-1, 2)[closed].ravel()
    cut = 2 * small[partner // 2] + partner % 2
    graph = csr_array((np.ones(len(cut)), cut // 2, np.arange(0, len(cut) + 1, 2)))
    label = connected_components(graph, directed=False)[1]
    first = 2 * np.unique(label, return_index=True)[1]
    cut[cut[first]] = -1
    cut[first] = -1
    return cut

"""Edge points linked into chains: ordered sequences without branches.

Every point has two ports, one on each side along its tangent, and each port takes at most one
link. A port and the port it would like best are linked when the liking is mutual (best = nearest
and straightest); so a chain ends where edges meet. The chains are put in order by pointer doubling,
without a loop over points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from classical.lines.edges import EdgePoints

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
    first, first_port, second, second_port, cost = _candidate_pairs(edges, directed)
    links = _match(len(edges.points), first, first_port, second, second_port, cost)
    return _in_order(links, min_points)


def _candidate_pairs(edges: EdgePoints, directed: bool) -> tuple[np.ndarray, ...]:
    """Pairs of neighbouring points that may be linked, with their ports and cost."""
    pad = _REACH
    stride = edges.width + 2 * pad
    cells = (edges.cells // edges.width + pad) * stride + edges.cells % edges.width + pad
    index = np.full((edges.height + 2 * pad) * stride, -1, dtype=np.int32)
    index[cells] = np.arange(len(cells), dtype=np.int32)
    points = edges.points.astype(np.float32)
    tangents = np.stack([-edges.normals[:, 1], edges.normals[:, 0]], axis=1).astype(np.float32)
    found = []
    for down, right in _half_neighbourhood(_REACH):
        neighbour = index[cells + down * stride + right]
        i = np.flatnonzero(neighbour >= 0)
        j = neighbour[i]
        du, dv = (points[j] - points[i]).T
        ti, tj = tangents[i].T, tangents[j].T
        ahead_i, ahead_j = ti[0] * du + ti[1] * dv, tj[0] * du + tj[1] * dv
        squared = np.maximum(du * du + dv * dv, 1e-4)
        across = 2 * squared - ahead_i**2 - ahead_j**2
        agreement = ti[0] * tj[0] + ti[1] * tj[1]
        limit = (1 - _MAX_SLANT**2) * squared
        fits = (ahead_i**2 > limit) & (ahead_j**2 > limit)
        fits &= (agreement if directed else np.abs(agreement)) > _MIN_AGREEMENT
        fits &= (ahead_i > 0) == ((ahead_j > 0) ^ (agreement < 0))
        cost = squared + _SLANT_COST * across
        found.append(
            (i[fits], ahead_i[fits] > 0, j[fits], ahead_j[fits] <= 0, cost[fits]),
        )
    i, port_i, j, port_j, cost = (np.concatenate(column) for column in zip(*found, strict=True))
    return i, port_i.astype(np.int64), j.astype(np.int64), port_j.astype(np.int64), cost


def _half_neighbourhood(reach: int) -> list[tuple[int, int]]:
    """Offsets (down, right) of a square window, one of each opposite pair."""
    span = range(-reach, reach + 1)
    return [(down, right) for down in span for right in span if (down, right) > (0, 0)]


def _match(
    count: int,
    first: np.ndarray,
    first_port: np.ndarray,
    second: np.ndarray,
    second_port: np.ndarray,
    cost: np.ndarray,
) -> np.ndarray:
    """Mutual best matching of ports.

    Returns:
        For port p of point i at 2 i + p: the port it is linked to, or -1; shape (2 count,).
    """
    order = np.argsort(-cost, kind="stable")  # the cheapest comes last and wins assignments
    a, b = (2 * first + first_port)[order], (2 * second + second_port)[order]
    links = np.full(2 * count, -1, dtype=np.int64)
    best = np.empty(2 * count, dtype=np.int64)
    for _ in range(_ROUNDS):
        rank = np.arange(len(a))
        best[:] = -1
        # two-step maximum: ports of either end compete for the same slot
        best[a] = rank
        best_b = np.full(2 * count, -1, dtype=np.int64)
        best_b[b] = rank
        np.maximum(best, best_b, out=best)
        mutual = (best[a] == rank) & (best[b] == rank)
        links[a[mutual]], links[b[mutual]] = b[mutual], a[mutual]
        free = (links[a] < 0) & (links[b] < 0)
        a, b = a[free], b[free]
        if not len(a):
            break
    return links


def _in_order(links: np.ndarray, min_points: int) -> Chains:
    """Read paths out of the links; closed paths are cut open at their first point."""
    count = len(links) // 2
    ports = np.flatnonzero(links >= 0)
    graph = coo_array((np.ones(len(ports)), (ports // 2, links[ports] // 2)), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    size = np.bincount(label, minlength=1)
    nodes = np.flatnonzero(size[label] >= min_points)
    if not len(nodes):
        return Chains(np.empty(0, dtype=np.int64), np.zeros(1, dtype=np.int64))
    small = np.full(count, -1, dtype=np.int64)
    small[nodes] = np.arange(len(nodes))
    label = np.unique(label[nodes], return_inverse=True)[1]
    links = links.reshape(count, 2)[nodes]
    links = np.where(links >= 0, 2 * small[links // 2] + links % 2, -1).ravel()
    links = _cut_open(links, label)
    distance, terminal = _distance_to_end(links)
    # of the two directions through a point take the one that ends at the chain's later end
    is_end = (links.reshape(-1, 2) < 0).any(axis=1)
    last = np.full(label.max() + 1, -1, dtype=np.int64)
    ends = np.flatnonzero(is_end)
    last[label[ends]] = ends
    forward = terminal.reshape(-1, 2) == last[label][:, None]
    # a chain's last point has one dart that stays and one that leaves: distance 0 is the former
    rank = np.where(forward, distance.reshape(-1, 2), np.iinfo(np.int64).max).min(axis=1)
    order = np.lexsort((-rank, label))
    offsets = np.concatenate([[0], np.cumsum(np.bincount(label))])
    return Chains(nodes[order], offsets)


def _cut_open(links: np.ndarray, label: np.ndarray) -> np.ndarray:
    """Remove one link from each component in which no port is free."""
    closed = np.ones(label.max() + 1, dtype=bool)
    closed[label[np.flatnonzero(links < 0) // 2]] = False
    if closed.any():
        first = np.unique(label, return_index=True)[1][closed]
        links = links.copy()
        partner = links[2 * first]
        links[2 * first] = -1
        links[partner] = -1
    return links


def _distance_to_end(links: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Steps until a walk that leaves a point through a port ends, and the point where it ends.

    A walk that leaves through port p arrives at port q = links[p] and goes on through the other
    port of that point, q ^ 1.
    """
    ports = np.arange(len(links))
    following = np.where(links >= 0, links ^ 1, ports)
    distance = (links >= 0).astype(np.int64)
    while True:
        further = following[following]
        if np.array_equal(further, following):
            return distance, following // 2
        distance = distance + distance[following]
        following = further

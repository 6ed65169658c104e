"""Curves moved to the sub-pixel edges of a picture beside them.

A centre line of a heatmap, or an edge that was found in a reduced picture, says where an edge
is to about a pixel or two. Brightness profiles across the curve are taken from the full picture;
the edge is a path of large derivative through them that keeps its distance from the curve nearly
constant (found by dynamic programming, for all curves at once). A painted bar has two sides, and
such a path stays on one of them. At last each point is placed by a parabola, as in `edges`.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from classical.lines.edges import step_per_gradient
from classical.lines.pieces import arc_length, fit_by_length, gather_ranges

_TILE = 1024  # columns of the array that is handed to cv2.remap
_TINY = 1e-6


@dataclass(frozen=True)
class SnapConfig:
    """How edges beside a curve are found; lengths in pixels of the picture that is sampled.

    Attributes:
        spacing: Distance between points along the curve.
        step: Distance between samples across the curve.
        sigma: Standard deviation of the Gaussian across the curve before differentiation.
        block: Points that share one node of the path.
        min_contrast: Smallest step of an edge, grey levels of 255.
        full_contrast: Where no step reaches this, edges count for less.
        drift_cost: Cost of a path that moves one step from a node to the next.
        offset_cost: Cost at the far end of the search range.
    """

    spacing: float = 1.0
    step: float = 0.5
    sigma: float = 1.2
    block: int = 6
    min_contrast: float = 6.0
    full_contrast: float = 40.0
    drift_cost: float = 0.15
    offset_cost: float = 0.2


@dataclass(frozen=True)
class SnappedPoints:
    """Points on edges, still in the order and the pieces of the curves they come from.

    Attributes:
        points: Pixels (u, v), shape (m, 2).
        contrast: Height of the edge, grey levels, shape (m,).
        found: True where there is an edge; else the point is on the given curve, shape (m,).
        offsets: Curve p is points[offsets[p] : offsets[p + 1]], shape (p + 1,).
    """

    points: Float[np.ndarray, "m 2"]
    contrast: Float[np.ndarray, " m"]
    found: Bool[np.ndarray, " m"]
    offsets: Int[np.ndarray, " p1"]


def snap_to_edges(
    grey: np.ndarray,
    points: Float[np.ndarray, "m 2"],
    offsets: Int[np.ndarray, " p1"],
    *,
    reach: float,
    config: SnapConfig = SnapConfig(),
) -> SnappedPoints:
    """Move curves to the edges beside them.

    Args:
        grey: Picture in grey levels 0…255, uint8 or float32.
        points: Points in order along curves, pixels of `grey`, shape (m, 2).
        offsets: Curve p is points[offsets[p] : offsets[p + 1]], shape (p + 1,).
        reach: Edges are sought up to so many pixels on either side.
        config: How edges are found.
    """
    nodes, normals, offsets = even_nodes(points, offsets, config.spacing)
    steps = max(2, int(np.ceil(reach / config.step)))
    slope = _profile_slopes(grey, nodes, normals, steps, config)
    path = _edge_path(slope, offsets, config)
    shift, height, found = _refine(slope, path, config)
    return SnappedPoints(nodes + normals * shift[:, None], height, found, offsets)


def even_nodes(
    points: np.ndarray, offsets: np.ndarray, spacing: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Equally spaced points on the smoothed curves, unit normals there, and new offsets."""
    fit = fit_by_length(points, offsets)
    tangents = fit.tangents
    normals = np.stack([-tangents[:, 1], tangents[:, 0]], axis=1)
    smooth = points - normals * fit.distance[:, None]
    position, total = arc_length(smooth, offsets)
    counts = np.maximum(2, np.round(total / spacing).astype(np.int64) + 1)
    new_offsets = np.concatenate([[0], np.cumsum(counts)])
    # one increasing coordinate over all curves, so that one interpolation serves them all
    base = np.concatenate([[0.0], np.cumsum(total + 1.0)[:-1]])
    here = position + np.repeat(base, np.diff(offsets))
    share = (np.arange(new_offsets[-1]) - np.repeat(new_offsets[:-1], counts)) / np.repeat(
        counts - 1, counts
    )
    there = np.repeat(base, counts) + share * np.repeat(total, counts)
    nodes = np.stack([np.interp(there, here, smooth[:, axis]) for axis in (0, 1)], axis=1)
    along = np.stack([np.interp(there, here, tangents[:, axis]) for axis in (0, 1)], axis=1)
    along /= np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    return nodes, np.stack([-along[:, 1], along[:, 0]], axis=1), new_offsets


def sample(grey: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Bilinear samples of a picture at pixels (u, v), float32, shape of u."""
    if not u.size:
        return np.empty(u.shape, np.float32)
    rows = -(-u.size // _TILE)
    maps = np.zeros((2, rows * _TILE), np.float32)
    maps[0, : u.size], maps[1, : u.size] = u.ravel(), v.ravel()
    map_u, map_v = maps.reshape(2, rows, _TILE)
    values = cv2.remap(grey, map_u, map_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return values.reshape(-1)[: u.size].astype(np.float32).reshape(u.shape)


def _profile_slopes(
    grey: np.ndarray, nodes: np.ndarray, normals: np.ndarray, steps: int, config: SnapConfig
) -> np.ndarray:
    """Derivative across each curve at offsets −steps…steps, grey levels a pixel, (m, 2 steps + 1).

    Each profile is the mean of three, one spacing apart along the curve.
    """
    kernel = _derivative_kernel(config.sigma / config.step) / config.step
    pad = len(kernel) // 2
    across = np.arange(-steps - pad, steps + pad + 1) * config.step
    u, v = (nodes[:, axis, None] + normals[:, axis, None] * across for axis in (0, 1))
    values = sample(grey, u, v)
    values = cv2.blur(values, (1, 3), borderType=cv2.BORDER_REPLICATE)
    slopes = cv2.filter2D(values, cv2.CV_32F, kernel[None, :])
    return slopes[:, pad : pad + 2 * steps + 1]


def _derivative_kernel(sigma: float) -> np.ndarray:
    """Derivative of a Gaussian as a correlation kernel; a ramp of 1 a sample gives 1."""
    reach = int(np.ceil(3 * sigma))
    x = np.arange(-reach, reach + 1)
    kernel = x * np.exp(-0.5 * (x / sigma) ** 2)
    return (kernel / (kernel * x).sum()).astype(np.float32)


def _edge_path(slope: np.ndarray, offsets: np.ndarray, config: SnapConfig) -> np.ndarray:
    """Index across at each point of a path of large derivative that drifts slowly, shape (m,)."""
    lengths = np.diff(offsets)
    blocks = -(-lengths // config.block)
    label = np.repeat(np.arange(len(lengths)), lengths)
    index = np.arange(len(slope)) - offsets[:-1][label]
    width, count = slope.shape[1], len(lengths)
    # coherent mean over a block: noise cancels, an edge does not
    starts, _ = gather_ranges(offsets[:-1], offsets[:-1] + blocks)
    starts = np.repeat(offsets[:-1], blocks) + config.block * (
        starts - np.repeat(offsets[:-1], blocks)
    )
    sums = np.add.reduceat(slope, starts, axis=0)
    members = np.diff(np.append(starts, len(slope)))
    contrast = np.abs(sums / members[:, None]) * step_per_gradient(config.sigma)
    gain = contrast / np.maximum(contrast.max(axis=1, keepdims=True), config.full_contrast)
    off = np.linspace(-1, 1, width) ** 2 * config.offset_cost
    table = np.zeros((count, int(blocks.max(initial=1)), width), np.float32)
    owner = np.repeat(np.arange(count), blocks)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(blocks) - blocks, blocks)
    table[owner, place] = gain - off
    best = _viterbi(table, blocks, config.drift_cost)
    centre = (index + 0.5) / config.block - 0.5
    low = np.clip(np.floor(centre).astype(int), 0, blocks[label] - 1)
    high = np.minimum(low + 1, blocks[label] - 1)
    weight = np.clip(centre - low, 0, 1)
    return (1 - weight) * best[label, low] + weight * best[label, high]


def _viterbi(table: np.ndarray, lengths: np.ndarray, drift_cost: float) -> np.ndarray:
    """Best paths through gain tables (c, n, w), steps of −1, 0 or 1 across; indices (c, n)."""
    count, longest, width = table.shape
    order = np.argsort(-lengths, kind="stable")  # the first ones are those that go on
    table, going_on = table[order], [int((lengths > n).sum()) for n in range(longest)]
    padded = np.full((count, width + 2), -np.inf, np.float32)
    total = padded[:, 1:-1]
    total[:] = table[:, 0]
    choice = np.zeros((count, longest, width), np.int8)
    for n, some in enumerate(going_on[1:], start=1):
        low, high = padded[:some, :-2] - np.float32(drift_cost), padded[:some, 2:]
        here, high = total[:some], high - np.float32(drift_cost)
        best = np.maximum(np.maximum(low, here), high)
        not_low = low < best
        choice[:some, n] = not_low.view(np.int8) + (not_low & (here < best)) - 1
        np.add(best, table[:some, n], out=here)
    path = np.zeros((count, longest), np.int64)
    state = total.argmax(axis=1)
    for n in range(longest - 1, -1, -1):
        some = going_on[n]
        path[order[:some], n] = state[:some]
        state[:some] += choice[np.arange(some), n, state[:some]]
    return path


def _refine(
    slope: np.ndarray, path: np.ndarray, config: SnapConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offset in pixels of the derivative's peak nearest to the path, its height, if it is one."""
    width = slope.shape[1]
    rows = np.arange(len(slope))
    magnitude = np.abs(slope)
    place = np.clip(np.round(path).astype(int), 1, width - 2)
    for _ in range(int(np.ceil(1.5 / config.step))):  # climb by at most 1.5 pixels
        around = np.stack([magnitude[rows, place + d] for d in (-1, 0, 1)])
        place = np.clip(place + around.argmax(axis=0) - 1, 1, width - 2)
    before, centre, after = (np.log(magnitude[rows, place + d] + _TINY) for d in (-1, 0, 1))
    peak = (centre >= before) & (centre >= after)
    shift = 0.5 * (before - after) / np.minimum(before - 2 * centre + after, -_TINY)
    height = magnitude[rows, place].astype(np.float64) * step_per_gradient(config.sigma)
    offset = (place + np.clip(shift, -0.5, 0.5) - width // 2) * config.step
    return offset.astype(np.float64), height, np.asarray(peak & (height >= config.min_contrast))

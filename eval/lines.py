"""Are lines straight again? Precision and recall of line maps, and straightness of true lines."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_flow
from scipy.spatial import KDTree
from skimage.morphology import skeletonize

from eval.frame import Similarity
from eval.metrics import Lens, rectified

THRESHOLDS = (5, 10, 20, 40, 80, 120, 160, 200, 240, 255)
"""Lengths τ of the paper; a line map holds min(length, 255)."""

TOLERANCE = 0.0075
"""Largest distance of two matched pixels as a fraction of the diagonal (Martin et al. 2004)."""

_THICKNESS = 2  # OpenCV paints polylines of this thickness 3 px wide, as the paper's lines are
_SUBPIXEL_BITS = 4


@dataclass(frozen=True)
class MatchCounts:
    """Sizes of the sets of the paper's precision and recall, one entry a threshold.

    Attributes:
        matched: |P ∩ G|, pixels of P matched one to one with pixels of G.
        found: |P|, edge pixels of the rectified map with length at most τ.
        true: |G|, edge pixels of the true map.
    """

    matched: Int[ndarray, " t"]
    found: Int[ndarray, " t"]
    true: int

    @property
    def precision(self) -> Float[ndarray, " t"]:
        """|P ∩ G| / |P|; 1 where P is empty: nothing was wrong."""
        return np.where(self.found > 0, self.matched / np.maximum(self.found, 1), 1.0)

    @property
    def recall(self) -> Float[ndarray, " t"]:
        """|P ∩ G| / |G|; 1 where G is empty: nothing was missed."""
        if self.true == 0:
            return np.ones(len(self.matched))
        return self.matched / self.true

    @property
    def f_score(self) -> float:
        """Largest harmonic mean of precision and recall over the thresholds."""
        precision, recall = self.precision, self.recall
        total = precision + recall
        return float(np.max(2 * precision * recall / np.where(total > 0, total, 1.0)))


def draw_line_map(
    curves: Sequence[Float[ndarray, "_ 2"]], width: int, height: int
) -> UInt8[ndarray, "h w"]:
    """Draw bent lines 3 px wide; the value of a pixel is the length of its line, at most 255.

    Args:
        curves: Polylines in pixels of the picture to draw, shape (n, 2) each.
        width: Width of the picture in pixels.
        height: Height of the picture in pixels.

    Returns:
        The paper's L_f: 0 where there is no line. Longer lines are drawn over shorter ones.
    """
    canvas = np.zeros((height, width), dtype=np.uint8)
    lengths = [float(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()) for curve in curves]
    for index in np.argsort(lengths, kind="stable"):
        points = np.clip(curves[index], -(2**15), 2**15)
        fixed = np.round(points * 2**_SUBPIXEL_BITS).astype(np.int32).reshape(-1, 1, 2)
        value = int(np.clip(round(lengths[index]), 1, 255))
        cv2.polylines(canvas, [fixed], False, value, _THICKNESS, cv2.LINE_8, _SUBPIXEL_BITS)
    return canvas


def thin(line_map: UInt8[ndarray, "h w"]) -> UInt8[ndarray, "h w"]:
    """Keep the middle of each line, one pixel wide, as Martin et al. do before they match."""
    return np.where(skeletonize(line_map > 0), line_map, 0).astype(np.uint8)


def match_line_maps(
    rectified_map: UInt8[ndarray, "h w"],
    true_map: UInt8[ndarray, "h w"],
    *,
    tolerance: float = TOLERANCE,
) -> MatchCounts:
    """Match the edge pixels of a rectified line map with those of the true one.

    The paper (Evaluation Metrics) thresholds the rectified map only: P(τ) holds the pixels with
    0 < length ≤ τ (the longest lines have the clipped length 255, so "smaller than" includes it),
    G holds all edge pixels of the truth. Both maps are thinned first. A matching is one to one,
    within `tolerance` times the diagonal, and of the largest possible size: that is what the
    minimum-cost assignment of Martin et al. (PAMI 2004) counts, as its outliers cost more than
    any match.
    """
    found_map, true_pixels = thin(rectified_map), np.argwhere(thin(true_map) > 0)
    limit = tolerance * float(np.hypot(*true_map.shape))
    pixels = np.argwhere(found_map > 0)
    lengths = found_map[found_map > 0]
    matched, found = [], []
    for threshold in THRESHOLDS:
        chosen = pixels[lengths <= threshold]
        found.append(len(chosen))
        if matched and found[-1] == found[-2]:
            matched.append(matched[-1])
            continue
        matched.append(count_matches(chosen, true_pixels, limit))
    return MatchCounts(np.array(matched), np.array(found), len(true_pixels))


def count_matches(
    found: Float[ndarray, "n 2"] | Int[ndarray, "n 2"],
    true: Float[ndarray, "m 2"] | Int[ndarray, "m 2"],
    limit: float,
) -> int:
    """Size of the largest one-to-one matching of points no farther apart than `limit`.

    The maximum flow of the bipartite graph with unit capacities, by Dinic's algorithm (which is
    Hopcroft and Karp's there). SciPy's `maximum_bipartite_matching` counts the same, but can take
    minutes on wide lines.
    """
    if len(found) == 0 or len(true) == 0:
        return 0
    near = KDTree(found).sparse_distance_matrix(KDTree(true), limit, output_type="coo_matrix")
    n, m = len(found), len(true)
    source, sink = n + m, n + m + 1
    tails = np.concatenate([np.full(n, source), near.row, np.arange(n, n + m)])
    heads = np.concatenate([np.arange(n), near.col + n, np.full(m, sink)])
    capacity = np.ones(len(tails), dtype=np.int32)
    graph = csr_matrix((capacity, (tails, heads)), shape=(n + m + 2, n + m + 2))
    return int(maximum_flow(graph, source, sink, method="dinic").flow_value)


def straightness(
    lens: Lens | None,
    curves: Sequence[Float[ndarray, "_ 2"]],
    width: int,
    height: int,
    *,
    similarity: Similarity | None = None,
    keep: Sequence[Bool[ndarray, " _"]] | None = None,
) -> float:
    """RMS distance of rectified true lines from their best straight lines.

    Args:
        lens: The estimated camera; `None` leaves the photograph alone.
        curves: Points along true straight lines in pixels of the photograph, (n, 2) each.
        width: Width of the photograph in pixels.
        height: Height of the photograph in pixels.
        similarity: The best similarity of the aligned protocol. Its scale multiplies the result,
            so that nobody wins by shrinking the picture; without it the plain frame counts.
        keep: For each curve, which points to use (those the true lens sees at θ ≤ θ_max).

    Returns:
        Root of the mean squared distance over all points of all lines, in pixels of the 320 px
        frame; the best line of each is by total least squares. NaN without lines of 3 points.
    """
    chosen = [curve if keep is None else curve[keep[i]] for i, curve in enumerate(curves)]
    chosen = [curve for curve in chosen if len(curve) >= 3]
    if not chosen:
        return float("nan")
    places = rectified(lens, np.concatenate(chosen), width, height)
    ends = np.cumsum([len(curve) for curve in chosen])[:-1]
    squares = sum(_off_line(line) for line in np.split(places, ends))
    scale = 1.0 if similarity is None else similarity.scale
    return scale * float(np.sqrt(squares / len(places)))


def _off_line(line: Float[ndarray, "n 2"]) -> float:
    """Sum of squared distances from the best line: the smaller principal moment."""
    off = line - line.mean(axis=0)
    return float(np.linalg.svd(off, compute_uv=False)[-1] ** 2)


def grid_lines(truth: Lens, *, theta_max: float) -> list[Float[ndarray, "_ 2"]]:
    """Bent images of a grid of straight lines, for photographs whose own lines nobody marked.

    Seven upright and seven level lines of the rectified plane, spread evenly over the disc of
    angles up to `theta_max` and cut by it, with 41 points each.
    """
    reach = np.tan(theta_max)
    curves = []
    for offset in np.linspace(-0.75, 0.75, 7) * reach:
        along = np.linspace(-1.0, 1.0, 41) * np.sqrt(reach**2 - offset**2)
        across = np.full_like(along, offset)
        for x, y in ((across, along), (along, across)):
            rays = np.column_stack([x, y, np.ones_like(x)])
            points, seen = truth.project(rays / np.linalg.norm(rays, axis=1, keepdims=True))
            curves.append(points[seen])
    return curves

"""Alemán-Flores et al.: division distortion from the lines of one picture.

M. Alemán-Flores, L. Alvarez, L. Gomez, D. Santana-Cedrés, "Automatic Lens Distortion Correction
Using One-Parameter Division Models", Image Processing On Line 4, 2014, and, with two parameters and
a free centre, D. Santana-Cedrés et al., "An Iterative Optimization Algorithm for Lens Distortion
Correction Using Two-Parameter Models", Image Processing On Line 6, 2016.

What differs from the authors' programs, for all to see:

- Pictures with a longer side under 640 px are enlarged first, since the method starves at 320x320;
  pictures over 1280 px are reduced. Parameters come back in pixels of the picture given.
- One slice of the Hough space a worker is in memory at a time, and the five distance bins of a vote
  are summed once for a slice; the answer is the same. A first look at every fifth angle tells which
  slices to search in full.
- Fewer than four lines that chance cannot explain (see `evidence`) are a failed estimate; the
  authors' programs always answer.
- The answer is a model and not a corrected picture, and its scale is left to whoever warps.

The centre starts (2014: stays) at (w / 2, h / 2) as in the articles, which is half a pixel right of
and below the middle where the top-left pixel's centre is (0, 0).

How we read what the descriptions leave open, for both: the Gaussian is the recursive one of Alvarez
and Mazorra (see `edges.smoothing_kernel`), and lines farther from the centre than 1.2 half
diagonals are not looked for. On drawn grids the slice is then the authors' and the displacement
theirs to 1 % at mid-radius; with a sampled Gaussian a grid seen by an equidistant lens of 130° went
to the next slice, 4.5 % off. For 2016: directions of edges are compared with their sign; a lonely
point has no neighbour in its 5x5 square; the 3x3 squares that keep one point are cells side by
side; lines merge over a gap between their extents; Newton's method ends when the energy falls by
less than the tolerance; a round of the outer loop without growth still hands its model to the next
one; and that loop has a last round.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, UInt8

from classical.baselines.aleman_flores.cleaning import clean_edges
from classical.baselines.aleman_flores.config import AlemanFloresConfig
from classical.baselines.aleman_flores.edges import EdgePoints, detect_edges
from classical.baselines.aleman_flores.evidence import significant_lines
from classical.baselines.aleman_flores.hough import HoughMaxima, hough_search, undistort_edges
from classical.baselines.aleman_flores.lines import LineSet, lines_from_maxima
from classical.baselines.aleman_flores.refine import Refined, coefficient, refine_p
from classical.baselines.aleman_flores.refine_two import coefficients, growths, refine_two
from classical.baselines.picture import WorkingPicture, working_picture
from classical.baselines.two_parameter import (
    TwoParameterDivision,
    division,
    farthest_corner,
    is_invertible,
)
from classical.camera import Division

CITATION = (
    "M. Alemán-Flores, L. Alvarez, L. Gomez, D. Santana-Cedrés: Automatic Lens Distortion "
    "Correction Using One-Parameter Division Models, IPOL 4 (2014); D. Santana-Cedrés et al.: An "
    "Iterative Optimization Algorithm for Lens Distortion Correction Using Two-Parameter Models, "
    "IPOL 6 (2016)"
)


@dataclass(frozen=True)
class AlemanFloresResult:
    """The model, or why there is none, and what the method saw on the way.

    Edge points, maxima and lines are in the working picture (`working.to_picture` maps pixels
    back); the maxima and lines live in its undistorted plane about `refined.centre`.

    Attributes:
        model: The distortion in pixels of the picture given; None if the estimate failed.
        status: "ok" or "failed".
        reason: The failure in words; empty if there is none.
        working: The grey picture at working size.
        edges: Edge points (2016: after cleaning).
        maxima: Maxima of the chosen slice of the Hough space, and the score of every slice.
        lines: Lines and the edge points of each.
        significant: Number of lines that chance does not explain.
        refined: The refinement, in pixels of the working picture.
        rounds: Rounds of the outer loop (2016).
    """

    model: Division | TwoParameterDivision | None
    status: Literal["ok", "failed"]
    reason: str
    working: WorkingPicture
    edges: EdgePoints
    maxima: HoughMaxima | None = None
    lines: LineSet | None = None
    significant: int = 0
    refined: Refined | None = None
    rounds: int = 0

    def __bool__(self) -> bool:
        return self.model is not None

    def curves(self) -> list[Float[np.ndarray, "_ 2"]]:
        """Points of each line in order along it, in pixels of the picture given."""
        if self.lines is None:
            return []
        found = []
        for line in range(len(self.lines)):
            points = self.edges.points[self.lines.labels == line]
            centred = points - points.mean(axis=0)
            along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
            found.append(self.working.to_picture(points[np.argsort(along, kind="stable")]))
        return found


def estimate(
    image: UInt8[np.ndarray, "h w 3"] | UInt8[np.ndarray, "h w"],
    *,
    config: AlemanFloresConfig | None = None,
) -> AlemanFloresResult:
    """Estimate the distortion of one picture by the 2014 or the 2016 method.

    Args:
        image: Grey or RGB picture, uint8.
        config: Parameters; None takes those of the 2014 article.

    Raises:
        ValueError: If `image` is not an 8-bit grey or RGB picture.
    """
    config = config or AlemanFloresConfig()
    working = working_picture(image, smallest=config.smallest_side, largest=config.largest_side)
    edges = detect_edges(working.grey, config=config)
    height, width = working.grey.shape
    if config.variant == "2016":
        edges = clean_edges(edges, width, height)
    blank = AlemanFloresResult(None, "failed", "", working, edges)
    if len(edges) < config.least_points:
        return replace(blank, reason=f"Only {len(edges)} edge points were found.")
    found = _first_round(blank, config)
    if found.refined is None or found.significant < config.least_lines:
        reason = f"Only {found.significant} lines stand out from chance alignments of edge points."
        return replace(found, reason=reason)
    if config.variant == "2016":
        found = _outer_loop(found, config)
    return _finished(found)


def _first_round(blank: AlemanFloresResult, config: AlemanFloresConfig) -> AlemanFloresResult:
    """Search p over the whole Hough space about the middle of the picture, and refine."""
    height, width = blank.working.grey.shape
    centre, radius = (width / 2, height / 2), float(np.hypot(width, height)) / 2
    about, normals = blank.edges.points - np.array(centre), blank.edges.normals
    slices = np.linspace(0.0, config.p_max, round(config.p_max / config.p_step) + 1)
    maxima = hough_search(about, normals, radius, slices, config=config)
    k = coefficient(maxima.p, radius)
    flat, turned = undistort_edges(about, normals, k)
    lines = lines_from_maxima(flat, turned, maxima, config=config)
    found = replace(blank, maxima=maxima, lines=lines)
    if not len(lines):
        return found
    significant = significant_lines(
        blank.edges, flat, turned, lines, max(width, height), config=config
    )
    if config.variant == "2014":
        refined = refine_p(
            blank.edges.points, lines.labels, maxima.p, centre, radius, config=config
        )
    else:
        start = Refined(growths(k, 0.0, radius), centre, 0.0, 0, False)
        refined = refine_two(
            blank.edges.points, lines.labels, start, (width, height), config=config
        )
    return replace(found, significant=significant, refined=refined)


def _outer_loop(found: AlemanFloresResult, config: AlemanFloresConfig) -> AlemanFloresResult:
    """Seek lines again on corrected points while their number of points grows (2016)."""
    height, width = found.working.grey.shape
    radius = float(np.hypot(width, height)) / 2
    best, failures, rounds = found, 0, 0
    current = found.refined
    while current is not None and failures < config.outer_failures and rounds < config.outer_rounds:
        rounds += 1
        k1, k2 = _coefficients(current, (width, height))
        about = found.edges.points - np.array(current.centre)
        flat, turned = undistort_edges(about, found.edges.normals, k1, k2)
        maxima = hough_search(flat, turned, radius, np.zeros(1), config=config)
        lines = lines_from_maxima(flat, turned, maxima, config=config)
        if not len(lines):
            break
        current = refine_two(
            found.edges.points, lines.labels, current, (width, height), config=config
        )
        before, now = _members(best), int((lines.labels >= 0).sum())
        if now > before:
            best = replace(best, lines=lines, refined=current)
            if now < before * (1 + config.outer_growth):
                break
        else:
            failures += 1
    return replace(best, rounds=rounds)


def _members(found: AlemanFloresResult) -> int:
    return 0 if found.lines is None else int((found.lines.labels >= 0).sum())


def _coefficients(refined: Refined, size: tuple[int, int]) -> tuple[float, float]:
    """(k1, k2) in working pixels."""
    radius = farthest_corner(*refined.centre, *size)
    if len(refined.p) == 1:
        return coefficient(refined.p[0], radius), 0.0
    return coefficients(refined.p[0], refined.p[1], radius)


def _finished(found: AlemanFloresResult) -> AlemanFloresResult:
    """Put the model into pixels of the picture given."""
    working, refined = found.working, found.refined
    assert refined is not None
    height, width = working.grey.shape
    k1, k2 = _coefficients(refined, (width, height))
    if not is_invertible(k1, k2, farthest_corner(*refined.centre, width, height)):
        return replace(found, reason="The refined model folds inside the picture.")
    centre = working.to_picture(np.array([refined.centre]))[0]
    model = division(
        k1 * working.scale**2,
        k2 * working.scale**4,
        float(centre[0]),
        float(centre[1]),
        working.width,
        working.height,
    )
    return replace(found, model=model, status="ok")

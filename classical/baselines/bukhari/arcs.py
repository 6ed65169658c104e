"""Contours of a picture, and the circular arcs in them, by random sampling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from classical.baselines.bukhari.circle import (
    circles_through,
    distances,
    fit_geometric,
    fit_taubin,
)
from classical.baselines.bukhari.config import BukhariConfig
from classical.lines.chains import link_points
from classical.lines.edges import EdgeConfig, detect_edges

_LEAST_POINTS = 8


@dataclass(frozen=True)
class Arc:
    """A stretch of a contour that a circle describes.

    Attributes:
        points: Sub-pixel points in order, shape (n, 2).
        circle: (A, B, C, D) with A (x² + y²) + B x + C y + D = 0 and B² + C² − 4 A D = 1.
        length: Length along the points, px.
    """

    points: Float[np.ndarray, "n 2"]
    circle: Float[np.ndarray, " 4"]
    length: float


def find_contours(
    grey: Float[np.ndarray, "h w"], *, config: BukhariConfig
) -> list[Float[np.ndarray, "_ 2"]]:
    """Edges linked in order, cut where they meet, at sub-pixel positions.

    Canny's two thresholds work on whole contours: one is kept if it is above the low threshold
    everywhere and above the high one somewhere.
    """
    edges = detect_edges(
        np.asarray(grey, np.float32),
        config=EdgeConfig(sigma=config.sigma, min_contrast=config.low_contrast, noise_factor=0.0),
    )
    least = config.contour_share * max(grey.shape)
    chains = link_points(edges, min_points=_LEAST_POINTS)
    contours = []
    for start, stop in zip(chains.offsets[:-1], chains.offsets[1:], strict=True):
        order = chains.order[start:stop]
        if edges.contrast[order].max() >= config.high_contrast:
            points = edges.points[order]
            if path_length(points) >= least:
                contours.append(points)
    return contours


def find_arcs(
    contours: list[Float[np.ndarray, "_ 2"]],
    *,
    config: BukhariConfig,
    rng: np.random.Generator,
) -> list[Arc]:
    """Arcs of all contours, longest first.

    In each contour the best of many circles through three points is the one with the longest
    unbroken run of points near it; the run becomes an arc if it is long enough, and what is left
    on either side is searched again.
    """
    arcs: list[Arc] = []
    waiting = list(contours)
    while waiting:
        points = waiting.pop()
        if len(points) < _LEAST_POINTS or path_length(points) < config.arc_length:
            continue
        start, stop = _longest_run(points, config, rng)
        run = points[start:stop]
        length = path_length(run)
        if len(run) >= _LEAST_POINTS and length >= config.arc_length:
            arcs.append(Arc(run, fit_geometric(run), length))
            waiting += [points[:start], points[stop:]]
    arcs.sort(key=lambda arc: -arc.length)
    return arcs[: config.most_arcs]


def path_length(points: Float[np.ndarray, "n 2"]) -> float:
    """Length of a polyline, px."""
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def _longest_run(
    points: np.ndarray, config: BukhariConfig, rng: np.random.Generator
) -> tuple[int, int]:
    """First and last + 1 index of the longest run of points near one circle."""
    n = len(points)
    whole = distances(fit_taubin(points)[None], points)
    if (np.abs(whole) < config.arc_distance).all():
        return 0, n  # no trial could find more
    picks = np.sort(rng.integers(0, n, (config.arc_trials, 3)), axis=1)
    circles, valid = circles_through(points[picks])
    near = np.abs(distances(circles[valid], points)) < config.arc_distance
    if not len(near):
        return 0, 0
    index = np.arange(n, dtype=np.int32)
    last_far = np.maximum.accumulate(np.where(near, np.int32(-1), index), axis=1)
    runs = index - last_far
    ends = runs.argmax(axis=1)
    lengths = runs[np.arange(len(runs)), ends]
    best = int(lengths.argmax())
    stop = int(ends[best]) + 1
    return stop - int(lengths[best]), stop

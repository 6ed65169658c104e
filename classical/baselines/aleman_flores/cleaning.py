"""Cleaning of edge points in the 2016 article: steady orientation, company, and thinning."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float

from classical.baselines.aleman_flores.edges import EdgePoints

RADIUS = 2
LEAST_NEIGHBOURS = 2
LEAST_COSINE = 0.95
PASSES = 4
CELL = 3
"""Neighbourhood, neighbours and mean cosine required, passes against isolated points, and the side
of a cell that keeps one point: the values of the article, in pixels where lengths."""


def clean_edges(edges: EdgePoints, width: int, height: int) -> EdgePoints:
    """Keep edge points of steady orientation, one for each 3x3 cell.

    First a point needs two neighbours in its 5x5 square whose directions agree with its own (mean
    cosine of the difference at least 0.95); then, four times, points without any neighbour left
    are dropped; last, each 3x3 cell keeps the point of steadiest orientation.
    """
    neighbours, cosine = _company(edges, width, height)
    edges = edges.subset((neighbours >= LEAST_NEIGHBOURS) & (cosine >= LEAST_COSINE))
    for _ in range(PASSES):
        neighbours = _neighbours(edges.points, width, height)
        if (neighbours > 0).all():
            break
        edges = edges.subset(neighbours > 0)
    _, cosine = _company(edges, width, height)
    return edges.subset(_steadiest(edges.points, cosine, width))


def _neighbours(points: np.ndarray, width: int, height: int) -> np.ndarray:
    """Number of neighbours in the square about each point."""
    columns, rows = points.T.astype(np.intp)
    layer = np.zeros((height, width), np.uint8)
    layer[rows, columns] = 1
    return _square_sums(layer)[rows, columns].astype(np.intp) - 1


def _company(
    edges: EdgePoints, width: int, height: int
) -> tuple[np.ndarray, Float[np.ndarray, " n"]]:
    """Number of neighbours in the square about each point, and their mean cosine with it."""
    columns, rows = edges.points.T.astype(np.intp)
    neighbours = _neighbours(edges.points, width, height)
    cosine = np.full(len(edges), -1.0)
    for part in edges.normals.T:
        layer = np.zeros((height, width), np.float32)
        layer[rows, columns] = part
        cosine += _square_sums(layer)[rows, columns] * part
    return neighbours, cosine / np.maximum(neighbours, 1.0)


def _square_sums(layer: np.ndarray) -> np.ndarray:
    side = 2 * RADIUS + 1
    return np.asarray(
        cv2.boxFilter(layer, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
    )


def _steadiest(points: np.ndarray, cosine: np.ndarray, width: int) -> np.ndarray:
    """Indices of the point of largest cosine in each cell, in the order of the points."""
    columns, rows = points.T.astype(np.intp) // CELL
    cell = rows * (width // CELL + 1) + columns
    order = np.lexsort((-cosine, cell))
    first = np.ones(len(order), bool)
    first[1:] = np.diff(cell[order]) != 0
    return np.sort(order[first])

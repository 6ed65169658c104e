"""The outermost pixels that a picture shows: its corners, or the edge of what a surround leaves.

A lens that took the picture sees all of them, whether or not a line runs there.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from classical.lines.rejection import find_surround

_SIZE = 400  # longest side of the picture in which the surround is sought, pixels
_LEAST_SHARE = 0.1  # of the picture that is shown; less is a dark picture, not a surround


def find_rim(image: UInt8[np.ndarray, "h w *c"]) -> Float[np.ndarray, "n 2"]:
    """Corners of the convex hull of what a picture shows.

    Args:
        image: Grey (h, w) or RGB (h, w, 3), 8 bits.

    Returns:
        Pixels of `image`, shape (n, 2): the picture's four corners where it has no dark surround.
    """
    height, width = image.shape[:2]
    corners = np.array([[u, v] for u in (0.0, width - 1.0) for v in (0.0, height - 1.0)])
    scale = min(1.0, _SIZE / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    grey = small if small.ndim == 2 else cv2.cvtColor(small, cv2.COLOR_RGB2GRAY)
    surround = find_surround(grey.astype(np.float32))
    if not np.isfinite(surround.inside).all():
        return corners
    shown = _largest_piece(surround.inside > 0)
    if shown.mean() < _LEAST_SHARE:
        return corners
    hull = cv2.convexHull(np.argwhere(shown)[:, ::-1].astype(np.int32)).reshape(-1, 2)
    return (hull + 0.5) * [width / size[0], height / size[1]] - 0.5


def _largest_piece(shown: np.ndarray) -> np.ndarray:
    """The largest connected piece: a date in a black corner is no part of the scene."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(shown.astype(np.uint8), connectivity=4)
    return labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])) if len(stats) > 1 else shown

"""The page that a photograph was put on: bars beside it, or paper around its image circle.

Lenses leave black around their image circle, and all that looks at pictures knows it: the search
for the circle, for the rim and for curves, and networks that learned from such pictures. An edge of
a grey or white page is a straight line, too, and speaks for a lens that bends nothing.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import UInt8

_DARK = 48  # brightest level of a page that is left as it is
_EVEN = 8  # levels between the brightest and the darkest pixel of all four corners
_PATCH = 0.012  # side of what is looked at in a corner, shares of the shorter side …
_MARGIN = 0.0025  # … and of what is taken off the photograph where it is mixed with the page
_LEAST_AREA = 0.01  # of the picture; less does no harm


def on_black(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """The picture with its page made black; itself where it fills its frame or lies on black.

    A page is what is joined to corners that are all even and of one colour, as no scene's are.

    Args:
        image: RGB.
    """
    height, width = image.shape[:2]
    side = max(3, round(_PATCH * min(height, width)))
    ends = (slice(0, side), slice(-side, None))
    corners = np.concatenate([image[v, u].reshape(-1, 3) for v in ends for u in ends])
    if np.ptp(corners, axis=0).max() > _EVEN or corners.max() <= _DARK:
        return image
    colour = np.median(corners, axis=0)
    off = np.abs(image.astype(np.int16) - colour.astype(np.int16)).max(axis=2)
    _, labels = cv2.connectedComponents(np.asarray(off <= _EVEN, np.uint8), connectivity=4)
    at_corners = np.unique(labels[[0, 0, -1, -1], [0, -1, 0, -1]])
    page = np.isin(labels, at_corners[at_corners > 0])
    if page.mean() < _LEAST_AREA:
        return image
    margin = 2 * max(1, round(_MARGIN * min(height, width))) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (margin, margin))
    out = image.copy()
    out[cv2.dilate(page.astype(np.uint8), kernel) > 0] = 0
    return out

"""Lenses that bend next to nothing: what most photographs were taken with.

A network that has seen fisheyes alone takes every picture for one. These stand beside the priors of
fisheyes in training: r = f tan θ, as near as five coefficients come, with the slight rest of
distortion that cameras leave where they straighten their pictures themselves.
"""

import numpy as np

from learned.slf.lens_shape import KNOTS, coefficients
from learned.slf.lenses import LensBatch, frame_theta_max

_FIELD = (np.radians(22.0), np.radians(56.0))  # half the horizontal field of view
_HALF_HEIGHTS = (1.0, 3 / 4, 2 / 3, 9 / 16)  # square, 4:3, 3:2, 16:9
_REST = 0.01  # deviation of the relative radius at the corner
_CENTRE = 0.01  # of the principal point, half widths


def perspective_lenses(rng: np.random.Generator, n: int) -> LensBatch:
    """Draw `n` lenses that take straight pictures, in frames of common shapes.

    Args:
        rng: Where they are drawn from.
        n: How many.
    """
    half_height = rng.choice(_HALF_HEIGHTS, n)
    focal = 1 / np.tan(rng.uniform(*_FIELD, n))
    corner = np.hypot(1.0, half_height)
    theta = np.arctan(corner / focal)
    rest = rng.normal(0.0, _REST, (n, 1)) * KNOTS**2
    logs = np.log(np.tan(theta[:, None] * KNOTS) / (theta[:, None] * KNOTS)) + rest
    k = coefficients(np.column_stack([theta, logs]), corner)
    centre = rng.normal(0.0, _CENTRE, (n, 2))
    vector = np.column_stack([k, np.ones((n, 2)), centre])
    circle = np.full(n, np.inf)
    return LensBatch(vector, frame_theta_max(vector, circle, half_height), circle, half_height)

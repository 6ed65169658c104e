"""A batch of lenses as the priors draw them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from learned.slf.lens_shape import first_angle, monotone_limit


@dataclass(frozen=True)
class LensBatch:
    """Lenses in front of square frames; lengths in half image widths.

    Attributes:
        vector: (k1..k5, m_u, m_v, u0, v0) as in `SlfBatch.k`; m_u is 1.
        theta_max: Largest incident angle seen, in radians: the edge of the image circle, the
            farthest corner of the frame or the end of the rising branch, whichever comes first.
        circle: Radius of the image circle in the isotropic plane of r(θ); infinite where the lens
            fills its frame.
        half_height: Half height of the visible rectangle; below 1 for a wide picture put into a
            square frame with bars above and below.
    """

    vector: Float[ndarray, "n 9"]
    theta_max: Float[ndarray, " n"]
    circle: Float[ndarray, " n"]
    half_height: Float[ndarray, " n"]

    def __len__(self) -> int:
        """Number of lenses."""
        return len(self.vector)

    def __getitem__(self, rows: slice | ndarray) -> "LensBatch":
        """Some of the lenses."""
        return LensBatch(**{name: value[rows] for name, value in vars(self).items()})


def concatenated(batches: list[LensBatch]) -> LensBatch:
    """Several batches as one."""
    names = LensBatch.__dataclass_fields__
    return LensBatch(**{n: np.concatenate([getattr(b, n) for b in batches]) for n in names})


def frame_theta_max(
    vector: Float[ndarray, "n 9"], circle: Float[ndarray, " n"], half_height: Float[ndarray, " n"]
) -> Float[ndarray, " n"]:
    """Largest incident angle that reaches the visible frame, in radians.

    Args:
        vector: Lenses in half widths.
        circle: Radius of the image circle.
        half_height: Half height of the visible rectangle.

    Returns:
        The angle of the farthest visible point, at most the end of the rising branch.
    """
    reach_u = (1.0 + np.abs(vector[:, 7])) / vector[:, 5]
    reach_v = (half_height + np.abs(vector[:, 8])) / vector[:, 6]
    farthest = np.minimum(np.hypot(reach_u, reach_v), circle)
    angle = first_angle(vector[:, :5], farthest)
    limit = monotone_limit(vector[:, :5])
    return np.where(np.isfinite(angle), np.minimum(angle, limit), limit)

"""The covariance of a fit at the size that comes true.

The fit guards itself: against curves that err together, against networks and against odd lenses.
So the shape of the lens errs by less than its covariance says, while the scale of the rectified
plane, which no line tells, errs as it says.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from classical.camera import KannalaBrandt
from classical.fit.scale import scale_row, scale_tangent

_CAUTION = 2.5  # expected errors of the shape over those that come true


def calibrated(
    camera: KannalaBrandt, covariance: Float[np.ndarray, "9 9"]
) -> Float[np.ndarray, "9 9"]:
    """The covariance with its scale as it is and all else at the size that comes true.

    Args:
        camera: The fit.
        covariance: Of its vector.
    """
    scale = np.outer(scale_tangent(camera), scale_row(camera))
    shrink = scale + (np.eye(9) - scale) / _CAUTION
    return shrink @ covariance @ shrink.T

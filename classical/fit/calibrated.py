"""The covariance of a fit at the size that comes true.

The fit guards itself: against curves that err together, against networks and against odd lenses.
So the shape of the lens errs by less than its covariance says, while the scale of the rectified
plane, which no line tells, errs as it says. And two estimates that lie farther apart than both
expect, the curves' and a network's, are not both as good as they say.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from classical.camera import KannalaBrandt
from classical.fit.prior import LensPrior
from classical.fit.quality import disagreement, predicted_error
from classical.fit.scale import scale_tangent, scale_variance

_CAUTION = 2.8  # expected errors of the shape over those that come true
_STRANGERS = 3.0  # deviations between lenses that have no part of the picture in common


def calibrated(
    camera: KannalaBrandt, covariance: Float[np.ndarray, "9 9"], second: LensPrior | None
) -> Float[np.ndarray, "9 9"]:
    """The covariance with its scale as it is and all else at the size that comes true.

    Args:
        camera: The fit.
        covariance: Of its vector.
        second: Another estimate of the lens, if there is one.
    """
    tangent = scale_tangent(camera)
    scale = np.outer(tangent, tangent) * scale_variance(tangent, covariance)
    surprise = 1.0 if second is None else _surprise(camera, covariance, second)
    return scale + (covariance - scale) * surprise / _CAUTION**2


def _surprise(
    camera: KannalaBrandt, covariance: Float[np.ndarray, "9 9"], second: LensPrior
) -> float:
    """Factor of the variance: 1 where two estimates lie as far apart as both expect."""
    other = second.decode(np.zeros(8), camera.width, camera.height)
    apart = disagreement(camera, other)
    expected = np.hypot(
        predicted_error(camera, covariance), predicted_error(other, second.covariance)
    )
    ratio = apart / expected if np.isfinite(apart) else _STRANGERS
    return float(1 + ratio**2) / 2

"""Laws of the covariance that is reported: its scale as the fit found it, its shape as it comes
true."""

import numpy as np
import pytest

from classical.camera import KannalaBrandt
from classical.fit import generic_prior, predicted_error
from classical.fit.calibrated import calibrated
from classical.fit.quality import LARGEST_ERROR, TAIL, judge
from classical.fit.result import FittedCurve
from classical.fit.scale import scale_variance

LENS = KannalaBrandt.centred(np.array([0.8, -0.03, 0.01, 0.0, 0.0]), 640, 480)
FIT = generic_prior(0.8, 640, 480).covariance * 0.1**2


def test_the_scale_stays_and_the_shape_shrinks() -> None:
    after = calibrated(LENS, FIT)
    assert scale_variance(LENS, after) == pytest.approx(scale_variance(LENS, FIT), rel=0.01)
    # central differences along the scale leave a little of it
    ratio = predicted_error(LENS, FIT) / predicted_error(LENS, after)
    assert ratio == pytest.approx(2.5, rel=0.01)
    free = [0, 1, 2, 3, 4, 6, 7, 8]
    assert np.linalg.eigvalsh(after[np.ix_(free, free)]).min() > 0


def test_ok_means_that_an_error_in_the_tail_is_still_small() -> None:
    ends = np.linspace([0.0, 0.0], [600.0, 10.0], 40)
    curves = [[FittedCurve(ends, np.zeros(40), 0.0, True)] * 6]
    most = LARGEST_ERROR / TAIL
    assert judge(curves, LENS, 0.99 * most)[0] == "ok"
    assert judge(curves, LENS, 1.01 * most)[0] == "degraded"

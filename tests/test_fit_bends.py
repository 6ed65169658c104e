"""Bends as residuals, and what is known beside the curves."""

import numpy as np
import pytest

from classical.camera import KannalaBrandt
from classical.fit import LensPrior, generic_prior
from classical.fit.bends import BendConfig, Bends
from classical.fit.observations import (
    observed,
    of_belief,
    of_belief_field,
    of_circles,
    of_field,
    of_focal,
)
from classical.fit.rounds import Known
from classical.fit.samples import sample_curves
from classical.lines import Curve, ImageCircle


def straight_curves(rng, count=5):
    out = []
    for _ in range(count):
        a, b = rng.uniform(0, 1280, (2, 2))
        t = np.linspace(0, 1, 80)[:, None]
        out.append(Curve(a + t * (b - a), 0.2, 1.0))
    return out


def test_amplitudes_are_those_of_the_polynomials() -> None:
    """The zeroth and first order are the line itself; later ones come back as they went in."""
    rng = np.random.default_rng(0)
    samples = sample_curves(straight_curves(rng), spacing=14.0)
    config = BendConfig()
    bends = Bends.of(samples, 1280, config)
    wanted = rng.normal(size=(samples.n_curves, config.orders))
    residuals = np.empty(len(samples.points))
    for i, (start, count) in enumerate(zip(samples.starts, samples.counts, strict=True)):
        piece = slice(start, start + count)
        path = np.hypot(*(samples.points[piece] - samples.points[start]).T)
        x = 2 * path / path[-1] - 1
        residuals[piece] = np.polynomial.legendre.legval(x, [7.0, -3.0, *wanted[i]])
    ones = np.ones(samples.n_curves)
    found = (bends.operator(1.0, ones) @ residuals).reshape(wanted.shape) * bends.shapes
    np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_longer_lines_may_look_more_bent() -> None:
    rng = np.random.default_rng(1)
    curves = sorted(straight_curves(rng), key=lambda curve: curve.length)
    bends = Bends.of(sample_curves(curves, spacing=14.0), 1280, BendConfig())
    assert (np.diff(bends.shapes[:, 0]) > 0).all()
    assert (np.diff(bends.shapes, axis=1) < 0).all()


def test_an_observation_of_the_whole_lens_is_a_product_of_gaussians() -> None:
    prior = generic_prior(0.8, 640, 480)
    other = generic_prior(0.9, 640, 480)
    both = observed(prior, of_belief(other, "network"))
    free = np.ix_([0, 1, 2, 3, 4, 6, 7, 8], [0, 1, 2, 3, 4, 6, 7, 8])
    precision = np.linalg.inv(prior.covariance[free]) + np.linalg.inv(other.covariance[free])
    np.testing.assert_allclose(
        np.linalg.inv(both.covariance[free]), precision, rtol=1e-4, atol=1e-8
    )
    assert 0.8 < both.mean[0] < 0.9


def test_a_belief_far_from_the_curves_loses_weight() -> None:
    belief = of_belief(generic_prior(0.8, 640, 480), "network")
    near = KannalaBrandt.centred(np.array([0.8, 0.016, -0.004, 0.0, 0.0]), 640, 480)
    far = KannalaBrandt.centred(np.array([0.8, 0.9, -0.5, 0.0, 0.0]), 640, 480)
    assert np.trace(belief.near(near).covariance) == pytest.approx(np.trace(belief.covariance))
    assert np.trace(belief.near(far).covariance) > 5 * np.trace(belief.covariance)


def test_what_the_user_knows_is_held_to() -> None:
    prior = generic_prior(0.8, 640, 480)
    assert observed(prior, of_focal(300.0, 640)).mean[0] == pytest.approx(300 / 320, rel=0.01)
    lens = observed(prior, of_field(np.pi, 320.0, 640, "given")).decode(np.zeros(8), 640, 480)
    radius = lens.radius(np.array([np.pi / 2]))[0] * lens.m_u
    assert radius == pytest.approx(320.0, rel=0.01)


def test_a_prior_keeps_its_gauge() -> None:
    prior = observed(generic_prior(0.8, 640, 480), of_focal(300.0, 640))
    assert isinstance(prior, LensPrior)
    assert prior.mean[5] == 320.0
    assert np.count_nonzero(prior.covariance[5]) == 1


def test_an_image_circle_places_the_principal_point() -> None:
    spread = np.diag([2.0, 2.0, 0.005]) ** 2
    circle = ImageCircle(np.array([338.0, 228.0]), 300.0, 1.0, spread, 6.0)
    seen = of_circles([circle], 640)
    assert seen is not None
    lens = KannalaBrandt.centred(np.array([0.8, 0.0, 0.0, 0.0, 0.0]), 640, 480)
    before, after = Known().belief(lens), Known([seen]).belief(lens)
    np.testing.assert_allclose(after.mean[7:], circle.centre, atol=1.0)
    assert (np.sqrt(np.diag(after.covariance)[7:]) < 2.01).all()
    assert (np.sqrt(np.diag(before.covariance)[7:]) > 10).all()


def test_a_belief_of_the_field_says_nothing_of_the_shape() -> None:
    belief = of_belief_field(generic_prior(0.8, 640, 480), "network")
    assert belief.matrix.shape == (1, 9)
    near = KannalaBrandt.centred(np.array([0.8, 0.016, -0.004, 0.0, 0.0]), 640, 480)
    wide = KannalaBrandt.centred(np.array([0.4, 0.008, -0.002, 0.0, 0.0]), 640, 480)
    assert belief.surprise(near) < 0.01
    assert belief.surprise(wide) > belief.surprise(near)

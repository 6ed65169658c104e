import click
import numpy as np
import pytest
import torch

from learned.polynomial import monotone_limit, radius, theta_from_radius
from learned.slf import lens_shape
from learned.slf.commands import show_prior
from learned.slf.priors import lens_prior

LENSES = torch.tensor([[1.2, -0.1, 0.01, 0.0, 0.0], [0.6, 0.02, -0.01, 0, 0], [1.8, -0.4, 0, 0, 0]])


def test_theta_from_radius_inverts_radius():
    limit = 0.99 * monotone_limit(LENSES)
    theta = torch.linspace(0, 1, 301) * limit[:, None]
    found, valid = theta_from_radius(radius(theta, LENSES), LENSES, limit)
    assert valid[:, :-1].all()
    assert (found - theta).abs().max() < 2e-5


def test_radii_beyond_the_circle_are_invalid():
    limit = 0.8 * monotone_limit(LENSES)
    beyond = radius(limit[:, None], LENSES) * 1.01
    theta, valid = theta_from_radius(beyond, LENSES, limit)
    assert not valid.any()
    torch.testing.assert_close(theta[:, 0], limit)


def test_inverse_has_the_gradient_of_the_implicit_function():
    k = LENSES[:2].double().requires_grad_()
    limit = monotone_limit(LENSES[:2]).double()
    r = (0.5 * radius(limit[:, None], LENSES[:2].double())).detach().requires_grad_()
    assert torch.autograd.gradcheck(lambda r, k: theta_from_radius(r, k, limit)[0], (r, k))


def test_monotone_limit_is_where_the_slope_vanishes():
    # 1.8 − 3 · 0.4 θ² = 0
    assert float(monotone_limit(LENSES[2:])) == pytest.approx(np.sqrt(1.5), abs=1e-3)


@pytest.mark.parametrize("name", ["paper", "wild", "fisheye"])
def test_lenses_of_a_prior_rise_up_to_theta_max(name):
    lenses = lens_prior(name).sample(np.random.default_rng(3), 400)
    theta = lenses.theta_max[:, None] * np.linspace(0, 0.995, 200)
    assert lens_shape.slope(theta, lenses.vector[:, :5]).min() > 0


@pytest.mark.parametrize("name", ["paper", "wild", "fisheye"])
def test_prior_gives_the_same_lenses_for_the_same_generator(name):
    first, second = (lens_prior(name).sample(np.random.default_rng(5), 9) for _ in range(2))
    np.testing.assert_array_equal(first.vector, second.vector)


def test_wild_prior_reaches_past_180_degrees_and_paper_stays_narrow():
    wild, paper = (lens_prior(n).sample(np.random.default_rng(1), 400) for n in ("wild", "paper"))
    assert np.degrees(wild.theta_max).max() > 95
    edge = lens_shape.first_angle(paper.vector[:, :5], np.ones(400))
    assert np.degrees(edge).min() > 34.9
    assert np.degrees(edge).max() < 52.1


def test_fisheyes_are_wide_and_mostly_cut_above_and_below():
    lenses = lens_prior("fisheye").sample(np.random.default_rng(1), 400)
    assert np.quantile(np.degrees(lenses.theta_max), 0.05) > 70
    cut = (lenses.circle > lenses.half_height) & np.isfinite(lenses.circle)
    assert cut.mean() > 0.4


def test_fisheyes_are_nearly_equidistant():
    """r(θ) / (k1 θ) is 1 for them, at 1 rad 0.96 if equisolid and 1.09 if stereographic."""
    k = lens_prior("fisheye").sample(np.random.default_rng(2), 2000).vector[:, :5]
    ratio = k.sum(axis=1) / k[:, 0]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.02)
    assert 0.02 < ratio.std() < 0.08


@pytest.mark.parametrize("name", ["paper", "wild", "fisheye"])
def test_log_density_prefers_own_lenses(name):
    prior = lens_prior(name)
    own = prior.sample(np.random.default_rng(2), 64).vector
    strange = own.copy()
    strange[:, 1] += 0.5 * strange[:, 0]
    values = prior.log_density(own)
    assert np.isfinite(values).all()
    assert (values > prior.log_density(strange)).mean() > 0.95


def test_log_density_does_not_depend_on_the_gauge():
    prior = lens_prior("wild")
    own = prior.sample(np.random.default_rng(2), 8).vector
    scaled = own.copy()
    scaled[:, :5] /= 2
    scaled[:, 5:7] *= 2
    np.testing.assert_allclose(prior.log_density(own), prior.log_density(scaled), rtol=1e-9)


def test_unknown_prior_is_misuse():
    with pytest.raises(ValueError, match="paper"):
        lens_prior("tame")


def test_the_command_line_offers_every_prior():
    with pytest.raises(ValueError, match="lens prior") as refused:
        lens_prior("tame")
    offered = show_prior.params[0].type
    assert isinstance(offered, click.Choice)
    assert str(sorted(offered.choices)) in str(refused.value)


def test_shapes_inverts_coefficients():
    rng = np.random.default_rng(0)
    shape = np.column_stack([rng.uniform(0.8, 1.7, 20), rng.normal(0, 0.005, (20, 4))])
    rho = rng.uniform(0.8, 1.4, 20)
    found, _ = lens_shape.shapes(lens_shape.coefficients(shape, rho), rho)
    np.testing.assert_allclose(found, shape, atol=1e-6)


def test_log_volume_is_the_determinant_of_the_change_of_variables():
    shape = np.array([[1.2, 0.01, 0.03, 0.04, 0.05]])
    rho = np.array([1.1])
    k = lens_shape.coefficients(shape, rho)
    step = 1e-6
    columns = [
        (lens_shape.shapes(k + step * e, rho)[0] - lens_shape.shapes(k - step * e, rho)[0])[0]
        / (2 * step)
        for e in np.eye(5)
    ]
    expected = np.linalg.slogdet(np.array(columns).T)[1]
    assert lens_shape.shapes(k, rho)[1][0] == pytest.approx(expected, abs=1e-3)

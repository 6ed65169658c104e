"""What another estimate says of the shape of a lens, whatever its scale."""

import numpy as np
import pytest

from classical.camera import KannalaBrandt
from classical.fit import LensPrior, generic_prior, observed, of_belief, of_belief_shape
from classical.fit.quality import disagreement
from classical.fit.search import projection
from classical.fit.vanishing import rescaled

WIDTH, HEIGHT = 640, 480


@pytest.fixture
def lens() -> KannalaBrandt:
    """An equidistant lens, 143° across."""
    return projection(0.8, 0.0, WIDTH, HEIGHT)


@pytest.fixture
def belief(lens) -> LensPrior:
    """The lens, as a network might be sure of it."""
    general = generic_prior(float(lens.k[0]), WIDTH, HEIGHT)
    return LensPrior(lens.to_vector(), general.covariance * 0.05)


def test_a_lens_of_another_scale_is_no_surprise(lens, belief) -> None:
    shape = of_belief_shape(belief, "network", WIDTH, HEIGHT)
    assert shape.surprise(lens) < 1e-12
    for scale in (0.8, 1.25):
        other = rescaled(lens, scale)
        assert shape.surprise(other) < 0.02 * of_belief(belief, "network").surprise(other)


@pytest.mark.parametrize("b", [-0.6, 0.8])
def test_a_lens_of_another_shape_is_one(lens, belief, b: float) -> None:
    shape = of_belief_shape(belief, "network", WIDTH, HEIGHT)
    other = projection(0.8, b, WIDTH, HEIGHT)
    assert shape.surprise(other) > 5
    assert np.trace(shape.near(other).covariance) > np.trace(shape.near(lens).covariance)


@pytest.mark.parametrize("b", [-0.5, 0.0, 0.5])
def test_its_matrix_is_the_derivative_of_what_is_compared(belief, b: float) -> None:
    shape = of_belief_shape(belief, "network", WIDTH, HEIGHT)
    camera = projection(0.9, b, WIDTH, HEIGHT)

    def off(vector: np.ndarray) -> np.ndarray:
        near = shape.near(KannalaBrandt.from_vector(vector, WIDTH, HEIGHT))
        return near.matrix @ vector - near.value

    vector, matrix = camera.to_vector(), shape.near(camera).matrix
    for column, step in (
        (0, 1e-5),
        (1, 1e-5),
        (2, 1e-5),
        (3, 1e-5),
        (4, 1e-5),
        (6, 0.01),
        (8, 0.01),
    ):
        shift = step * np.eye(9)[column]
        slope = (off(vector + shift) - off(vector - shift)) / (2 * step)
        np.testing.assert_allclose(slope, matrix[:, column], rtol=1e-3, atol=1e-6)


def test_it_draws_a_lens_to_its_shape(lens, belief) -> None:
    general = generic_prior(1.3 * float(lens.k[0]), WIDTH, HEIGHT)
    start = camera = general.decode(np.zeros(8), WIDTH, HEIGHT)
    told = LensPrior(projection(0.8, 0.7, WIDTH, HEIGHT).to_vector(), belief.covariance * 0.01)
    shape = of_belief_shape(told, "network", WIDTH, HEIGHT)
    wanted = told.decode(np.zeros(8), WIDTH, HEIGHT)
    for _ in range(8):
        camera = observed(general, shape.near(camera)).decode(np.zeros(8), WIDTH, HEIGHT)
    assert disagreement(camera, wanted) < 0.3 * disagreement(start, wanted)


def test_a_lens_that_turns_within_the_picture_is_compared_where_it_is_steep() -> None:
    """Near its turn the angle says nothing of a shape, and a lens under trial may turn before."""
    turning = KannalaBrandt.centred(np.array([1.4377, -0.3907, -0.0037, -0.0109, 0.002]), 320, 320)
    sooner = KannalaBrandt.centred(np.array([1.3, -0.35, -0.01, -0.01, 0.0]), 320, 320)
    assert sooner.theta_max < np.radians(75)
    told = LensPrior(turning.to_vector(), generic_prior(1.44, 320, 320).covariance * 0.01)
    shape = of_belief_shape(told, "network", 320, 320)
    assert shape.radii.max() < turning.radius(np.array([turning.theta_max]))[0]
    assert np.abs(shape.near(sooner).matrix[:4]).max() < 10

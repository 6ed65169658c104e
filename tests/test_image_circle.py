"""The image circle: exact on drawn ones, unmoved by what hides it, silent without one."""

import cv2
import numpy as np
import pytest

from classical.fit.observations import of_circles
from classical.lines import ImageCircle, find_image_circle


def drawn(width, height, centre, radius, aspect=1.0, *, seed=0) -> np.ndarray:
    """A bright texture inside an ellipse with upright axes on black."""
    rng = np.random.default_rng(seed)
    texture = cv2.GaussianBlur(
        rng.uniform(60, 255, (height, width, 3)).astype(np.float32), (0, 0), 6
    )
    v, u = np.mgrid[:height, :width]
    rho = np.hypot(u - centre[0], (v - centre[1]) / aspect)
    inside = np.clip(radius - rho + 0.5, 0, 1)[..., None]
    return (texture * inside).astype(np.uint8)


@pytest.mark.parametrize("aspect", [1.0, 1.06])
@pytest.mark.parametrize("size", [(640, 480), (1280, 960)])
def test_a_drawn_circle_is_found(size, aspect):
    width, height = size
    centre, radius = (0.51 * width, 0.485 * height), 0.44 * width
    found = find_image_circle(drawn(width, height, centre, radius, aspect))
    assert found is not None
    tolerance = 0.002 * width
    np.testing.assert_allclose(found.centre, centre, atol=tolerance)
    assert found.radius == pytest.approx(radius, abs=tolerance)
    assert found.aspect == pytest.approx(aspect, abs=0.01)


def test_dark_things_at_the_border_do_not_move_it():
    image = drawn(800, 800, (410.0, 396.0), 350.0)
    image[600:, :] //= 12  # a dark floor
    image[300:420, :200] = 0
    found = find_image_circle(image)
    assert found is not None
    off = np.abs(found.centre - [410.0, 396.0])
    assert (off < 3 * np.sqrt(np.diag(found.covariance)[:2])).all()
    assert off.max() < 8


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((100, 100, 3), np.uint8),
        np.full((240, 320, 3), 128, np.uint8),
        np.random.default_rng(0).integers(0, 255, (240, 320, 3)).astype(np.uint8),
        np.zeros((2, 2), np.uint8),
    ],
)
def test_a_picture_without_a_circle_has_none(image):
    assert find_image_circle(image) is None


def test_a_dark_rectangle_around_is_no_circle():
    image = np.zeros((480, 640, 3), np.uint8)
    image[60:420, 80:560] = 180
    assert find_image_circle(image) is None


def circle(centre, aspect, *, sure=1.0):
    spread = np.diag([sure, sure, 0.005]) ** 2
    return ImageCircle(np.array(centre), 300.0, aspect, spread, 6.0)


def test_circles_of_many_pictures_count_by_their_certainty():
    together = of_circles(
        [circle([320.0, 240.0], 1.0), None, circle([330.0, 240.0], 1.0, sure=9.0)], 640
    )
    assert together is not None
    assert 320 < together.value[0] < 321
    assert together.value[2] == pytest.approx(320.0)
    assert of_circles([None, None], 640) is None

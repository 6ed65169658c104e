"""Photographs that were put on a page."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from classical.lines import find_image_circle
from hybrid import RectifyConfig, rectify
from hybrid.page import on_black

SIZE, RADIUS = 320, 120
EXAMPLE = Path(__file__).parents[1] / "examples" / "room.jpg"


@pytest.fixture
def scene() -> np.ndarray:
    """A picture full of edges, none of them at its corners."""
    rng = np.random.default_rng(2)
    coarse = rng.integers(0, 255, (20, 20, 3), dtype=np.uint8)
    return cv2.resize(coarse, (SIZE, SIZE), interpolation=cv2.INTER_LINEAR)


def in_circle(scene: np.ndarray, level: int) -> np.ndarray:
    v, u = np.mgrid[:SIZE, :SIZE] - (SIZE - 1) / 2
    out = scene.copy()
    out[np.hypot(u, v) > RADIUS] = level
    _, data = cv2.imencode(".jpg", out, [cv2.IMWRITE_JPEG_QUALITY, 90])
    seen = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert seen is not None
    return seen


@pytest.mark.parametrize("level", [100, 200, 255])
def test_an_image_circle_on_paper_is_found_as_on_black(scene, level: int) -> None:
    on_paper = in_circle(scene, level)
    circle = find_image_circle(on_black(on_paper))
    assert circle is not None
    assert circle.radius == pytest.approx(RADIUS, abs=3)
    np.testing.assert_allclose(circle.centre, (SIZE - 1) / 2, atol=2)


@pytest.mark.parametrize("level", [60, 128, 255])
def test_bars_become_black_and_the_photograph_stays(scene, level: int) -> None:
    page = np.full((SIZE + 100, SIZE, 3), level, np.uint8)
    page[50:-50] = scene
    out = on_black(page)
    assert not out[:50].any()
    assert not out[-50:].any()
    np.testing.assert_array_equal(out[53:-53], page[53:-53])
    assert (page[0] == level).all()  # its input stays as it was


def test_a_picture_that_fills_its_frame_or_lies_on_black_is_itself(scene) -> None:
    assert on_black(scene) is scene
    dark = in_circle(scene, 0)
    assert on_black(dark) is dark
    sky = scene.copy()
    sky[:80] = 255  # bright corners above, others below
    assert on_black(sky) is sky
    dot = scene.copy()
    dot[[0, 0, -1, -1], [0, -1, 0, -1]] = 255
    assert on_black(dot) is dot


def test_what_is_as_bright_as_the_page_but_not_joined_to_it_stays(scene) -> None:
    page = np.full((SIZE + 100, SIZE, 3), 255, np.uint8)
    page[50:-50] = scene
    page[150:200, 100:150] = 255
    out = on_black(page)
    assert (out[160:190, 110:140] == 255).all()


def test_the_lens_is_sought_without_the_page_and_the_result_shows_it() -> None:
    room = cv2.imread(str(EXAMPLE))
    assert room is not None
    small = cv2.resize(room, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    page = np.full((small.shape[0] + 160, small.shape[1], 3), 128, np.uint8)
    page[80:-80] = small
    config = RectifyConfig(method="classical", balance=1.0)
    seen, told = (rectify(picture, config) for picture in (page, on_black(page)))
    assert seen.camera is not None
    assert told.camera is not None
    np.testing.assert_array_equal(seen.camera.to_vector(), told.camera.to_vector())
    assert seen.image.mean() > told.image.mean() + 1

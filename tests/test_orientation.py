"""All eight turned and mirrored copies of a picture are seen as one."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from classical.camera import KannalaBrandt
from classical.fit import FittedCurve
from hybrid import RectifyConfig
from hybrid.methods import METHODS, make_estimator
from hybrid.orientation import Orientation, OrientedEstimator
from hybrid.result import Calibration, Quality

EIGHT = [(quarters, mirrored) for quarters in range(4) for mirrored in (False, True)]
SIZES = [(60, 40), (40, 60), (48, 48), (41, 41)]
SPREAD = np.random.default_rng(5).normal(0, 0.01, (9, 9))


def picture(width: int, height: int) -> np.ndarray:
    """Noise, brighter above, with a star that tells one copy from another."""
    rng = np.random.default_rng(3)
    rows = np.linspace(150, 60, height)[:, None, None]
    image = (rows + rng.uniform(0, 40, (height, width, 3))).astype(np.uint8)
    image[height // 4, width // 3] = 255
    return image


def turned(image: np.ndarray, quarters: int, mirrored: bool) -> np.ndarray:
    image = np.rot90(image, quarters)
    return np.ascontiguousarray(image[:, ::-1] if mirrored else image)


def camera_of(found: Calibration) -> KannalaBrandt:
    assert found.camera is not None
    return found.camera


def looks(pictures):
    """Takes the star for the principal point; all else depends on how it sees the picture."""
    image = pictures[0]
    height, width = image.shape[:2]
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    v, u = np.unravel_index(int(grey.argmax()), grey.shape)
    k = np.array([0.6 + 0.1 * grey[0, 0] / 255, 0.01, 0, 0, 0])
    camera = KannalaBrandt(k, width / 2, 0.51 * width, float(u), float(v), width, height)
    curve = FittedCurve(np.array([[u, v], [0.0, 0.0]]), np.zeros(2), 0.0, True)
    spread = SPREAD * (np.arange(9) != 5)[:, None]
    quality = Quality(covariance=spread @ spread.T)
    return Calibration(camera, ((curve,),), quality, "ok", "", (grey / 255.0,))


def pixel_covariance(camera: KannalaBrandt, covariance: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """How far the pixel of a ray errs, by differences."""

    def pixel(vector):
        lens = KannalaBrandt.from_vector(vector, camera.width, camera.height)
        return lens.project(ray[None])[0][0]

    vector, steps = camera.to_vector(), 1e-5 * np.array([1.0] * 5 + [100.0] * 4)
    columns = [
        (pixel(vector + step) - pixel(vector - step)) / (2 * step.sum()) for step in np.diag(steps)
    ]
    jacobian = np.stack(columns, axis=1)
    return jacobian @ covariance @ jacobian.T


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(("quarters", "mirrored"), EIGHT)
def test_every_copy_is_seen_alike(size, quarters, mirrored):
    image = picture(*size)
    copy = turned(image, quarters, mirrored)
    seen = Orientation.of([image]).seen(image)
    np.testing.assert_array_equal(Orientation.of([copy]).seen(copy), seen)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(("quarters", "mirrored"), EIGHT)
def test_what_is_found_comes_back_to_the_picture(size, quarters, mirrored):
    copy = turned(picture(*size), quarters, mirrored)
    height, width = copy.shape[:2]
    grey = cv2.cvtColor(copy, cv2.COLOR_RGB2GRAY)
    v, u = np.unravel_index(int(grey.argmax()), grey.shape)
    found = OrientedEstimator(looks)([copy])
    camera = camera_of(found)
    assert (camera.width, camera.height) == (width, height)
    assert camera.m_u == width / 2  # the gauge
    assert (camera.u0, camera.v0) == pytest.approx((u, v))
    np.testing.assert_allclose(found.curves[0][0].points[0], [u, v])
    np.testing.assert_array_equal(found.heatmaps[0], grey / 255.0)


@pytest.mark.parametrize(("quarters", "mirrored"), EIGHT)
def test_a_copy_has_the_same_lens_and_the_same_doubt(quarters, mirrored):
    """A ray turned with the picture falls on the same spot of it, and errs as far."""
    image = picture(60, 40)
    found = OrientedEstimator(looks)([image])
    other = OrientedEstimator(looks)([turned(image, quarters, mirrored)])
    ray = np.array([0.3, -0.2, 0.8])
    x, y = ray[:2]
    for _ in range(quarters):  # anticlockwise, with y down
        x, y = y, -x
    moved = np.array([-x if mirrored else x, y, ray[2]])
    lens, other_lens = camera_of(found), camera_of(other)
    off = lens.project(ray[None])[0][0] - [lens.u0, lens.v0]
    other_off = other_lens.project(moved[None])[0][0] - [other_lens.u0, other_lens.v0]
    assert np.hypot(*other_off) == pytest.approx(np.hypot(*off), abs=1e-9)
    spread = pixel_covariance(lens, found.quality.covariance, ray)
    other_spread = pixel_covariance(other_lens, other.quality.covariance, moved)
    np.testing.assert_allclose(
        np.linalg.eigvalsh(other_spread), np.linalg.eigvalsh(spread), rtol=1e-5
    )


def test_pictures_of_one_lens_are_turned_together():
    dark, bright = picture(60, 40) // 4, picture(60, 40)
    together = [dark, bright[::-1].copy()]
    orientation = Orientation.of(together)
    assert orientation == Orientation(False, (orientation.is_flipped[0], True))


def test_the_width_stays_where_something_is_said_of_it():
    upright = picture(40, 60)
    assert Orientation.of([upright]).is_transposed
    assert not Orientation.of([upright], keeps_width=True).is_transposed
    camera = camera_of(OrientedEstimator(looks, keeps_width=True)([upright]))
    assert (camera.width, camera.height) == (40, 60)


def test_a_failure_stays_one():
    def fails(pictures):
        return replace(looks(pictures), camera=None, curves=((),), status="failed")

    found = OrientedEstimator(fails)([picture(40, 60)])
    assert found.camera is None
    assert found.status == "failed"


def test_methods_with_the_fit_are_oriented_and_published_ones_are_not():
    oriented = [row.name for row in METHODS if row.is_oriented]
    assert oriented == ["hybrid", "classical"]
    for row in METHODS:
        estimator = make_estimator(RectifyConfig(method=row.name))
        assert isinstance(estimator, OrientedEstimator) == row.is_oriented

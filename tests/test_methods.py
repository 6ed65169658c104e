"""Every method of the table behind `rectify`, on one picture of known distortion."""

import cv2
import numpy as np
import pytest

from classical.camera import Division, KannalaBrandt, nearest_kannala_brandt, pixel_grid
from classical.fit import LensPrior, fused
from hybrid import RectifyConfig, rectify
from hybrid.methods import method_names

WIDTH, HEIGHT = 480, 360
TRUTH = Division(-2.2e-6, 239.5, 179.5, WIDTH, HEIGHT)


@pytest.fixture(scope="module")
def bent_grid() -> np.ndarray:
    """A drawn grid of uneven bars, bent by a known division model."""
    rng = np.random.default_rng(0)
    plane = np.full((1600, 2000), 200, np.uint8)
    for axis in range(2):
        for position in np.arange(40, plane.shape[axis], 170):
            at = int(position + rng.integers(-30, 30))
            index = (slice(at, at + 45), slice(None))
            plane[index if axis == 0 else index[::-1]] = rng.integers(20, 110)
    plane = cv2.GaussianBlur(plane, (0, 0), 1.5)
    flat, _ = TRUTH.undistort(pixel_grid(WIDTH, HEIGHT))
    at = (flat - [TRUTH.u0, TRUTH.v0]) * 2.2 + [1000, 800]
    u, v = at.astype(np.float32).reshape(HEIGHT, WIDTH, 2).transpose(2, 0, 1)
    bent = cv2.remap(plane, u, v, cv2.INTER_LINEAR)
    noisy = bent + rng.normal(0, 2, bent.shape)
    return np.repeat(np.clip(noisy, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def bend_left(camera: KannalaBrandt) -> float:
    """Error of undistorted positions after the best scale, pixels, along the diagonal."""
    u = np.linspace(240, 479, 60)
    points = np.stack([u, 180 + (u - 240) * 0.74], axis=1)
    true, _ = TRUTH.undistort(points)
    rays, _ = camera.unproject(points)
    mine = rays[:, :2] / rays[:, 2:]
    a, b = (np.hypot(*(p - c).T) for p, c in ((mine, 0.0), (true, [TRUTH.u0, TRUTH.v0])))
    return float(np.abs(a * (a @ b) / (a @ a) - b).max())


# Bukhari's free centre runs away on a regular grid; its own tests cover it on known arcs.
@pytest.mark.parametrize("method", ["classical", "aleman-flores"])
def test_methods_find_a_known_lens(method: str, bent_grid: np.ndarray) -> None:
    result = rectify(bent_grid, RectifyConfig(method=method))
    assert result.camera is not None
    assert bend_left(result.camera) < 3.0  # left alone: 33 px
    assert result.curves
    assert result.image.shape == bent_grid.shape


def test_the_2016_variant_is_another_estimate(bent_grid: np.ndarray) -> None:
    config = RectifyConfig(method="aleman-flores", variant="2016")
    result = rectify(bent_grid, config)
    assert result.camera is not None
    assert bend_left(result.camera) < 3.0


@pytest.mark.parametrize("method", ["classical", "aleman-flores", "bukhari"])
def test_methods_say_when_they_cannot_tell(method: str) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (160, 200, 3), dtype=np.uint8)
    result = rectify(noise, RectifyConfig(method=method), throw=False)
    assert result.status != "ok"


def test_all_methods_are_named() -> None:
    assert {"classical", "aleman-flores", "bukhari", "identity"} <= set(method_names())


@pytest.mark.parametrize("lambda_", [-6e-6, -2e-6, -1e-7, 5e-7])
def test_division_lens_becomes_kannala_brandt(lambda_: float) -> None:
    division = Division(lambda_, 235.0, 183.0, WIDTH, HEIGHT)
    lens = nearest_kannala_brandt(division)
    points = pixel_grid(WIDTH, HEIGHT)[::503]
    rays, _ = division.unproject(points)
    again, valid = lens.project(rays)
    assert valid.all()
    np.testing.assert_allclose(again, points, atol=0.1)


def test_beliefs_are_weighed_by_how_sure_they_are() -> None:
    mean = np.array([0.8, 0.0, 0.0, 0.0, 0.0, 240.0, 240.0, 239.5, 179.5])
    other = mean + np.array([0.1, 0, 0, 0, 0, 0, 0, 0, 0])
    sure, unsure = np.eye(9) * 0.01**2, np.eye(9) * 0.03**2
    both = fused([LensPrior(mean, sure), LensPrior(other, unsure)])
    assert both.mean[0] == pytest.approx(0.8 + 0.1 * 0.1)
    assert both.covariance[0, 0] == pytest.approx(0.01**2 * 0.9)

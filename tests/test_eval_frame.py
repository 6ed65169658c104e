"""Pictures in the frame of the comparison, and PSNR and SSIM on them."""

import numpy as np
import pytest

from classical.camera import KannalaBrandt, Pinhole
from eval.frame import (
    Similarity,
    best_similarity,
    frame_size,
    rectify_labels,
    rectify_picture,
    source_maps,
    to_frame_size,
)
from eval.images import PSNR_CAP, psnr, ssim
from eval.metrics import compared_pixels, rectified


def noise(seed: int = 0, size: int = 320) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (size, size, 3), dtype=np.uint8)


def test_left_alone_is_the_photograph_itself():
    assert np.array_equal(rectify_picture(noise(), None), noise())


def test_the_frames_own_camera_changes_nothing():
    assert np.array_equal(rectify_picture(noise(), Pinhole.centred(160.0, 320, 320)), noise())


def test_a_similarity_shifts_the_picture():
    moved = rectify_picture(noise(), None, similarity=Similarity(shift=np.array([10.0, -3.0])))
    assert np.array_equal(moved[:-3, 10:], noise()[3:, :-10])
    assert not moved[-3:].any()


def test_the_aligned_picture_of_a_wrong_focal_length_is_the_true_picture():
    truth, estimate = Pinhole.centred(160.0, 320, 320), Pinhole.centred(200.0, 320, 320)
    points = compared_pixels(truth, 320, 320)
    places = [rectified(lens, points, 320, 320) for lens in (estimate, truth)]
    similarity = best_similarity(*places)
    for found, expected in zip(
        source_maps(estimate, 320, 320, similarity=similarity),
        source_maps(truth, 320, 320),
        strict=True,
    ):
        inside = (expected > 1) & (expected < 318)
        assert found[inside] == pytest.approx(expected[inside], abs=1e-3)


def test_pixels_without_a_source_are_black():
    lens = KannalaBrandt.centred(np.array([1.8, 0, 0, 0, 0]), 320, 320)
    white = np.full((320, 320), 255, np.uint8)
    out = rectify_labels(white, lens)
    assert out[160, 160] == 255
    assert out[0, 0] == 0  # r(54.7°) = 1.72 half-widths in the corner, past the edge


def test_labels_are_not_mixed():
    labels = np.zeros((320, 320), np.uint8)
    labels[::7] = 200
    lens = KannalaBrandt.centred(np.array([1.2, 0, 0, 0, 0]), 320, 320)
    assert set(np.unique(rectify_labels(labels, lens))) <= {0, 200}


@pytest.mark.parametrize(
    ("size", "frame"), [((320, 320), (320, 320)), ((1280, 960), (320, 240)), ((101, 7), (320, 22))]
)
def test_the_frame_is_320_wide_and_of_the_same_shape(size, frame):
    assert frame_size(*size) == frame


def test_shrinking_averages_areas():
    checker = np.indices((640, 640)).sum(axis=0) % 2 * 200
    small = to_frame_size(np.repeat(checker[..., None], 3, 2).astype(np.uint8))
    assert small.shape == (320, 320, 3)
    assert set(np.unique(small)) == {100}


def test_psnr_by_hand():
    black, grey = np.zeros((8, 8, 3), np.uint8), np.full((8, 8, 3), 51, np.uint8)
    assert psnr(black, grey) == pytest.approx(20 * np.log10(5))  # 255 / 51 = 5
    assert psnr(grey, grey) == PSNR_CAP


def test_psnr_counts_black_and_every_channel():
    truth = np.zeros((10, 10, 3), np.uint8)
    picture = truth.copy()
    picture[:, :, 0] = 255  # a third of all values is off by the whole range
    assert psnr(picture, truth) == pytest.approx(10 * np.log10(3))


def test_ssim_of_two_flat_pictures_by_hand():
    # Without variance: (2ab + C1) / (a² + b² + C1), C1 = (0.01 · 255)²
    a, b, c1 = 100.0, 150.0, 2.55**2
    flat = [np.full((20, 20, 3), int(value), np.uint8) for value in (a, b)]
    assert ssim(*flat) == pytest.approx((2 * a * b + c1) / (a * a + b * b + c1), rel=1e-6)


def test_ssim_of_a_window_by_hand():
    # One 7x7 window. Sample variances as scikit-image has them (n − 1).
    rng = np.random.default_rng(5)
    x, y = rng.integers(0, 256, (2, 7, 7)).astype(np.uint8)
    pictures = [np.repeat(value[..., None], 3, axis=2) for value in (x, y)]
    xf, yf = x.ravel().astype(float), y.ravel().astype(float)
    c1, c2 = 2.55**2, 7.65**2
    covariance = np.cov(xf, yf)
    expected = ((2 * xf.mean() * yf.mean() + c1) * (2 * covariance[0, 1] + c2)) / (
        (xf.mean() ** 2 + yf.mean() ** 2 + c1) * (covariance[0, 0] + covariance[1, 1] + c2)
    )
    assert ssim(*pictures) == pytest.approx(expected, rel=1e-6)

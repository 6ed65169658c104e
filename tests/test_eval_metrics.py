"""Each geometric metric against values worked out by hand."""

import numpy as np
import pytest

from classical.camera import Division, KannalaBrandt, Pinhole
from eval.metrics import (
    FRAME_FOCAL,
    THETA_CAP,
    align,
    aligned_error,
    angular_error,
    central_focal,
    compared_pixels,
    focal_error,
    pixel_grid,
    rectified,
    rpe,
)

SIZE = {"width": 320, "height": 320}
EQUIDISTANT = KannalaBrandt.centred(np.array([1.0, 0, 0, 0, 0]), 320, 320)  # 160 px a radian


def shifted(camera: KannalaBrandt, by: float) -> KannalaBrandt:
    vector = camera.to_vector()
    vector[7] += by
    return KannalaBrandt.from_vector(vector, camera.width, camera.height)


def test_the_truth_has_no_error():
    assert rpe(EQUIDISTANT, EQUIDISTANT, **SIZE) == pytest.approx(0, abs=1e-9)
    assert aligned_error(EQUIDISTANT, EQUIDISTANT, **SIZE) == pytest.approx(0, abs=1e-9)
    assert angular_error(EQUIDISTANT, EQUIDISTANT, **SIZE) == pytest.approx(0, abs=1e-9)
    assert focal_error(EQUIDISTANT, EQUIDISTANT) == pytest.approx(0, abs=1e-9)


def test_a_pinhole_is_judged_by_its_scale_and_forgiven_by_the_twin():
    # x/160 · 160 against x/200 · 160: an error of 0.2 |x| with |x| the distance to the centre
    truth, estimate = Pinhole.centred(160.0, 320, 320), Pinhole.centred(200.0, 320, 320)
    points = compared_pixels(truth, 320, 320)
    mean_radius = np.linalg.norm(points - 159.5, axis=1).mean()
    assert rpe(estimate, truth, **SIZE) == pytest.approx(0.2 * mean_radius, rel=1e-12)
    assert aligned_error(estimate, truth, **SIZE) == pytest.approx(0, abs=1e-9)
    assert focal_error(estimate, truth) == pytest.approx(25, rel=1e-6)


def test_a_shift_of_a_pinhole_is_its_error_and_is_forgiven_by_the_twin():
    truth = Pinhole(160.0, 160.0, 159.5, 159.5, 320, 320)
    estimate = Pinhole(160.0, 160.0, 152.5, 159.5, 320, 320)
    assert rpe(estimate, truth, **SIZE) == pytest.approx(7, rel=1e-12)
    assert aligned_error(estimate, truth, **SIZE) == pytest.approx(0, abs=1e-9)


def test_left_alone_equidistant_disc_by_integral():
    # At radius ρ = θ: ∫ (tan θ − θ) θ dθ / ∫ θ dθ over [0, a], times 160. With a = 45°, all of the
    # disc within the frame. 320 · (∫ θ tan θ dθ − a³/3) / a²
    a = np.pi / 4
    theta = np.linspace(0, a, 200_001)
    expected = 320 * np.trapezoid(theta * np.tan(theta) - theta**2, theta) / a**2
    found = rpe(None, EQUIDISTANT, **SIZE, theta_max=a, spacing=0.25)
    assert found == pytest.approx(expected, rel=2e-3)


def test_left_alone_is_the_pinhole_of_half_the_width():
    pinhole = Pinhole.centred(160.0, 320, 320)
    assert rpe(None, EQUIDISTANT, **SIZE) == pytest.approx(rpe(pinhole, EQUIDISTANT, **SIZE))
    assert angular_error(None, EQUIDISTANT, **SIZE) == pytest.approx(
        angular_error(pinhole, EQUIDISTANT, **SIZE)
    )


def test_the_size_of_the_photograph_does_not_matter():
    small, large = EQUIDISTANT, EQUIDISTANT.resized(1280, 1280)
    assert aligned_error(None, large, width=1280, height=1280) == pytest.approx(
        aligned_error(None, small, **SIZE), rel=1e-9
    )


def test_only_pixels_within_theta_max_of_the_true_axis_count():
    points = compared_pixels(EQUIDISTANT, 320, 320, theta_max=0.5)
    radius = np.linalg.norm(points - 159.5, axis=1)
    assert radius.max() <= 80 < radius.max() + 1
    assert len(points) == pytest.approx(np.pi * 80**2, rel=0.01)


def test_no_compared_pixel_is_misuse():
    off = KannalaBrandt(EQUIDISTANT.k, 160.0, 160.0, 2000.0, 0.0, 320, 320)
    with pytest.raises(ValueError, match="expected pixels"):
        rpe(EQUIDISTANT, off, **SIZE)


def test_grid_cells_tile_the_photograph():
    points = pixel_grid(640, 480, spacing=1.0)
    assert points.shape == (320 * 240, 2)
    assert points[0] == pytest.approx([0.5, 0.5])
    assert points[-1] == pytest.approx([638.5, 478.5])


def test_an_estimate_past_the_plane_is_charged_at_the_cap():
    narrow = KannalaBrandt.centred(np.array([0.2, 0, 0, 0, 0]), 320, 320)
    place = rectified(narrow, np.array([[300.0, 159.5]]), 320, 320)
    assert place[0] == pytest.approx([FRAME_FOCAL * np.tan(THETA_CAP), 0], abs=1e-6)


def test_a_pixel_without_a_ray_is_charged_at_the_cap_away_from_the_centre():
    pincushion = Division(1e-3, 159.5, 159.5, 320, 320)  # turns back at r = 31.6 px
    place = rectified(pincushion, np.array([[159.5, 20.0]]), 320, 320)
    assert place[0] == pytest.approx([0, -FRAME_FOCAL * np.tan(THETA_CAP)], abs=1e-6)


def test_align_recovers_a_similarity():
    rng = np.random.default_rng(3)
    source = rng.normal(size=(20, 2))
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    scale, rotation, shift = align(source, 2.5 * source @ turn.T + [3, -4])
    assert scale == pytest.approx(2.5)
    assert rotation == pytest.approx(turn)
    assert shift == pytest.approx([3, -4])


def test_align_does_not_mirror():
    source = np.array([[0.0, 0], [1, 0], [0, 1], [2, 2]])
    _, rotation, _ = align(source, source * [1, -1])
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_the_similarity_is_the_best_one():
    rng = np.random.default_rng(4)
    source, target = rng.normal(size=(30, 2)), rng.normal(size=(30, 2))

    def cost(scale: float, angle: float, shift: np.ndarray) -> float:
        c, s = np.cos(angle), np.sin(angle)
        return float(((scale * source @ np.array([[c, -s], [s, c]]).T + shift - target) ** 2).sum())

    scale, rotation, shift = align(source, target)
    angle = np.arctan2(rotation[1, 0], rotation[0, 0])
    best = cost(scale, angle, shift)
    for ds, da, dx in rng.normal(scale=1e-2, size=(50, 3)):
        assert cost(scale + ds, angle + da, shift + dx) >= best


def test_a_turned_camera_has_the_angle_as_angular_error():
    # Equidistant, the axis moved by 8 px = 0.05 rad: near the axis every ray turns by 0.05 rad
    found = angular_error(shifted(EQUIDISTANT, 8.0), EQUIDISTANT, **SIZE, theta_max=0.1)
    assert found == pytest.approx(np.degrees(0.05), rel=2e-3)


@pytest.mark.parametrize(
    ("camera", "expected"),
    [
        (EQUIDISTANT.resized(1280, 960), 640.0),
        (Pinhole(210.0, 190.0, 3.0, 4.0, 100, 80), 210.0),
        (Division(-1e-6, 200.0, 100.0, 400, 300, focal=123.0), 123.0),
    ],
)
def test_central_focal_is_the_focal_length_of_each_model(camera, expected):
    assert central_focal(camera) == pytest.approx(expected, rel=1e-6)

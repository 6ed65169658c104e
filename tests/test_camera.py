"""Laws that hold for every camera model, and agreement with OpenCV's fisheye module."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from classical.camera import Camera, Division, KannalaBrandt, Pinhole, pixel_grid

EQUIDISTANT = np.array([0.8, 0.0, 0.0, 0.0, 0.0])
CURVED = np.array([0.75, 0.03, -0.01, 0.003, -0.0004])
NARROW = np.array([1.9, 0.6, 0.2, 0.0, 0.0])
CAMERAS = {
    "equidistant": KannalaBrandt.centred(EQUIDISTANT, 640, 480),
    "curved": KannalaBrandt(CURVED, 320.0, 331.0, 310.2, 251.9, 640, 480),
    "narrow": KannalaBrandt(NARROW, 320.0, 320.0, 319.5, 239.5, 640, 480),
    "division": Division(-4e-6, 322.0, 236.0, 640, 480),
    "pincushion": Division(5e-7, 322.0, 236.0, 640, 480),
    "pinhole": Pinhole(300.0, 310.0, 318.0, 241.0, 640, 480),
}
each_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())


def random_lens(rng: np.random.Generator) -> KannalaBrandt:
    ratios = rng.normal(0.0, [0.08, 0.02, 0.004, 0.0008])
    k = rng.uniform(0.5, 1.5) * np.array([1.0, *ratios])
    aspect = rng.uniform(0.95, 1.05)
    u0, v0 = rng.normal([639.5, 479.5], 30.0)
    return KannalaBrandt(k, 640.0, 640.0 * aspect, u0, v0, 1280, 960)


def rays_within(theta: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    phi = rng.uniform(0, 2 * np.pi, len(theta))
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], 1)


@each_camera
def test_project_inverts_unproject(camera: Camera) -> None:
    points = pixel_grid(640, 480)[::997]
    rays, valid = camera.unproject(points)
    again, valid_again = camera.project(rays)
    assert valid.all()
    assert valid_again.all()
    np.testing.assert_allclose(again, points, atol=1e-8)


@each_camera
def test_rays_are_unit(camera: Camera) -> None:
    rays, _ = camera.unproject(pixel_grid(640, 480)[::997])
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0, atol=1e-12)


@each_camera
def test_axis_projects_to_the_principal_point(camera: Camera) -> None:
    points, valid = camera.project(np.array([[0.0, 0.0, 1.0]]))
    assert valid.all()
    assert isinstance(camera, KannalaBrandt | Division | Pinhole)
    np.testing.assert_allclose(points[0], [camera.u0, camera.v0], atol=1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_inverse_is_exact_to_a_nanoradian(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lens = random_lens(rng)
    theta = rng.uniform(0, min(0.98 * lens.theta_max, 2.2), 500)
    recovered, valid = lens.theta(lens.radius(theta))
    assert valid.all()
    np.testing.assert_allclose(recovered, theta, atol=1e-9)


def test_angles_past_ninety_degrees_survive() -> None:
    lens = CAMERAS["equidistant"]
    rays = np.array([[np.sin(1.9), 0.0, np.cos(1.9)]])
    again, valid = lens.unproject(lens.project(rays)[0])
    assert valid.all()
    np.testing.assert_allclose(again, rays, atol=1e-12)


@pytest.mark.parametrize("seed", range(10))
def test_project_equals_opencv(seed: int) -> None:
    # cv2.fisheye.projectPoints(rays / z, rvec=0, tvec=0, K, D)
    rng = np.random.default_rng(seed)
    lens = random_lens(rng)
    rays = rays_within(rng.uniform(0, min(0.95 * lens.theta_max, 1.45), 300), rng)
    K, D = lens.to_opencv()
    scene = (rays / rays[:, 2:])[:, None]
    expected, _ = cv2.fisheye.projectPoints(scene, np.zeros(3), np.zeros(3), K, D)
    np.testing.assert_allclose(lens.project(rays)[0], expected[:, 0], atol=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_distort_points_equals_opencv(seed: int) -> None:
    # cv2.fisheye.distortPoints(points of the z = 1 plane, K, D)
    rng = np.random.default_rng(seed)
    lens = random_lens(rng)
    plane = rng.uniform(-1.5, 1.5, (300, 2))
    rays = np.column_stack([plane, np.ones(300)])
    inside = np.arctan(np.hypot(*plane.T)) < 0.95 * lens.theta_max
    K, D = lens.to_opencv()
    expected = cv2.fisheye.distortPoints(plane[:, None], K, D)[:, 0]
    np.testing.assert_allclose(lens.project(rays)[0][inside], expected[inside], atol=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_undistort_points_equals_opencv(seed: int) -> None:
    # cv2.fisheye.undistortPoints(points, K, D), compared as rays seen through K, in pixels
    rng = np.random.default_rng(seed)
    lens = random_lens(rng)
    points = lens.project(rays_within(rng.uniform(0, min(0.9 * lens.theta_max, 1.1), 300), rng))[0]
    K, D = lens.to_opencv()
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-14)
    plane = cv2.fisheye.undistortPoints(points[:, None], K, D, criteria=criteria)[:, 0]
    rays, _ = lens.unproject(points)
    np.testing.assert_allclose(rays[:, :2] / rays[:, 2:] * K[0, 0], plane * K[0, 0], atol=1e-6)


def test_opencv_parameters_survive_a_round_trip() -> None:
    lens = CAMERAS["curved"]
    assert isinstance(lens, KannalaBrandt)
    K, D = lens.to_opencv()
    again = KannalaBrandt.from_opencv(K, D, 640, 480)
    np.testing.assert_allclose(again.to_vector(), lens.to_vector(), rtol=1e-13)


def _central_differences(lens: KannalaBrandt, points: np.ndarray) -> np.ndarray:
    vector = lens.to_vector()
    columns = []
    for i, value in enumerate(vector):
        step = np.zeros(9)
        step[i] = 1e-6 * max(1.0, abs(value))
        forward = KannalaBrandt.from_vector(vector + step, lens.width, lens.height)
        backward = KannalaBrandt.from_vector(vector - step, lens.width, lens.height)
        difference = forward.unproject(points)[0] - backward.unproject(points)[0]
        columns.append(difference / (2 * step[i]))
    return np.stack(columns, axis=2)


@pytest.mark.parametrize("name", ["equidistant", "curved", "narrow"])
def test_unproject_jacobian_by_parameters(name: str) -> None:
    lens = CAMERAS[name]
    assert isinstance(lens, KannalaBrandt)
    points = pixel_grid(640, 480)[::1499]
    jacobian = lens.unproject_jacobian(points)
    expected = _central_differences(lens, points)
    np.testing.assert_allclose(jacobian.by_parameters, expected, atol=2e-7, rtol=1e-5)


@pytest.mark.parametrize("name", ["equidistant", "curved", "narrow"])
def test_unproject_jacobian_by_points(name: str) -> None:
    lens = CAMERAS[name]
    assert isinstance(lens, KannalaBrandt)
    centre = np.array([[lens.u0, lens.v0], [lens.u0 + 0.01, lens.v0]])
    points = np.concatenate([pixel_grid(640, 480)[::1499], centre])
    by_points = lens.unproject_jacobian(points).by_points
    for axis in range(2):
        step = np.eye(2)[axis] * 1e-3
        change = lens.unproject(points + step)[0] - lens.unproject(points - step)[0]
        np.testing.assert_allclose(by_points[:, :, axis], change / 2e-3, atol=1e-8)


@pytest.mark.parametrize("name", ["equidistant", "curved", "narrow"])
def test_project_jacobian(name: str) -> None:
    lens = CAMERAS[name]
    assert isinstance(lens, KannalaBrandt)
    rays, _ = lens.unproject(pixel_grid(640, 480)[::1499])
    rays = np.concatenate([rays, [[0.0, 0.0, 1.0]]])
    by_rays, by_parameters = lens.project_jacobian(rays)
    for axis in range(3):
        step = np.eye(3)[axis] * 1e-6
        change = lens.project(rays + step)[0] - lens.project(rays - step)[0]
        np.testing.assert_allclose(by_rays[:, :, axis], change / 2e-6, atol=1e-4)
    vector = lens.to_vector()
    for i, value in enumerate(vector):
        step = np.zeros(9)
        step[i] = 1e-6 * max(1.0, abs(value))
        forward = KannalaBrandt.from_vector(vector + step, 640, 480).project(rays)[0]
        backward = KannalaBrandt.from_vector(vector - step, 640, 480).project(rays)[0]
        numeric = (forward - backward) / (2 * step[i])
        np.testing.assert_allclose(by_parameters[:, :, i], numeric, atol=1e-4)


def test_radius_grows_strictly_up_to_theta_max() -> None:
    lens = KannalaBrandt.centred(np.array([0.8, -0.05, -0.02, 0.0, 0.0]), 640, 480)
    theta = np.linspace(0, lens.theta_max, 1000)
    assert lens.theta_max < np.pi
    assert (np.diff(lens.radius(theta)) > 0).all()
    assert abs(lens.radius_derivative(np.array([lens.theta_max]))[0]) < 1e-9


def test_pixels_out_of_reach_are_invalid() -> None:
    lens = KannalaBrandt.centred(np.array([0.8, -0.2, 0.0, 0.0, 0.0]), 640, 480)
    _, valid = lens.unproject(np.array([[0.0, 0.0], [319.5, 239.5]]))
    assert valid.tolist() == [False, True]
    assert not lens.is_monotone


@given(x=st.integers(0, 200), y=st.integers(0, 150), seed=st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_crop_keeps_rays_in_place(x: int, y: int, seed: int) -> None:
    lens = random_lens(np.random.default_rng(seed))
    cut = lens.cropped(x, y, 400, 300)
    points = np.array([[10.0, 20.0], [300.5, 250.25]])
    assert cut.m_u == pytest.approx(200.0)
    expected = lens.unproject(points + np.array([x, y]))[0]
    np.testing.assert_allclose(cut.unproject(points)[0], expected, atol=1e-12)


@given(width=st.integers(50, 3000), height=st.integers(50, 3000), seed=st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_resize_keeps_rays_in_place(width: int, height: int, seed: int) -> None:
    lens = random_lens(np.random.default_rng(seed))
    small = lens.resized(width, height)
    fraction = np.array([[0.1, 0.9], [0.6, 0.3]])
    expected = lens.unproject(fraction * [1280, 960] - 0.5)[0]
    got = small.unproject(fraction * [width, height] - 0.5)[0]
    np.testing.assert_allclose(got, expected, atol=1e-12)


def test_division_undistort_inverts_distort() -> None:
    lens = CAMERAS["division"]
    assert isinstance(lens, Division)
    points = pixel_grid(640, 480)[::997]
    straight, valid = lens.undistort(points)
    np.testing.assert_allclose(lens.distort(straight[valid])[0], points[valid], atol=1e-8)


def test_division_runs_past_ninety_degrees() -> None:
    lens = Division(-2e-5, 319.5, 239.5, 640, 480)
    points = np.array([[0.0, 239.5]])
    rays, valid = lens.unproject(points)
    assert rays[0, 2] < 0
    assert valid.all()
    np.testing.assert_allclose(lens.project(rays)[0], points, atol=1e-9)


@pytest.mark.parametrize(
    ("k", "message"),
    [
        (np.zeros(5), "positive"),
        (np.array([1.0, np.nan, 0, 0, 0]), "finite"),
    ],
)
def test_impossible_lens_is_refused(k: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        KannalaBrandt.centred(k, 640, 480)


def test_skewed_matrix_is_refused() -> None:
    K = np.array([[300.0, 5.0, 320.0], [0.0, 300.0, 240.0], [0.0, 0.0, 1.0]])
    with pytest.raises(ValueError, match="without skew"):
        KannalaBrandt.from_opencv(K, np.zeros(4), 640, 480)

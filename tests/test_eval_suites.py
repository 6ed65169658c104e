import json

import cv2
import numpy as np
import pytest

from classical.camera import KannalaBrandt
from eval.calibrations import read_calibration
from eval.suites import (
    equisolid_camera,
    load_calibrated_folder,
    load_calibrated_list,
    load_fisheye_videos,
    load_suite,
)

K = np.array([[300.0, 0, 321.0], [0, 302.0, 243.0], [0, 0, 1]])
D = np.array([0.01, -0.02, 0.003, -0.0004])
EXPECTED = KannalaBrandt.from_opencv(K, D, 640, 480)
RAYS = np.array([[0.3, 0.2, 1.0], [-1.0, 0.4, 0.2], [0.0, -0.7, 1.0]])


def assert_same_lens(found, expected=EXPECTED, tolerance=1e-6):
    np.testing.assert_allclose(found.project(RAYS)[0], expected.project(RAYS)[0], atol=tolerance)


def test_opencv_yaml_gives_the_lens_it_was_written_from(tmp_path):
    file = cv2.FileStorage(str(tmp_path / "c.yaml"), cv2.FILE_STORAGE_WRITE)
    file.write("image_width", 640)
    file.write("image_height", 480)
    file.write("camera_matrix", K)
    file.write("distortion_coefficients", D.reshape(4, 1))
    file.release()
    assert_same_lens(read_calibration(tmp_path / "c.yaml"))


def test_kalibr_camchain_gives_the_lens_of_the_named_camera(tmp_path):
    chain = {
        "cam0": {"camera_model": "omni", "distortion_model": "radtan"},
        "cam1": {
            "camera_model": "pinhole",
            "distortion_model": "equidistant",
            "intrinsics": [300.0, 302.0, 321.0, 243.0],
            "distortion_coeffs": D.tolist(),
            "resolution": [640, 480],
        },
    }
    (tmp_path / "c.yaml").write_text(json.dumps(chain))
    assert_same_lens(read_calibration(tmp_path / "c.yaml", camera="cam1"))
    with pytest.raises(ValueError, match="equidistant"):
        read_calibration(tmp_path / "c.yaml")


def test_ocam_polynomial_is_fitted_by_the_nearest_lens(tmp_path):
    # an equidistant lens θ = ρ / f in OCam's terms: forward = −ρ / tan(ρ / f), f = 200
    rho = np.linspace(1, 330, 400)
    basis = np.stack([rho**i for i in (0, 2, 3, 4)], 1)
    scale = basis.max(0)
    fit = np.linalg.lstsq(basis / scale, -rho / np.tan(rho / 200.0), rcond=None)[0] / scale
    polynomial = [fit[0], 0.0, fit[1], fit[2], fit[3]]
    text = "#\n5 " + " ".join(f"{x:.12e}" for x in polynomial) + "\n\n2 1.0 1.0\n\n"
    (tmp_path / "calib_results.txt").write_text(text + "240.0 320.0\n\n1.0 0.0 0.0\n\n480 640\n")
    found = read_calibration(tmp_path / "calib_results.txt")
    expected = KannalaBrandt(
        k=np.array([200 / 320, 0, 0, 0, 0]),
        m_u=320.0,
        m_v=320.0,
        u0=320.0,
        v0=240.0,
        width=640,
        height=480,
    )
    assert_same_lens(found, expected, tolerance=0.5)


def test_a_pinhole_calibration_is_refused(tmp_path):
    record = {"K": K.tolist(), "D": [0.1] * 5, "image_width": 640, "image_height": 480}
    (tmp_path / "c.yaml").write_text(json.dumps(record))
    with pytest.raises(ValueError, match="fisheye"):
        read_calibration(tmp_path / "c.yaml")


def test_equisolid_camera_reaches_the_frame_at_half_its_field():
    camera = equisolid_camera(1088, 1088, focal_mm=1.8, sensor_mm=5.2, field=np.radians(185))
    theta = np.radians(92.5)
    points, _ = camera.project(np.array([[np.sin(theta), 0.0, np.cos(theta)]]))
    expected = 2 * 1.8 * np.sin(theta / 2) / 5.2 * 1088 + 543.5
    assert points[0, 0] == pytest.approx(expected, abs=0.01)


@pytest.fixture
def pictures(tmp_path):
    for folder, side in (("a", 1088), ("b", 64)):
        (tmp_path / folder).mkdir()
        for i in range(3):
            image = np.full((side, side, 3), 10 * i, np.uint8)
            cv2.imwrite(str(tmp_path / folder / f"{i}.png"), image)
    return tmp_path


def test_real_videos_without_calibration_are_refused(pictures):
    with pytest.raises(ValueError, match="calib_results"):
        load_fisheye_videos(pictures)


def test_synthetic_videos_bring_their_lens(pictures):
    suite = load_fisheye_videos(pictures / "a", every=2)
    assert [case.group for case in suite.cases] == ["synthetic"] * 2


def test_calibration_is_scaled_to_pictures_of_the_same_aspect(pictures):
    record = {"K": K.tolist(), "D": D.tolist(), "image_width": 128, "image_height": 128}
    (pictures / "c.yaml").write_text(json.dumps(record))
    suite = load_calibrated_folder(pictures / "b", pictures / "c.yaml")
    assert suite.is_real
    assert suite.cases[0].camera.width == 64


def test_listed_pictures_are_grouped_by_camera(pictures):
    entry = {"width": 64, "height": 64, "fx": 30, "fy": 30, "cx": 31, "cy": 32, "D": [0, 0, 0, 0]}
    entries = [
        {**entry, "image": "b/0.png", "camera": "one", "scene": True},
        {**entry, "image": "b/1.png", "camera": "two", "scene": False, "theta_max_deg": 50},
    ]
    (pictures / "suite.json").write_text(json.dumps(entries))
    suite = load_suite(pictures)
    assert {case.group for case in suite.cases} == {"one", "two"}
    assert suite.theta_max == pytest.approx(np.radians(50))
    assert len(load_calibrated_list(pictures / "suite.json", scenes_only=True).cases) == 1

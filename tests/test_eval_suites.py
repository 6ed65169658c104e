import json

import cv2
import numpy as np
import pytest

from classical.camera import KannalaBrandt
from classical.camera.formats import CAMERA_FORMATS
from eval.suites import (
    equisolid_camera,
    load_calibrated_folder,
    load_calibrated_list,
    load_fisheye_videos,
    load_suite,
)

K = np.array([[300.0, 0, 321.0], [0, 302.0, 243.0], [0, 0, 1]])
D = np.array([0.01, -0.02, 0.003, -0.0004])


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


FORMATS = {kind.name: kind for kind in CAMERA_FORMATS if kind.name != "division"}


@pytest.mark.parametrize("name", FORMATS)
def test_photographs_beside_a_camera_file_are_a_suite(pictures, name):
    lens = KannalaBrandt.from_opencv(K / 10 + np.diag([0, 0, 0.9]), D, 64, 64)
    entry = FORMATS[name]
    (pictures / "b" / f"calib_results{entry.suffix}").write_text(entry.export(lens).text)
    suite = load_suite(pictures / "b")
    rays = np.array([[0.3, 0.2, 1.0], [-0.8, 0.1, 0.6]])
    assert len(suite.cases) == 3
    for case in suite.cases:
        found, _ = case.camera.project(rays)
        np.testing.assert_allclose(found, lens.project(rays)[0], atol=0.1)


def test_two_camera_files_are_refused(pictures):
    for name in ("one.json", "two.yaml"):
        (pictures / "b" / name).write_text("{}")
    with pytest.raises(ValueError, match=r"one\.json, two\.yaml"):
        load_suite(pictures / "b")


def test_the_video_dataset_is_known_by_its_layout(pictures):
    lens = KannalaBrandt.from_opencv(K / 10 + np.diag([0, 0, 0.9]), D, 64, 64)
    (pictures / "calibration").mkdir()
    text = FORMATS["ocam"].export(lens).text
    (pictures / "calibration" / "calib_results_all.txt").write_text(text)
    suite = load_suite(pictures)
    assert [case.group for case in suite.cases] == ["synthetic", "real"]


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

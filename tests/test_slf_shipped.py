from pathlib import Path

import cv2
import numpy as np
import pytest

from classical.camera import Pinhole
from eval.suites import load_suite
from learned.slf.pack import read_rgb
from learned.slf.suite import SuiteFolder

FOLDER = Path(__file__).parent / "data" / "rooms"


@pytest.fixture(scope="module")
def items():
    return list(SuiteFolder(FOLDER))


def test_shipped_set_is_loaded_with_perspective_twins():
    suite = load_suite(FOLDER)
    assert len(suite.cases) == 4
    assert all(case.straight is not None and case.straight.is_file() for case in suite.cases)


def test_shipped_curves_meet_the_projection_of_their_ends(items):
    for item in items:
        for curve in item.curves:
            plane = np.cross(curve.ends[0], curve.ends[1])
            rays, valid = item.camera.unproject(curve.points)
            assert valid.all()
            # out-of-plane angle in pixels, with the largest scale of the lens
            off = np.abs(rays @ (plane / np.linalg.norm(plane))) * item.camera.k[0] * 160
            assert off.max() < 0.1


def test_rectified_picture_is_the_perspective_twin(items):
    folder = SuiteFolder(FOLDER)
    for item in items:
        target = Pinhole.centred(160.0, 320, 320)
        v, u = np.mgrid[0:320, 0:320].astype(float)
        rays, _ = target.unproject(np.column_stack([u.ravel(), v.ravel()]))
        points, valid = item.camera.project(rays)
        maps = points.reshape(320, 320, 2).astype(np.float32)
        picture = read_rgb(folder.picture(item.index))
        flat = cv2.remap(picture, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR)
        inside = valid.reshape(320, 320) & (maps > 1).all(-1) & (maps < 318).all(-1)
        twin = cv2.GaussianBlur(read_rgb(folder.straight(item.index)), (0, 0), 0.8).astype(float)
        moved = np.roll(twin, 3, axis=1)

        def error(other, flat=flat, inside=inside):
            return np.abs(cv2.GaussianBlur(flat, (0, 0), 0.8) - other)[inside].mean()

        assert inside.mean() > 0.5
        assert error(twin) < 4.0
        assert error(twin) < 0.6 * error(moved)

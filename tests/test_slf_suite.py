import hashlib
import shutil
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from eval.suites import load_suite
from learned.slf.atlas import load_atlas
from learned.slf.commands import synthesize as command
from learned.slf.segments import annotate
from learned.slf.suite import SuiteFolder


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """Two drawn house fronts with straight edges."""
    folder = tmp_path_factory.mktemp("photos")
    for i in range(2):
        image = np.full((160, 220, 3), 90 + 40 * i, np.uint8)
        for x in range(20, 200, 45):
            cv2.rectangle(image, (x, 30), (x + 25, 120), (220, 210, 200), -1)
        cv2.imwrite(str(folder / f"front{i}.png"), image)
    return folder


def run(*arguments):
    return CliRunner().invoke(command, [str(a) for a in arguments])


def fingerprint(folder: Path) -> dict[str, str]:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {
        p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files
    }


def make(photographs, out):
    arguments = ("--photos", photographs, "--count", 3, "--seed", 4, "--size", 64, "--out", out)
    return run("dwireframe", *arguments)


@pytest.fixture(scope="module")
def finished(photographs, tmp_path_factory):
    out = tmp_path_factory.mktemp("sets") / "one"
    result = make(photographs, out)
    assert result.exit_code == 0, result.output
    return out


def test_a_stopped_run_goes_on_to_the_same_bytes(photographs, finished, tmp_path):
    out = tmp_path / "one"
    assert make(photographs, out).exit_code == 0
    # as a kill may leave it: an item without its last file, half-written names, no card
    (out / "items" / "000001.json").unlink()
    (out / "items" / ".writing-elsewhere").mkdir()
    (out / "items" / ".writing-elsewhere" / "000001.json").write_bytes(b"{")
    (out / "pictures" / "000002.png").write_bytes(b"half")
    (out / "items" / "000002.json").unlink()
    (out / "card.json").unlink()
    assert make(photographs, out).exit_code == 0
    shutil.rmtree(out / "items" / ".writing-elsewhere")
    assert fingerprint(out) == fingerprint(finished)


def test_other_settings_in_the_same_folder_are_misuse(photographs, finished):
    result = run("dwireframe", "--photos", photographs, "--count", 9, "--out", finished)
    assert result.exit_code == 2
    assert "settings" in result.output


def test_a_folder_without_pictures_is_misuse(tmp_path):
    result = run("dwireframe", "--photos", tmp_path, "--count", 1, "--out", tmp_path / "x")
    assert result.exit_code == 2


def test_curves_on_disk_meet_the_projection_of_their_ends(finished):
    worst = []
    for item in SuiteFolder(finished):
        for curve in item.curves:
            t = np.linspace(0, 1, 3000)[:, None]
            straight, valid = item.camera.project(curve.ends[0] * (1 - t) + curve.ends[1] * t)
            assert valid.all()
            gaps = np.linalg.norm(straight[None] - curve.points[:, None], axis=2).min(axis=1)
            worst.append(gaps.max())
    assert len(worst) > 10
    assert max(worst) < 0.1


def test_item_survives_the_disk(finished, tmp_path):
    item = SuiteFolder(finished).read(0)
    copy = SuiteFolder(tmp_path / "copy")
    copy.begin({"kind": "dwireframe", "name": "copy", "note": "", "settings": {}})
    picture = np.zeros((64, 64, 3), np.uint8)
    copy.write(item, picture, picture, picture[..., 0])
    again = copy.read(0)
    assert again.camera == item.camera
    np.testing.assert_array_equal(again.curves[0].points, item.curves[0].points)


def test_set_has_a_card_and_is_loaded_as_a_suite(finished):
    suite = load_suite(finished)
    assert len(suite.cases) == 3
    assert all(case.straight is None for case in suite.cases)
    for name in ("card.json", "card.png", "contact_sheet.png"):
        assert (finished / name).stat().st_size > 100


def test_annotation_finds_the_edges_of_a_rectangle():
    image = np.full((200, 300, 3), 60, np.uint8)
    image[50:150, 80:220] = 200
    found = annotate(image)
    assert len(found) == 4
    edges = {"u": [79.5, 219.5], "v": [49.5, 149.5]}
    for u1, v1, u2, v2 in found:
        fixed = [(u1 + u2) / 2, edges["u"]] if abs(u1 - u2) < 2 else [(v1 + v2) / 2, edges["v"]]
        assert min(abs(fixed[0] - x) for x in fixed[1]) < 0.6


def test_pack_holds_photographs_and_drawn_textures(photographs, tmp_path):
    out = tmp_path / "train.pack"
    result = run("pack", "--photos", photographs, "--patterns", 3, "--workers", 1, "--out", out)
    assert result.exit_code == 0, result.output
    atlas = load_atlas(out)
    assert atlas.kind.tolist() == [0, 0, 1, 1, 1]
    assert len(atlas.segments) == atlas.first[-1]


def test_a_pack_of_nothing_is_misuse(tmp_path):
    assert run("pack", "--patterns", 0, "--out", tmp_path / "x").exit_code == 2


@pytest.mark.skipif(find_spec("bpy") is not None, reason="this interpreter has Blender")
def test_rooms_without_blender_say_what_is_missing(tmp_path):
    result = run("rooms", "--count", 1, "--size", 64, "--out", tmp_path / "rooms")
    assert result.exit_code == 1
    assert "bpy" in result.output

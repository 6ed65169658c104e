"""Laws of the command line: whole files, one-line errors, exit codes."""

import json
import os
import subprocess
import sys
from functools import cache
from importlib.metadata import version
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

from classical.camera import KannalaBrandt
from hybrid import (
    CameraFile,
    Quality,
    Rectifier,
    RectifyConfig,
    read_camera,
    read_picture,
    write_camera,
)
from hybrid.cli import run
from hybrid.failures import reason_of

SIZE = (240, 180)
LENS = KannalaBrandt.centred(np.array([0.95, -0.06, 0.004, 0.0, 0.0]), *SIZE)


@cache
def blinds() -> np.ndarray:
    """A grid of dark bars on a plane 1 m ahead, through LENS; what the classical method likes."""
    wide = 480, 360
    camera = LENS.resized(*wide)
    u, v = np.meshgrid(np.arange(0, wide[0], 0.5), np.arange(0, wide[1], 0.5))
    rays, _ = camera.unproject(np.stack([u.ravel() - 0.25, v.ravel() - 0.25], axis=1))
    x, y = (rays[:, :2] / np.maximum(rays[:, 2:], 1e-3)).T
    x = x + 0.25 * y
    bars = ((x / 0.5) % 1 < 0.25) | ((y / 0.4 + 0.1) % 1 < 0.2)
    shade = np.where(bars, 60.0, 190.0).reshape(u.shape)
    shade = cv2.resize(shade, wide, interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(np.rint(shade).astype(np.uint8), cv2.COLOR_GRAY2RGB)


def save(path: Path, pixels: np.ndarray | None = None, **options) -> Path:
    pixels = np.zeros((SIZE[1], SIZE[0], 3), np.uint8) if pixels is None else pixels
    Image.fromarray(pixels).save(path, **options)
    return path


def camera_file(folder: Path) -> Path:
    write_camera(folder / "lens.json", CameraFile(LENS, "ok", "made up", Quality()))
    return folder / "lens.json"


def words(*parts: object) -> list[str]:
    return [str(part) for part in parts]


def one_line(capsys) -> str:
    """What was said on stderr, which must be a single line."""
    said = capsys.readouterr().err
    assert said.count("\n") == 1, said
    assert "Traceback" not in said
    return said


# ---- rectify ----------------------------------------------------------------------------------


def test_a_picture_becomes_a_picture_and_a_camera_file(tmp_path, capsys):
    source = save(tmp_path / "room.png", blinds())
    assert run(words("rectify", source, "--out", tmp_path / "out", "--overlay")) == 0
    out = tmp_path / "out"
    names = sorted(path.name for path in out.iterdir())
    assert names == ["room.camera.json", "room.overlay.png", "room.png"]
    assert read_picture(out / "room.png").pixels.shape == blinds().shape
    assert read_camera(out / "room.camera.json").camera.width == 480
    said = capsys.readouterr()
    assert said.out.count("\n") == 1
    assert said.err == ""


def test_json_is_one_object_a_picture(tmp_path, capsys):
    save(tmp_path / "a.png", blinds())
    save(tmp_path / "b.png")
    assert run(words("rectify", tmp_path, "--out", tmp_path / "out", "--json")) == 1
    good, bad = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert good["status"] in ("ok", "degraded")
    assert len(good["camera"]["k"]) == 5
    assert len(good["camera"]["opencv_fisheye"]["D"]) == 4
    assert Path(good["output"]).is_file()
    assert bad["status"] == "failed"
    assert bad["reason"]
    assert not (tmp_path / "out" / "b.png").exists()


def test_a_given_camera_is_used_and_written(tmp_path):
    source = save(tmp_path / "black.jpg")
    camera = camera_file(tmp_path)
    out = tmp_path / "out"
    assert run(words("rectify", source, "--out", out, "--camera", camera, "--fov", 80)) == 0
    assert read_camera(out / "black.camera.json").camera == LENS


def test_frame_options_reach_the_picture(tmp_path):
    source = save(tmp_path / "black.png")
    options = ["--camera", camera_file(tmp_path), "--size", "64x48", "--balance", "1"]
    assert run(words("rectify", source, "--out", tmp_path / "out", *options)) == 0
    assert read_picture(tmp_path / "out" / "black.png").pixels.shape == (48, 64, 3)


def test_weights_that_ship_are_chosen_by_name(tmp_path):
    source = save(tmp_path / "room.png", blinds())
    options = ["--method", "learned", "--weights", "compact-wf", "--out", tmp_path / "out"]
    assert run(words("rectify", source, *options)) == 0
    found = read_camera(tmp_path / "out" / "room.camera.json").camera
    named, default = (
        Rectifier(RectifyConfig(method="learned", weights=name)).calibrate([blinds()]).camera
        for name in ("compact-wf", None)
    )
    assert found == named
    assert found != default


@pytest.mark.parametrize(
    ("weights", "code", "message"),
    [("enormous", 1, "'compact-wf'"), ("mine.safetensors", 2, "does not exist")],
)
def test_weights_that_are_not_there_are_one_line(tmp_path, capsys, weights, code, message):
    source = save(tmp_path / "a.png")
    options = ["--out", tmp_path / "out", "--weights", weights]
    assert run(words("rectify", source, *options)) == code
    said = one_line(capsys)
    assert weights in said
    assert message in said


def test_sixteen_bits_stay_sixteen_bits(tmp_path):
    pixels = np.full((SIZE[1], SIZE[0], 3), 40000, np.uint16)
    tifffile.imwrite(tmp_path / "deep.tif", pixels, photometric="rgb")
    options = ["--camera", camera_file(tmp_path), "--out", tmp_path / "out"]
    assert run(words("rectify", tmp_path / "deep.tif", *options)) == 0
    out = read_picture(tmp_path / "out" / "deep.tif").pixels
    assert out.dtype == np.uint16
    assert abs(int(out[90, 120, 0]) - 40000) < 3


def test_identity_copies_the_picture(tmp_path):
    source = save(tmp_path / "room.png", blinds())
    options = ["--method", "identity", "--out", tmp_path / "out"]
    assert run(words("rectify", source, *options)) == 0
    np.testing.assert_array_equal(read_picture(tmp_path / "out" / "room.png").pixels, blinds())
    assert not (tmp_path / "out" / "room.camera.json").exists()


# ---- bad input --------------------------------------------------------------------------------


def spoil(folder: Path, kind: str) -> str:
    """Put a bad file among the pictures; returns its name."""
    if kind == "text":
        (folder / "bad.jpg").write_text("I am no picture")
        return "bad.jpg"
    if kind == "empty":
        (folder / "bad.png").touch()
        return "bad.png"
    if kind == "truncated":
        save(folder / "bad.jpg", blinds(), quality=95)
        (folder / "bad.jpg").write_bytes((folder / "bad.jpg").read_bytes()[:4000])
        return "bad.jpg"
    if kind == "other shape":
        save(folder / "bad.png", np.zeros((50, 400, 3), np.uint8))
        return "bad.png"
    if kind == "1x1":
        save(folder / "bad.png", np.zeros((1, 1, 3), np.uint8))
        return "bad.png"
    (folder / "bad.tif").write_bytes(b"II*\0 and then nonsense")
    return "bad.tif"


@pytest.mark.parametrize("kind", ["text", "empty", "truncated", "other shape", "tiff"])
def test_one_bad_file_is_reported_and_the_others_are_done(tmp_path, capsys, kind):
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for name in ("a.png", "z.png"):
        save(pictures / name)
    bad = spoil(pictures, kind)
    out = tmp_path / "out"
    assert run(words("rectify", pictures, "--out", out, "--camera", camera_file(tmp_path))) == 1
    assert bad in one_line(capsys)
    written = sorted(path.name for path in out.iterdir())
    assert written == ["a.camera.json", "a.png", "z.camera.json", "z.png"]


@pytest.mark.parametrize("pixels", [np.zeros((200, 300, 3), np.uint8), np.zeros((1, 1), np.uint8)])
def test_a_picture_that_tells_nothing_fails_on_one_line(tmp_path, capsys, pixels):
    source = save(tmp_path / "nothing.png", pixels)
    assert run(words("rectify", source, "--out", tmp_path / "out")) == 1
    assert "nothing.png" in one_line(capsys)
    assert list((tmp_path / "out").iterdir()) == []


def test_fifty_megapixels_are_done(tmp_path):
    source = tmp_path / "large.jpg"
    Image.new("L", (8192, 6144), 90).save(source)
    out = tmp_path / "out"
    options = ["--camera", camera_file(tmp_path), "--size", "800x600", "--out", out]
    assert run(words("rectify", source, *options)) == 0
    assert read_picture(out / "large.jpg").pixels.shape == (600, 800)


def test_existing_output_needs_overwrite(tmp_path, capsys):
    source = save(tmp_path / "a.png", np.full((SIZE[1], SIZE[0], 3), 200, np.uint8))
    out = tmp_path / "out"
    out.mkdir()
    (out / "a.png").write_text("precious")
    arguments = words("rectify", source, "--out", out, "--camera", camera_file(tmp_path))
    assert run(arguments) == 2
    assert "--overwrite" in one_line(capsys)
    assert (out / "a.png").read_text() == "precious"
    assert run([*arguments, "--overwrite"]) == 0
    assert read_picture(out / "a.png").pixels.max() == 200


def test_inputs_are_never_overwritten(tmp_path, capsys):
    source = save(tmp_path / "a.png", blinds())
    before = source.read_bytes()
    assert run(words("rectify", source, "--out", tmp_path, "--overwrite")) == 2
    assert "is an input" in one_line(capsys)
    assert source.read_bytes() == before


def test_two_inputs_with_one_output_are_refused(tmp_path, capsys):
    sources = [save(tmp_path / "a.png"), save(tmp_path / "a.jpg")]
    assert run(words("rectify", *sources, "--out", tmp_path / "out")) == 2
    assert "both write" in one_line(capsys)


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path, capsys):
    source = save(tmp_path / "a.png")
    (tmp_path / "file").touch()
    assert run(words("rectify", source, "--out", tmp_path / "file" / "out")) == 1
    assert "cannot make the folder" in one_line(capsys)


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="permissions do not bind root"
)
def test_no_write_permission_is_one_line(tmp_path, capsys):
    source = save(tmp_path / "a.png")
    out = tmp_path / "out"
    out.mkdir(mode=0o500)
    assert run(words("rectify", source, "--out", out, "--camera", camera_file(tmp_path))) == 1
    assert "ermission" in one_line(capsys)


def test_a_denied_write_is_one_line_and_leaves_nothing(tmp_path, capsys, monkeypatch):
    # stands for the test above where the tests run as root
    def deny(*_args, **_options):
        raise PermissionError(13, "Permission denied")

    source, lens = save(tmp_path / "a.png"), camera_file(tmp_path)
    monkeypatch.setattr("classical.files.tempfile.mkdtemp", deny)
    assert run(words("rectify", source, "--out", tmp_path / "out", "--camera", lens)) == 1
    assert "a.png: Permission denied" in one_line(capsys)
    assert list((tmp_path / "out").iterdir()) == []


def test_a_file_that_cannot_be_written_is_named_and_not_its_input(tmp_path: Path) -> None:
    error = PermissionError(13, "Permission denied", str(tmp_path / "out" / "a.png"))
    assert reason_of(error, tmp_path / "a.png") == f"{tmp_path}/out/a.png: Permission denied"
    assert reason_of(error, tmp_path / "out" / "a.png") == "Permission denied"


# ---- misuse -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["rectify"], "PATHS"),
        (["rectify", "none.png", "--out", "x"], "none.png"),
        (["rectify", "a.png"], "--out"),
        (["rectify", "a.png", "--out", "x", "--method", "magic"], "magic"),
        (["rectify", "a.png", "--out", "x", "--size", "big"], "WIDTHxHEIGHT"),
        (["rectify", "a.png", "--out", "x", "--size", "0x4"], "1x1"),
        (["rectify", "a.png", "--out", "x", "--fov", "90", "--balance", "1"], "at most one"),
        (["rectify", "a.png", "--out", "x", "--fov", "200"], "175"),
        (["rectify", "a.png", "--out", "x", "--camera", "a.png"], "camera file"),
        (["rectify", "empty", "--out", "x"], "no pictures"),
        (["rectify", "a.png", "--out", "x", "--nonsense"], "nonsense"),
        (["nonsense"], "nonsense"),
        (["calibrate", "a.png"], "--out"),
        (["calibrate", "a.png", "b.png", "--out", "x.json"], "one size"),
    ],
)
def test_misuse_is_one_line_and_code_two(tmp_path, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    save(tmp_path / "a.png")
    save(tmp_path / "b.png", np.zeros((50, 60, 3), np.uint8))
    (tmp_path / "empty").mkdir()
    assert run(arguments) == 2
    assert message in one_line(capsys)


def test_interruption_is_one_line(tmp_path, capsys, monkeypatch):
    def interrupt(*_args, **_options):
        raise KeyboardInterrupt

    source = save(tmp_path / "a.png")
    monkeypatch.setattr("hybrid.commands.rectify.read_picture", interrupt)
    assert run(words("rectify", source, "--out", tmp_path / "out")) == 130
    assert "interrupted" in capsys.readouterr().err


# ---- calibrate --------------------------------------------------------------------------------


def test_calibrate_writes_one_camera_file(tmp_path, capsys):
    for name in ("a.png", "b.png"):
        save(tmp_path / name, blinds())
    out = tmp_path / "lens" / "camera.json"
    assert run(words("calibrate", tmp_path, "--out", out, "--json")) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["n_images"] == 2
    assert read_camera(out).camera.k.tolist() == report["camera"]["k"]
    assert run(words("calibrate", tmp_path, "--out", out)) == 2
    assert "--overwrite" in one_line(capsys)


def test_calibrate_leaves_bad_files_out(tmp_path, capsys):
    save(tmp_path / "a.png", blinds())
    spoil(tmp_path, "text")
    assert run(words("calibrate", tmp_path, "--out", tmp_path / "camera.json")) == 1
    assert "bad.jpg" in one_line(capsys)
    assert (tmp_path / "camera.json").is_file()


def test_calibrate_without_lines_fails_on_one_line(tmp_path, capsys):
    save(tmp_path / "a.png")
    assert run(words("calibrate", tmp_path / "a.png", "--out", tmp_path / "camera.json")) == 1
    assert "no lens found" in one_line(capsys)
    assert not (tmp_path / "camera.json").exists()


# ---- camera files -----------------------------------------------------------------------------


def test_a_camera_file_is_read_back_exactly(tmp_path):
    covariance = np.random.default_rng(0).normal(size=(9, 9))
    quality = Quality(0.25, 40, 31, covariance, 1.5)
    write_camera(tmp_path / "c.json", CameraFile(LENS, "degraded", "few lines", quality))
    read = read_camera(tmp_path / "c.json")
    assert read.camera == LENS
    assert (read.status, read.reason) == ("degraded", "few lines")
    assert (read.quality.rms_px, read.quality.n_curves, read.quality.n_inliers) == (0.25, 40, 31)
    np.testing.assert_array_equal(read.quality.covariance, covariance)


def test_a_camera_file_is_plain_json_with_the_lens_of_opencv(tmp_path):
    write_camera(tmp_path / "c.json", CameraFile(LENS, "ok", "", Quality()))
    fields = json.loads((tmp_path / "c.json").read_text(), parse_constant=pytest.fail)
    K, D = (np.array(fields["opencv_fisheye"][name]) for name in "KD")
    again = KannalaBrandt.from_opencv(K, D, fields["width"], fields["height"])
    np.testing.assert_allclose(again.k, LENS.k, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 2}, "version 1"),
        ({"format": "other"}, "not a camera file"),
        ({"model": "pinhole"}, "kannala-brandt"),
        ({"k": [1, 2]}, "5 numbers"),
        ({"k": None}, "c.json"),
        ({"m_u": -1}, "positive"),
        ({"m_u": float("nan")}, "finite"),
        ({"width": 0}, "1x1"),
        ({"status": "failed"}, "status"),
        ({"quality": {"covariance": [1]}}, "covariance"),
        ({"u0": ...}, "'u0' is missing"),
    ],
)
def test_a_bad_camera_file_is_told_by_its_field(tmp_path, change, message):
    path = tmp_path / "c.json"
    write_camera(path, CameraFile(LENS, "ok", "", Quality()))
    fields = json.loads(path.read_text()) | change
    fields = {name: value for name, value in fields.items() if value is not ...}
    path.write_text(json.dumps(fields))
    with pytest.raises(ValueError, match=message) as caught:
        read_camera(path)
    assert str(path) in str(caught.value)


def test_no_json_is_no_camera_file(tmp_path):
    (tmp_path / "c.json").write_text("{")
    with pytest.raises(ValueError, match="not a camera file"):
        read_camera(tmp_path / "c.json")


# ---- the program ------------------------------------------------------------------------------


def test_help_names_the_commands(capsys):
    assert run(["--help"]) == 0
    said = capsys.readouterr().out
    assert "rectify" in said
    assert "calibrate" in said


def test_the_module_runs_as_a_program(tmp_path):
    """As `accelerate launch -m hybrid.cli` starts it."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", "hybrid.cli", "--version"],
        capture_output=True, text=True, cwd=tmp_path, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"straightlens, version {version('straightlens')}\n"


def test_the_installed_program_runs(tmp_path):
    program = Path(sys.executable).with_name("straightlens")
    if not program.exists():
        pytest.skip("the package is not installed")
    done = subprocess.run(
        [program, "rectify", "none.png", "--out", "x"],
        capture_output=True, text=True, cwd=tmp_path, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1

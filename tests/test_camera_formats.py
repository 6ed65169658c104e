"""Camera files: what the programs that they are for see in them, and reading them back."""

import json
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from classical.camera import KannalaBrandt, Ocam, conversion_residual, nearest_division
from classical.camera.formats import CAMERA_FORMATS, Content, cameras_of, chosen_camera, read_lens
from classical.camera.formats import ocam as ocam_format
from hybrid import CameraFile, Quality, read_camera, read_picture, write_camera
from hybrid.camera_files import format_names, format_suffix
from hybrid.cli import run

LENS = KannalaBrandt(
    np.array([0.75, 0.03, -0.01, 0.003, -0.0004]), 320.0, 331.0, 310.2, 251.9, 640, 480
)
FORMATS = {row.name: row for row in CAMERA_FORMATS}
EXACT = ("opencv", "colmap", "kalibr", "ros", "nerfstudio", "gyroflow")
NEAREST = ("ocam", "division")


def scene(widest: float = 80.0) -> np.ndarray:
    """Rays up to so many degrees off the axis."""
    rng = np.random.default_rng(0)
    theta, phi = np.radians(rng.uniform(0, widest, 200)), rng.uniform(0, 2 * np.pi, 200)
    x, y = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)
    return np.stack([x, y, np.cos(theta)], axis=1)


def text_of(name: str, lens: KannalaBrandt = LENS) -> str:
    return FORMATS[name].export(lens).text


def lens_of(text: str, name: str | None = None) -> KannalaBrandt:
    return chosen_camera(cameras_of(Content(text)), name)


def by_opencv(K: object, D: object) -> np.ndarray:
    """The scene through cv2.fisheye."""
    rays = scene()
    K, D = np.array(K, float).reshape(3, 3), np.array(D, float).reshape(4)
    points = (rays / rays[:, 2:])[:, None]
    return cv2.fisheye.projectPoints(points, np.zeros(3), np.zeros(3), K, D)[0][:, 0]


def by_formula(parameters: object, D: object, rays: np.ndarray) -> np.ndarray:
    """The scene through θ (1 + k1 θ² + … + k4 θ⁸), as nerfstudio and Gyroflow have it."""
    fx, fy, cx, cy = np.array(parameters, float)
    across = np.hypot(rays[:, 0], rays[:, 1])
    theta = np.arctan2(across, rays[:, 2])
    powers = theta[:, None] ** np.array([2, 4, 6, 8])
    stretch = theta * (1 + powers @ np.array(D, float)) / across
    return np.stack([fx * stretch * rays[:, 0] + cx, fy * stretch * rays[:, 1] + cy], axis=1)


# ---- the programs that the files are for ---------------------------------------------------------


def test_opencv_reads_its_yaml(tmp_path):
    (tmp_path / "camera.yaml").write_text(text_of("opencv"))
    file = cv2.FileStorage(str(tmp_path / "camera.yaml"), cv2.FILE_STORAGE_READ)
    K, D = file.getNode("camera_matrix").mat(), file.getNode("distortion_coefficients").mat()
    size = [int(file.getNode(f"image_{side}").real()) for side in ("width", "height")]
    assert size == [640, 480]
    np.testing.assert_allclose(by_opencv(K, D), LENS.project(scene())[0], atol=1e-6)


def test_colmap_reads_its_cameras(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    (tmp_path / "cameras.txt").write_text(text_of("colmap"))
    for name in ("images.txt", "points3D.txt"):
        (tmp_path / name).touch()
    reconstruction = pycolmap.Reconstruction()
    reconstruction.read_text(str(tmp_path))
    camera = reconstruction.cameras[1]
    assert (camera.width, camera.height, camera.model_name) == (640, 480, "OPENCV_FISHEYE")
    # COLMAP's centre of the top-left pixel is (0.5, 0.5)
    points = camera.img_from_cam(scene()) - 0.5
    np.testing.assert_allclose(points, LENS.project(scene())[0], atol=1e-6)


def test_kalibr_camchain_is_the_lens_in_yaml():
    fields = yaml.safe_load(text_of("kalibr"))["cam0"]
    assert (fields["camera_model"], fields["distortion_model"]) == ("pinhole", "equidistant")
    assert fields["resolution"] == [640, 480]
    fx, fy, cx, cy = fields["intrinsics"]
    points = by_opencv([fx, 0, cx, 0, fy, cy, 0, 0, 1], fields["distortion_coeffs"])
    np.testing.assert_allclose(points, LENS.project(scene())[0], atol=1e-6)


def test_ros_camera_info_is_the_lens_in_yaml():
    fields = yaml.safe_load(text_of("ros"))
    assert fields["distortion_model"] == "equidistant"
    assert (fields["image_width"], fields["image_height"]) == (640, 480)
    for name, shape in (("camera", (3, 3)), ("rectification", (3, 3)), ("projection", (3, 4))):
        matrix = fields[f"{name}_matrix"]
        assert (matrix["rows"], matrix["cols"]) == shape
        assert len(matrix["data"]) == shape[0] * shape[1]
    D = fields["distortion_coefficients"]["data"]
    points = by_opencv(fields["camera_matrix"]["data"], D)
    np.testing.assert_allclose(points, LENS.project(scene())[0], atol=1e-6)


def test_nerfstudio_transforms_are_the_lens_in_json():
    fields = json.loads(text_of("nerfstudio"))
    assert (fields["camera_model"], fields["w"], fields["h"]) == ("OPENCV_FISHEYE", 640, 480)
    assert fields["frames"] == []
    parameters = [fields[name] for name in ("fl_x", "fl_y", "cx", "cy")]
    D = [fields[name] for name in ("k1", "k2", "k3", "k4")]
    # nerfstudio shoots the ray of pixel i through i + 0.5 (Cameras.get_image_coords)
    points = by_formula(parameters, D, scene()) - 0.5
    np.testing.assert_allclose(points, LENS.project(scene())[0], atol=1e-6)


def test_gyroflow_profile_is_the_lens_in_json_also_past_ninety_degrees():
    fields = json.loads(text_of("gyroflow"))
    assert fields["calib_dimension"] == {"w": 640, "h": 480}
    assert fields["asymmetrical"]  # or Gyroflow moves the principal point to the middle
    assert fields["calibrator_version"]  # or Gyroflow refuses the file
    (fx, _, cx), (_, fy, cy), _ = fields["fisheye_params"]["camera_matrix"]
    D = fields["fisheye_params"]["distortion_coeffs"]
    rays = scene(110.0)
    points = by_formula([fx, fy, cx, cy], D, rays)
    np.testing.assert_allclose(points, LENS.project(rays)[0], atol=1e-6)


def ocam_model(path: Path) -> list[list[float]]:
    """As get_ocam_model of OCamCalib's C code reads: one comment line before each record."""
    rest, records = path.read_text(), []
    for count in (None, None, 2, 3, 2):
        comment, rest = rest.lstrip().split("\n", 1)
        assert comment.startswith("#")
        words = rest.split()
        n_taken = int(words[0]) + 1 if count is None else count
        records.append([float(word) for word in words[:n_taken]][1 if count is None else 0 :])
        rest = rest.lstrip().split("\n", 1)[1]
    return records


def test_ocam_functions_see_the_lens_within_the_told_residual(tmp_path):
    export = FORMATS["ocam"].export(LENS)
    assert export.residual is not None
    assert export.residual.max_px < 0.01
    (tmp_path / "calib_results.txt").write_text(export.text)
    direct, inverse, (row, column), (c, d, e), size = ocam_model(tmp_path / "calib_results.txt")
    assert size == [480, 640]
    rays = scene()
    truth = LENS.project(rays)[0]
    # world2cam: x goes down, y to the right, the camera looks along −z
    x, y, z = rays[:, 1], rays[:, 0], -rays[:, 2]
    norm = np.hypot(x, y)
    rho = np.polynomial.polynomial.polyval(np.arctan(z / norm), inverse)
    x, y = x / norm * rho, y / norm * rho
    found = np.stack([x * e + y + column, x * c + y * d + row], axis=1)
    np.testing.assert_allclose(found, truth, atol=0.01)
    # cam2world
    x, y = (truth[:, 1] - row) / c, truth[:, 0] - column
    z = np.polynomial.polynomial.polyval(np.hypot(x, y), direct)
    back = np.stack([y, x, -z], axis=1)
    np.testing.assert_allclose(LENS.project(back)[0], truth, atol=0.01)


def test_division_file_is_the_model_with_its_residual():
    fields = json.loads(text_of("division"))
    rays = scene(60.0)
    x, y = (LENS.project(rays)[0] - [fields["u0"], fields["v0"]]).T
    forward = fields["focal"] * (1 + fields["lambda"] * (x**2 + y**2))
    bent = np.stack([x, y, forward], axis=1)
    error = np.linalg.norm(LENS.project(bent)[0] - LENS.project(rays)[0], axis=1)
    assert 0 < error.max() <= fields["residual"]["max_px"]


# ---- conversion ----------------------------------------------------------------------------------


def test_a_division_lens_is_found_again():
    # the nearest Kannala–Brandt lens of a division model, converted back
    lens = lens_of(text_of("division"))
    again = nearest_division(lens)
    first = json.loads(text_of("division"))
    assert again.lambda_ == pytest.approx(first["lambda"], rel=1e-3)
    assert again.focal == pytest.approx(first["focal"], rel=1e-3)
    assert conversion_residual(lens, again).max_px < 0.1


@pytest.mark.parametrize("half_field", [40.0, 70.0, 95.0])
def test_ocam_follows_any_field_of_view(half_field):
    k1 = 1.25 / np.radians(half_field)  # half the field of view lies at the frame's corner
    lens = KannalaBrandt.centred(np.array([k1, -0.02 * k1, 0.002 * k1, 0, 0]), 1280, 960)
    residual = FORMATS["ocam"].export(lens).residual
    assert residual is not None
    assert residual.max_px < 0.02


def test_residual_is_zero_for_the_lens_itself():
    assert conversion_residual(LENS, LENS).max_px < 1e-9


# ---- reading back --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EXACT)
def test_an_exact_format_gives_the_same_lens(tmp_path, name):
    path = tmp_path / f"camera{FORMATS[name].suffix}"
    path.write_text(text_of(name))
    found = read_lens(path)
    np.testing.assert_allclose(found.to_vector(), LENS.to_vector(), rtol=1e-13, atol=1e-12)
    assert (found.width, found.height) == (640, 480)
    assert FORMATS[name].export(LENS).residual is None


@pytest.mark.parametrize("name", NEAREST)
def test_a_nearest_format_gives_a_lens_within_the_told_residual(name):
    text, residual = FORMATS[name].export(LENS)
    assert residual is not None
    assert conversion_residual(LENS, lens_of(text)).max_px < residual.max_px + 0.1


@pytest.mark.parametrize("kind", format_names())
def test_every_written_format_is_read_by_read_camera(tmp_path, kind):
    path = tmp_path / f"camera{format_suffix(kind)}"
    content = CameraFile(LENS, "degraded", "few lines", Quality(rms_px=0.25))
    residual = write_camera(path, content, kind)
    read = read_camera(path)
    allowed = 1e-9 if residual is None else residual.max_px + 0.1
    assert conversion_residual(LENS, read.camera).max_px < allowed
    keeps_all = kind == "straightlens" or kind.startswith("stmap")
    assert (read.status, read.quality.rms_px == 0.25) == (
        ("degraded", True) if keeps_all else ("ok", False)
    )


def test_an_unknown_format_is_misuse(tmp_path):
    with pytest.raises(ValueError, match="opencv"):
        write_camera(tmp_path / "c", CameraFile(LENS, "ok", "", Quality()), "matlab")
    assert list(tmp_path.iterdir()) == []


def test_stmap_in_exr_carries_the_camera(tmp_path):
    pytest.importorskip("OpenEXR")
    path = tmp_path / "map.exr"
    write_camera(path, CameraFile(LENS, "ok", "", Quality()), "stmap")
    assert read_camera(path).camera == LENS


def test_an_stmap_of_another_program_is_no_camera_file(tmp_path):
    cv2.imwrite(str(tmp_path / "map.tif"), np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(ValueError, match="camera file"):
        read_camera(tmp_path / "map.tif")


def test_other_spellings_of_opencv_are_read():
    K, D = LENS.to_opencv()
    record = {"K": K.tolist(), "D": D[:, None].tolist(), "image_size": [640, 480]}
    for text in (json.dumps(record), yaml.safe_dump(record)):
        assert conversion_residual(LENS, lens_of(text)).max_px < 1e-9


def test_numbers_of_other_yaml_writers_are_read():
    # YAML 1.1 takes 1e-05 for a string
    text = text_of("kalibr").replace("-0.0005333333333333334", "-5.333333333333334e-4")
    assert conversion_residual(LENS, lens_of(text)).max_px < 1e-9


def two_cameras() -> str:
    chain = yaml.safe_load(text_of("kalibr"))
    other = {"camera_model": "omni", "distortion_model": "radtan"}
    return yaml.safe_dump({"cam0": other, "cam1": chain["cam0"]})


def test_one_of_several_cameras_is_named():
    assert conversion_residual(LENS, lens_of(two_cameras(), "cam1")).max_px < 1e-9
    for name, message in ((None, "cam0, cam1"), ("cam0", "equidistant"), ("cam2", "cam0, cam1")):
        with pytest.raises(ValueError, match=message):
            lens_of(two_cameras(), name)


def test_colmap_cameras_go_by_number_and_simpler_models_are_read():
    text = (
        "# cameras\n"
        "3 PINHOLE 640 480 300 300 320 240\n"
        "7 SIMPLE_RADIAL_FISHEYE 640 480 300 320 240 0.01\n"
        "8 RADIAL_FISHEYE 640 480 300 320 240 0.01 -0.002\n"
    )
    K, D = lens_of(text, "7").to_opencv()
    np.testing.assert_allclose(K, [[300, 0, 319.5], [0, 300, 239.5], [0, 0, 1]])
    np.testing.assert_allclose(D, [0.01, 0, 0, 0], atol=1e-15)
    np.testing.assert_allclose(lens_of(text, "8").to_opencv()[1], [0.01, -0.002, 0, 0], atol=1e-15)
    with pytest.raises(ValueError, match="PINHOLE"):
        lens_of(text, "3")


def test_ocam_of_an_equidistant_lens_is_fitted():
    # θ = ρ / f in OCam's terms: forward = −ρ / tan(ρ / f), f = 200; no inverse polynomial
    rho = np.linspace(1, 400, 400)
    basis = np.stack([rho**i for i in (0, 2, 3, 4)], 1)
    scale = basis.max(0)
    fit = np.linalg.lstsq(basis / scale, -rho / np.tan(rho / 200.0), rcond=None)[0] / scale
    polynomial = [fit[0], 0.0, fit[1], fit[2], fit[3]]
    text = "#\n5 " + " ".join(f"{x:.12e}" for x in polynomial) + "\n\n2 1.0 1.0\n\n"
    text += "240.0 320.0\n\n1.0 0.0 0.0\n\n480 640\n"
    points = np.array([[5.0, 7.0], [321.0, 240.0], [500.0, 470.0], [639.0, 0.0]])
    rays, valid = ocam_format.parse(Content(text)).unproject(points)
    assert valid.all()
    np.testing.assert_allclose(lens_of(text).project(rays)[0], points, atol=0.25)
    equidistant = 200 * np.arccos(rays[:, 2])
    np.testing.assert_allclose(np.hypot(*(points - [320, 240]).T), equidistant, atol=2)


def test_ocam_projects_what_it_unprojects():
    camera = ocam_format.parse(Content(text_of("ocam")))
    assert isinstance(camera, Ocam)
    points = np.array([[10.0, 20.0], [310.2, 251.9], [600.0, 400.0]])
    rays, valid = camera.unproject(points)
    again, seen = camera.project(rays)
    assert valid.all()
    assert seen.all()
    np.testing.assert_allclose(again, points, atol=0.01)
    behind = camera.project(np.array([[0.0, 0.1, -1.0]]))[1]
    assert not behind.any()


# ---- bad files -----------------------------------------------------------------------------------

K4 = "[300,0,320,0,300,240,0,0,1]"
BAD = {
    "empty": ("", "known kind"),
    "prose": ("I am no camera", "known kind"),
    "broken JSON": ("{", "not a camera file"),
    "broken YAML": ("a: [1,\n", "not a camera file"),
    "deep": ("[" * 100_000, "deeply|characters|not a camera"),
    "pinhole": (f"K: {K4}\nD: [0,0,0,0,0]\nimage_width: 640\nimage_height: 480", "four coeff"),
    "no distortion": (f"K: {K4}\nimage_width: 640\nimage_height: 480", "'D' is missing|or 'D'"),
    "words": (f"K: {K4}\nD: [a,b,c,d]\nimage_width: 640\nimage_height: 480", "numbers in 'D'"),
    "NaN": (f"K: {K4}\nD: [.nan,nan,0,0]\nimage_width: 640\nimage_height: 480", "'D'"),
    "no size": (f"K: {K4}\nD: [0,0,0,0]", "'image_width' is missing"),
    "half a pixel": (f"K: {K4}\nD: [0,0,0,0]\nimage_size: [640, 480.5]", "whole pixels"),
    "huge": (f"K: {K4}\nD: [0,0,0,0]\nimage_size: [640, 1e9]", "whole pixels"),
    "negative focal": (
        f"K: {K4}\nD: [0,0,0,0]\nimage_size: [640, 480]".replace("300", "-3"),
        "foc",
    ),
    "overflow": (f"K: {K4}\nD: [1e308,0,0,0]\nimage_size: [4, 4]".replace("300", "1e9"), "finite"),
    "skew": (f"K: {K4}\nD: [0,0,0,0]\nimage_size: [4, 4]".replace("300,0", "300,1"), "skew"),
    "nerfstudio pinhole": ('{"fl_x": 1, "camera_model": "OPENCV"}', "OPENCV_FISHEYE"),
    "nerfstudio frames only": ('{"frames": []}', "OPENCV_FISHEYE"),
    "tangential": ('{"fl_x": 1, "camera_model": "OPENCV_FISHEYE", "p1": 1}', "tangential"),
    "gyroflow part": ('{"fisheye_params": 3}', "'fisheye_params'"),
    "gyroflow model": ('{"fisheye_params": {}, "distortion_model": "gopro"}', "opencv_fisheye"),
    "colmap numbers": ("1 OPENCV_FISHEYE 640 480 300 300", "8 parameters"),
    "colmap words": ("1 OPENCV_FISHEYE 640 480 a b c d e f g h", "could not convert"),
    "ocam cut": ("5 -100 0 0 0 0\n", "five records"),
    "ocam shear": ("1 -100\n1 1\n2 3\n1 0.1 0\n480 640", "shear"),
    "ocam backwards": ("1 100\n1 1\n2 3\n1 0 0\n480 640", "forward"),
    "ocam words": ("1 -100\n1 1\n2 x\n1 0 0\n480 640", "numbers in every line"),
    "long integer": ('{"fl_x": ' + "9" * 5000 + "}", "not a camera file|numbers"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_a_value_error_that_names_it(tmp_path, name):
    text, message = BAD[name]
    path = tmp_path / "camera.txt"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        read_lens(path)
    assert str(path) in str(caught.value)
    assert len(str(caught.value)) < 400 + len(str(path))


def test_no_text_is_no_camera_file(tmp_path):
    (tmp_path / "c.json").write_bytes(b"\xff\xfe{")
    with pytest.raises(ValueError, match="UTF-8"):
        read_lens(tmp_path / "c.json")


def test_a_yaml_bomb_costs_nothing(tmp_path):
    rows = ["a: &a [1,1,1,1,1,1,1,1,1]"]
    for before, after in zip("abcdefgh", "bcdefghi", strict=True):
        rows.append(f"{after}: &{after} [{','.join(['*' + before] * 9)}]")
    rows += ["D: *i", "K: *i", "e0: &e0 []", f"e1: &e1 [{','.join(['*e0'] * 999)}]"]
    rows += [f"image_size: [{','.join(['*e1'] * 999)}]"]
    start = time.process_time()
    with pytest.raises(ValueError, match="numbers"):
        lens_of("\n".join(rows))
    assert time.process_time() - start < 5


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_spoilt_files_give_a_lens_or_a_value_error(data):
    text = text_of(data.draw(st.sampled_from(sorted(FORMATS)[2:])))  # division is slow to make
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text)))
        length = data.draw(st.sampled_from([0, 1, 5, 50]))
        word = data.draw(st.sampled_from(["", "-", "0", "e9", "e999", "nan", "[", "{", ":", "\n"]))
        text = text[:at] + word + text[at + length :]
    try:
        lens = lens_of(text)
    except ValueError:
        return
    assert np.isfinite(lens.to_vector()).all()


# ---- the command line ----------------------------------------------------------------------------


@pytest.fixture
def lens_file(tmp_path) -> Path:
    write_camera(tmp_path / "lens.json", CameraFile(LENS, "ok", "made up", Quality()))
    return tmp_path / "lens.json"


def test_convert_tells_the_residual(tmp_path, lens_file, capsys):
    out = tmp_path / "new" / "calib_results.txt"
    arguments = ["convert", str(lens_file), "--out", str(out), "--format", "ocam"]
    assert run(arguments) == 0
    assert "px rms" in capsys.readouterr().out
    assert run([*arguments, "--json", "--overwrite"]) == 0
    told = json.loads(capsys.readouterr().out)["residual"]
    assert 0 < told["rms_px"] < told["max_px"] < 0.01
    assert conversion_residual(LENS, read_lens(out)).max_px < 0.01


def test_convert_goes_there_and_back(tmp_path, lens_file):
    chain, back = tmp_path / "chain.yaml", tmp_path / "back.json"
    assert run(["convert", str(lens_file), "--out", str(chain), "--format", "kalibr"]) == 0
    assert run(["convert", str(chain), "--out", str(back)]) == 0
    np.testing.assert_allclose(read_camera(back).camera.to_vector(), LENS.to_vector(), rtol=1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--format", "stmap", "--out", "map.png"], ".tif or .exr"),
        (["--format", "kalibr", "--out", "map.exr"], "camera.yaml"),
        (["--format", "matlab", "--out", "x"], "matlab"),
        (["--out", "lens.json", "--overwrite"], "is an input"),
        (["--out", "x.json", "--camera-name", "cam1"], "cam1"),
    ],
)
def test_misuse_of_convert_is_one_line(lens_file, monkeypatch, capsys, options, message):
    monkeypatch.chdir(lens_file.parent)
    assert run(["convert", "lens.json", *options]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert message in said


@pytest.mark.parametrize("kind", [*EXACT, "stmap"])
def test_rectify_takes_a_camera_of_any_format(tmp_path, lens_file, kind):
    rng = np.random.default_rng(1)
    coarse = rng.integers(0, 255, (15, 20, 3), np.uint8)
    picture = tmp_path / "a.png"
    cv2.imwrite(str(picture), cv2.resize(coarse, (640, 480)))
    other = tmp_path / f"other{format_suffix(kind)}"
    assert run(["convert", str(lens_file), "--out", str(other), "--format", kind]) == 0
    for camera, out in ((lens_file, "one"), (other, "two")):
        options = ["--camera", str(camera), "--out", str(tmp_path / out)]
        assert run(["rectify", str(picture), *options, "--format", "colmap"]) == 0
    one, two = (read_picture(tmp_path / out / "a.png").pixels for out in ("one", "two"))
    assert np.abs(one.astype(int) - two).max() <= 1
    assert (tmp_path / "two" / "a.camera.txt").read_text().count("OPENCV_FISHEYE") == 1

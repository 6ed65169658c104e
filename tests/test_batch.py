"""Batches: one lens a group, every picture told of, stopped and gone on with."""

import json
import os
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import ExifTags, Image, ImageCms

from classical.camera import KannalaBrandt, Pinhole
from hybrid import CameraFile, Quality, RectifyConfig, read_camera, read_picture, rectify
from hybrid import write_camera as write_camera_file
from hybrid.batch import Batch, BatchConfig
from hybrid.cli import run
from hybrid.exif import straight_exif

WIDTH, HEIGHT = 320, 240
LENS = KannalaBrandt.centred(np.array([0.95, -0.06, 0.004, 0.0, 0.0]), WIDTH, HEIGHT)
CLASSICAL = RectifyConfig(method="classical")
BASE = ExifTags.Base


@cache
def view(seed: int) -> np.ndarray:
    """Dark bars on a wall, seen through LENS from somewhere."""
    u, v = np.meshgrid(np.arange(2 * WIDTH) / 2 - 0.25, np.arange(2 * HEIGHT) / 2 - 0.25)
    x, y, z = LENS.unproject(np.stack([u.ravel(), v.ravel()], axis=1))[0].T
    rng = np.random.default_rng(seed)
    turn, slant = rng.uniform(-0.4, 0.4), rng.uniform(-0.3, 0.3)
    x, z = x * np.cos(turn) + z * np.sin(turn), z * np.cos(turn) - x * np.sin(turn)
    x, y = x / np.maximum(z, 1e-2), y / np.maximum(z, 1e-2)
    bars = (((x + slant * y) / 0.5 + rng.random()) % 1 < 0.25) | ((y / 0.4) % 1 < 0.2)
    grey = np.where(bars, 60.0, 190.0).reshape(HEIGHT, 2, WIDTH, 2).mean(axis=(1, 3))
    return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)


def exif_of(model: str = "A", focal: float = 8.0, **more: object) -> Image.Exif:
    exif = Image.Exif()
    exif[BASE.Make], exif[BASE.Model] = "Maker", model
    details = exif.get_ifd(ExifTags.IFD.Exif)
    details[BASE.FocalLength], details[BASE.LensModel] = focal, "Fish 8 mm"
    for name, value in more.items():
        exif[BASE[name]] = value
    return exif


def save(path: Path, pixels: np.ndarray, **options: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path, **options)
    return path


@pytest.fixture
def folder(tmp_path) -> Path:
    """Two pictures each of two cameras."""
    for seed, name in enumerate(["x/a.jpg", "x/b.jpg", "y/c.jpg", "y/deep/d.png"]):
        model = "A" if name[0] == "x" else "B"
        save(tmp_path / "in" / name, view(seed), exif=exif_of(model))
    return tmp_path / "in"


@pytest.fixture
def flat(tmp_path) -> Path:
    """Pictures that tell nothing, for when the lens does not matter."""
    for i in range(4):
        save(tmp_path / "in" / f"{i}.png", np.full((HEIGHT, WIDTH), 10 * i, np.uint8))
    return tmp_path / "in"


def do(folder: Path, out: Path, config: RectifyConfig = CLASSICAL, **how) -> dict[str, dict]:
    """All that a batch did, by picture."""
    with Batch(folder, out, config, BatchConfig(workers=how.pop("workers", 1), **how)) as batch:
        lenses = list(batch.find_lenses())
        done = {fields["input"]: fields for fields in batch.straighten()}
    return {fields["group"]: fields for fields in lenses} | done


def files(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


def states(folder: Path) -> dict[str, tuple[int, bytes]]:
    return {
        name: ((folder / name).stat().st_mtime_ns, (folder / name).read_bytes())
        for name in files(folder)
        if name != "manifest.jsonl"
    }


# ---- groups --------------------------------------------------------------------------------------


def test_exif_groups_share_a_lens(folder, tmp_path):
    done = do(folder, tmp_path / "out", group_by="exif")
    groups = [name for name in done if name.startswith("Maker")]
    assert groups == ["Maker A Fish 8 mm 8.00mm 320x240", "Maker B Fish 8 mm 8.00mm 320x240"]
    assert done["x/a.jpg"]["group"] == done["x/b.jpg"]["group"] == groups[0]
    lens = read_camera(tmp_path / "out" / done[groups[0]]["camera_file"]).camera
    for name in ("x/a.jpg", "x/b.jpg"):
        expected = rectify(read_picture(folder / name).pixels, CLASSICAL, camera=lens).image
        found = read_picture(tmp_path / "out" / name).pixels
        assert np.abs(found.astype(int) - expected).mean() < 2  # JPEG


def test_folder_groups_share_a_lens(folder, tmp_path):
    done = do(folder, tmp_path / "out", group_by="folder")
    groups = {done[name]["group"] for name in ("x/a.jpg", "y/c.jpg", "y/deep/d.png")}
    assert groups == {"x 320x240", "y 320x240", "y/deep 320x240"}


def test_without_groups_each_picture_tells_its_own_lens(folder, tmp_path):
    done = do(folder, tmp_path / "out", group_by="none")
    assert done["x/a.jpg"]["camera_file"] == "x/a.jpg.camera.json"
    lenses = {read_camera(path).camera for path in (tmp_path / "out").rglob("*.camera.json")}
    assert len(lenses) == 4


def test_pictures_without_exif_are_taken_alone(tmp_path):
    save(tmp_path / "in" / "a.png", view(0))
    done = do(tmp_path / "in", tmp_path / "out", group_by="exif")
    assert done["a.png"]["group"] == ""
    assert done["a.png"]["camera_file"] == "a.png.camera.json"


def test_a_turned_picture_is_grouped_by_how_it_is_shown(tmp_path):
    lying = np.rot90(view(0), 1)  # shown turned clockwise by 90 degrees
    save(tmp_path / "in" / "a.jpg", lying.copy(), exif=exif_of(Orientation=6))
    save(tmp_path / "in" / "b.jpg", view(1), exif=exif_of())
    done = do(tmp_path / "in", tmp_path / "out")
    assert done["a.jpg"]["group"] == done["b.jpg"]["group"]
    assert read_picture(tmp_path / "out" / "a.jpg").pixels.shape == (HEIGHT, WIDTH, 3)


def test_a_group_without_lines_fails_with_the_reason(flat, tmp_path):
    done = do(flat, tmp_path / "out", group_by="folder")
    assert {done[f"{i}.png"]["status"] for i in range(4)} == {"failed"}
    assert "no lens found for its group" in done["0.png"]["reason"]
    assert files(tmp_path / "out") == ["manifest.jsonl"]


def test_a_known_camera_needs_no_lines(flat, tmp_path):
    done = do(flat, tmp_path / "out", camera=LENS)
    assert list(done) == ["0.png", "1.png", "2.png", "3.png"]
    assert {fields["status"] for fields in done.values()} == {"ok"}


def test_processes_do_the_same(folder, tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    do(folder, one)
    do(folder, two, workers=2)
    assert files(one) == files(two)
    for name in files(one):
        if name.endswith((".jpg", ".png")):
            assert (one / name).read_bytes() == (two / name).read_bytes()


# ---- what stays with a picture -------------------------------------------------------------------


def test_exif_and_profile_are_kept_and_the_lens_is_told(tmp_path):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    options = {"exif": exif_of(Artist="Me"), "icc_profile": profile}
    save(tmp_path / "in" / "a.jpg", view(0), **options)
    do(tmp_path / "in", tmp_path / "out", camera=LENS)
    with Image.open(tmp_path / "out" / "a.jpg") as image:
        assert image.info["icc_profile"] == profile
        exif = image.getexif()
        details = exif.get_ifd(ExifTags.IFD.Exif)
    assert exif[BASE.Artist] == "Me"
    assert details[BASE.LensModel] == "Fish 8 mm (rectilinear by Straightlens)"


def test_focal_lengths_are_those_of_the_straight_picture():
    target = Pinhole.centred(500.0, 1000, 800)
    lens = KannalaBrandt.centred(np.array([0.8, 0.0, 0.0, 0.0, 0.0]), 2000, 1600)  # f = 800 px
    exif = straight_exif(exif_of().tobytes(), lens, target)
    assert exif is not None
    data = Image.Exif()
    data.load(exif)
    details = data.get_ifd(ExifTags.IFD.Exif)
    # on a sensor of the same width: 500 / 1000 of it, where 8 mm were 800 / 2000
    assert float(details[BASE.FocalLength]) == pytest.approx(10.0)
    assert details[BASE.FocalLengthIn35mmFilm] == round(500 * 43.2666 / np.hypot(1000, 800))
    assert (details[BASE.ExifImageWidth], details[BASE.ExifImageHeight]) == (1000, 800)
    again = straight_exif(exif, lens, target)
    assert again is not None
    assert again.count(b"rectilinear") == 1


def test_broken_exif_stays_as_it_is():
    target = Pinhole.centred(500.0, 1000, 800)
    assert straight_exif(None, LENS, target) is None
    assert straight_exif(b"Exif\0\0nonsense", LENS, target) == b"Exif\0\0nonsense"


def test_rectify_tells_the_lens_too(folder, tmp_path):
    assert run(["rectify", str(folder / "x"), "--out", str(tmp_path / "o")]) == 0
    with Image.open(tmp_path / "o" / "a.jpg") as image:
        assert "rectilinear" in image.getexif().get_ifd(ExifTags.IFD.Exif)[BASE.LensModel]


# ---- going on ------------------------------------------------------------------------------------


def test_what_is_done_is_left_alone(folder, tmp_path):
    out = tmp_path / "out"
    do(folder, out)
    before = states(out)
    assert do(folder, out) == {}
    assert states(out) == before


def test_only_what_is_missing_is_done(folder, tmp_path):
    out = tmp_path / "out"
    do(folder, out)
    before = states(out)
    (out / "x" / "a.jpg").unlink()  # lost
    save(folder / "y" / "c.jpg", view(7), exif=exif_of("B"))  # changed
    save(folder / "x" / "new.jpg", view(8), exif=exif_of("A"))  # added
    assert list(do(folder, out)) == ["x/a.jpg", "x/new.jpg", "y/c.jpg"]  # and no lens anew
    after = states(out)
    for name in before.keys() - {"x/a.jpg", "y/c.jpg"}:
        assert after[name] == before[name]
    assert after["x/a.jpg"][1] == before["x/a.jpg"][1]
    assert after["y/c.jpg"][1] != before["y/c.jpg"][1]


@pytest.mark.parametrize("n_cut", [1, 20, 400])
def test_a_manifest_that_was_cut_off_is_gone_on_with(flat, tmp_path, n_cut):
    out = tmp_path / "out"
    do(flat, out, camera=LENS)
    whole = (out / "manifest.jsonl").read_bytes()
    (out / "manifest.jsonl").write_bytes(whole[:-n_cut])
    done = do(flat, out, camera=LENS)
    assert "3.png" in done
    assert "0.png" not in done
    lines = (out / "manifest.jsonl").read_text().splitlines()
    inputs = [json.loads(line).get("input") for line in lines]
    assert inputs == [None, "0.png", "1.png", "2.png", "3.png"]


def test_failures_are_told_and_tried_again(folder, tmp_path, capsys):
    out = tmp_path / "out"
    (folder / "x" / "bad.jpg").write_text("no picture")
    arguments = ["batch", str(folder), "--out", str(out), "--workers", "1"]
    arguments += ["--method", "classical"]
    assert run(arguments) == 1
    said = capsys.readouterr()
    assert said.err.count("\n") == 1
    assert "x/bad.jpg: not a" in said.err
    assert "5 pictures" in said.out
    assert "4 ok, 0 degraded, 1 failed" in said.out
    before = states(out)
    save(folder / "x" / "bad.jpg", view(9), exif=exif_of("A"))
    assert run([*arguments, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["output"] == str(out / "x" / "bad.jpg")
    assert before.items() <= states(out).items()


def test_other_settings_are_refused_and_overwrite_begins_again(flat, tmp_path):
    out = tmp_path / "out"
    do(flat, out, camera=LENS)
    with pytest.raises(ValueError, match=r"fov None instead of 80\.0"):
        do(flat, out, RectifyConfig(method="classical", fov=80.0), camera=LENS)
    done = do(
        flat, out, RectifyConfig(method="classical", size=(64, 48)), camera=LENS, overwrite=True
    )
    assert len(done) == 4
    assert read_picture(out / "0.png").pixels.shape == (48, 64)


def test_two_batches_do_not_work_in_one_folder(flat, tmp_path):
    pytest.importorskip("fcntl")
    how = BatchConfig(camera=LENS, workers=1)
    with (
        Batch(flat, tmp_path / "out", CLASSICAL, how),
        pytest.raises(ValueError, match="another batch is at work"),
    ):
        Batch(flat, tmp_path / "out", CLASSICAL, how)
    assert len(do(flat, tmp_path / "out", camera=LENS)) == 4


# ---- what must not be lost -----------------------------------------------------------------------


def test_files_that_no_batch_made_are_not_replaced(flat, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "1.png").write_text("precious")
    with pytest.raises(ValueError, match="--overwrite"):
        do(flat, tmp_path / "out", camera=LENS)
    assert files(tmp_path / "out") == ["1.png"]


@pytest.mark.parametrize("out", [".", "..", "../in"])
def test_results_never_lie_among_the_pictures(flat, out):
    with pytest.raises(ValueError, match="among the pictures"):
        Batch(flat, flat / out, CLASSICAL)


def test_results_below_the_pictures_are_not_taken_for_pictures(flat):
    first = do(flat, flat / "straight", camera=LENS)
    assert len(first) == 4
    assert do(flat, flat / "straight", camera=LENS) == {}


def test_a_foreign_manifest_is_refused(flat, tmp_path):
    (tmp_path / "out").mkdir()
    for text in ("hello", "hello\n", '{"kind": "picture", "input": "a"}\n', "[1]\n"):
        (tmp_path / "out" / "manifest.jsonl").write_text(text)
        with pytest.raises(ValueError, match="no manifest"):
            do(flat, tmp_path / "out", camera=LENS)
        assert (tmp_path / "out" / "manifest.jsonl").read_text() == text


def test_linked_folders_are_not_followed_and_names_cannot_break_lines(flat, tmp_path, capsys):
    (flat / "loop").symlink_to(flat)
    (flat / "evil\n\x1b[31m.png").write_text("no picture")
    write_camera_file(tmp_path / "lens.json", CameraFile(LENS, "ok", "", Quality()))
    options = ["--out", str(tmp_path / "out"), "--camera", str(tmp_path / "lens.json")]
    assert run(["batch", str(flat), *options, "--workers", "1"]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "\x1b" not in said
    assert "evil\\n" in said
    assert files(tmp_path / "out") == ["0.png", "1.png", "2.png", "3.png", "manifest.jsonl"]


def test_names_that_are_no_text_are_done(flat, tmp_path):
    (flat / "0.png").rename(flat / os.fsdecode(b"\xff.png"))
    done = do(flat, tmp_path / "out", camera=LENS)
    assert {fields["status"] for fields in done.values()} == {"ok"}
    assert do(flat, tmp_path / "out", camera=LENS) == {}


# ---- misuse --------------------------------------------------------------------------------------


@pytest.fixture
def here(flat, monkeypatch) -> Path:
    monkeypatch.chdir(flat.parent)
    (flat.parent / "empty").mkdir()
    return flat.parent


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none", "--out", "x"], "none"),
        (["in"], "--out"),
        (["empty", "--out", "x"], "no pictures"),
        (["in", "--out", "in"], "among the pictures"),
        (["in", "--out", "x", "--group-by", "colour"], "colour"),
        (["in", "--out", "x", "--sample", "0"], "0"),
        (["in", "--out", "x", "--workers", "0"], "0"),
        (["in", "--out", "x", "--fov", "200"], "175"),
        (["in", "--out", "x", "--camera", "in/0.png"], "camera file"),
    ],
)
def test_misuse_is_one_line_and_code_two(here, capsys, arguments, message):
    assert run(["batch", *arguments]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1, said
    assert message in said
    assert sorted(path.name for path in here.iterdir()) == ["empty", "in"]

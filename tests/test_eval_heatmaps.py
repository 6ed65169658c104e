"""The sheet of heatmaps: what is seen lies where it is, and bad input is told on one line."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from eval import heatmaps
from eval.heatmaps import Cell, overlay, sheet
from hybrid.cli import run
from hybrid.images import read_picture

ROOM = Path(__file__).parents[1] / "examples" / "room.jpg"


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    folder = tmp_path / "photos"
    folder.mkdir()
    with Image.open(ROOM) as room:
        small = room.convert("RGB").resize((320, 240))
        small.save(folder / "a.jpg")
        small.rotate(90, expand=True).save(folder / "b.png")
        small.convert("L").save(folder / "c.png")
    return folder


def test_the_photograph_is_dim_and_grey_but_for_the_heat():
    photo = np.full((300, 400, 3), (200, 100, 50), np.uint8)
    heat = np.zeros((30, 40), np.float32)
    heat[:, 20:] = 1.0
    seen = overlay(photo, heat).astype(int)
    assert max(seen.shape) == heatmaps._SIDE  # pyright: ignore[reportPrivateUsage]
    cold, hot = seen[:, :200], seen[:, 230:]
    assert np.ptp(cold, axis=2).max() == 0
    assert cold.max() < 80
    assert np.ptp(hot, axis=2).min() > 100  # yellow
    assert hot.sum(axis=2).min() > 2 * cold.sum(axis=2).max()


def test_more_heat_is_brighter_for_every_eye():
    heat = np.tile(np.linspace(0, 1, 64, dtype=np.float32), (48, 1))
    row = overlay(np.full((48, 64, 3), 90, np.uint8), heat)[100]
    luminance = row @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luminance[20:]) > -2.0).all()


def test_photographs_are_laid_out_in_rows():
    cells = [Cell(name, np.full((210, 420, 3), 7, np.uint8)) for name in "abcde"]
    wide, narrow = sheet(cells, 3), sheet(cells, 2)
    assert wide.shape[1] > narrow.shape[1]
    assert wide.shape[0] < narrow.shape[0]
    for page in (wide, narrow):
        assert (page == 7).all(axis=2).sum() >= 5 * 210 * 420
    assert sheet(cells[:1], 12).shape[1] < wide.shape[1]


def test_long_names_lose_their_middle():
    short = heatmaps._shortened("a" * 200 + ".jpg")  # pyright: ignore[reportPrivateUsage]
    assert 20 < len(short) < 120
    assert short.endswith("a.jpg")
    assert "…" in short
    assert heatmaps._shortened("room.jpg") == "room.jpg"  # pyright: ignore[reportPrivateUsage]


def test_files_and_folders_become_one_sheet(photos, tmp_path, capsys):
    out = tmp_path / "sheet.png"
    assert run(["heatmaps", str(photos), str(ROOM), "--out", str(out), "--columns", "2"]) == 0
    assert capsys.readouterr().out == f"{out}\n"
    page = read_picture(out).pixels.astype(int)
    left, right = page[:, : page.shape[1] // 2], page[:, page.shape[1] // 2 :]
    # the lines of the room are seen in each half, in greens and yellows
    assert all((half[..., 1] - half[..., 0] > 60).mean() > 0.005 for half in (left, right))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["photos", "sheet.png"]


def test_a_broken_picture_is_told_and_the_others_are_shown(photos, tmp_path, capsys):
    (photos / "b.png").write_bytes(b"nothing")
    out = tmp_path / "sheet.jpg"
    assert run(["heatmaps", str(photos), "--out", str(out)]) == 1
    said = capsys.readouterr()
    assert "b.png" in said.out + said.err
    assert "a.jpg" not in said.out + said.err
    assert read_picture(out).pixels.shape[1] > 2 * 420


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("photos --out sheet.txt", 2, "got sheet.txt"),
        ("photos --out photos/a.jpg --overwrite", 2, "is an input"),
        ("photos --out there.png", 2, "--overwrite"),
        ("photos --out sheet.png --columns 0", 2, "0 is not in the range"),
        ("photos --out sheet.png --weights none", 1, "expected weights among"),
        ("empty --out sheet.png", 2, "no pictures in the folder"),
        ("broken --out sheet.png", 1, "expected a picture that can be read"),
    ],
)
def test_what_makes_no_sheet_is_one_line(photos, monkeypatch, capsys, words, code, message):
    monkeypatch.chdir(photos.parent)
    Path("there.png").touch()
    Path("empty").mkdir()
    Path("broken").mkdir()
    Path("broken/x.png").write_bytes(b"nothing")
    assert run(["heatmaps", *words.split()]) == code
    said = capsys.readouterr().err.splitlines()
    assert message in said[-1]
    assert not Path("sheet.png").exists()


def test_a_sheet_has_an_end(photos, monkeypatch, capsys):
    monkeypatch.setattr("eval.heatmaps._MOST", 2)
    assert run(["heatmaps", str(photos), "--out", str(photos.parent / "sheet.png")]) == 2
    assert "up to 2 pictures on a sheet, got 3" in capsys.readouterr().err

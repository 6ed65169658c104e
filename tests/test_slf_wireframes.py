"""Annotation files of the wireframe dataset are read as they are published, and nothing else is."""

import json
import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.io import savemat

from learned.slf.commands import synthesize as command
from learned.slf.pack import annotated_photograph
from learned.slf.suite import SuiteFolder
from learned.slf.wireframes import Photograph, wireframe_segments, with_annotations

POINTS = np.array([[10.5, 20.5], [190.5, 20.5], [100.5, 140.5]])
PAIRS = [(2, 0), (0, 1)]
EXPECTED = np.array([[10, 20, 190, 20], [100, 140, 10, 20]])  # longest first, centres at (0, 0)
LINES = [POINTS[list(pair)].ravel().tolist() for pair in PAIRS]


def write_pickle(folder: Path, name: str) -> None:
    # what the dataset's own files hold, in the protocol of Python 2
    record = {
        "imgname": f"{name}.jpg",
        "img": np.zeros((4, 4, 3), np.uint8),
        "points": [tuple(point) for point in POINTS],
        "lines": PAIRS,
        "pointlines": [[(0, 1)]],
        "pointlines_index": [[0]],
        "junction": np.zeros((1, 2)),
        "theta": [[np.float64(0.5)]],
    }
    data = pickle.dumps(record, protocol=2)
    (folder / f"{name}.pkl").write_bytes(data.replace(b"numpy._core", b"numpy.core"))


def write_matlab(folder: Path, name: str) -> None:
    savemat(folder / f"{name}_line.mat", {"lines": np.array(LINES)})


def write_list(folder: Path, name: str) -> None:
    entry = {"filename": f"{name}.png", "height": 160, "width": 220, "lines": LINES}
    (folder / "train.json").write_text(json.dumps([entry]))


WRITERS = {"pickle": write_pickle, "matlab": write_matlab, "list": write_list}


@pytest.fixture(params=WRITERS)
def dataset(request, tmp_path) -> Path:
    """A photograph without any edge, and its annotation in another folder."""
    for name in ("images", "annotation"):
        (tmp_path / name).mkdir()
    cv2.imwrite(str(tmp_path / "images" / "0001.png"), np.full((160, 220, 3), 90, np.uint8))
    WRITERS[request.param](tmp_path / "annotation", "0001")
    return tmp_path


def photograph_of(dataset: Path) -> Photograph:
    return with_annotations([dataset / "images" / "0001.png"], dataset)[0]


def test_lines_are_read_longest_first(dataset):
    np.testing.assert_allclose(wireframe_segments(photograph_of(dataset)), EXPECTED)


def test_lines_shrink_with_the_photograph(dataset):
    half = annotated_photograph(photograph_of(dataset), longest=110)
    np.testing.assert_allclose(half.segments, (EXPECTED + 0.5) / 2 - 0.5)


def test_photographs_without_a_file_are_left_to_the_detector(dataset):
    assert with_annotations([dataset / "images" / "0002.png"], dataset)[0].annotation is None


def test_a_set_bends_the_annotated_lines(dataset):
    out = dataset / "set"
    words = ["dwireframe", "--photos", dataset, "--out", out, "--size", 64]
    result = CliRunner().invoke(command, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    items = list(SuiteFolder(out))
    assert len(items) == 8  # lenses a photograph
    assert len({item.camera for item in items}) == 8
    assert all(2 <= len(item.curves) <= 4 for item in items)  # the frame may cut one
    assert SuiteFolder(out).header()["settings"]["annotated"] == 1


class Nasty:
    def __reduce__(self):
        return (print, ("run by the file",))


@pytest.mark.parametrize(
    "data",
    [pickle.dumps({"points": Nasty(), "lines": []}), pickle.dumps({"points": []}), b"", b"no"],
    ids=["code", "no lines", "empty", "no pickle"],
)
def test_other_pickles_are_refused(data, tmp_path, capsys):
    file = tmp_path / "0001.pkl"
    file.write_bytes(data)
    with pytest.raises(ValueError, match=r"0001\.pkl"):
        wireframe_segments(Photograph(tmp_path / "0001.png", file))
    assert capsys.readouterr().out == ""


def test_a_broken_annotation_ends_the_command_in_one_line(dataset):
    (dataset / "images" / "0001.pkl").write_bytes(b"no pickle")
    words = ["dwireframe", "--photos", dataset, "--out", dataset / "set", "--workers", 1]
    result = CliRunner().invoke(command, [str(word) for word in words])
    assert result.exit_code == 1
    assert "0001.pkl" in result.output

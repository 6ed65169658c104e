from pathlib import Path

import numpy as np
import pytest

from learned.larecnet import LaRecNet
from learned.predictor import Predictor, RongPredictor
from learned.rong import RongNet
from learned.weights import load_weights, located, packaged

KINDS = {"compact": LaRecNet, "compact-wf": LaRecNet, "rong-compact": RongNet}


@pytest.fixture(scope="module")
def predictor() -> Predictor:
    return Predictor.from_weights()


def _room() -> np.ndarray:
    """A bright wall between two dark ones, with bowed edges, under an even ceiling."""
    v, u = np.mgrid[:240, :320].astype(np.float64)
    bow = 12.0 * (1.0 - ((v - 120) / 120) ** 2)
    wall = (u > 90 - bow) & (u < 230 + bow)
    grey = np.where(wall, 190, 90).astype(np.uint8)
    noise = np.random.default_rng(0).normal(0, 2, grey.shape)
    return np.clip(np.stack([grey] * 3, -1) + noise[..., None], 0, 255).astype(np.uint8)


@pytest.mark.parametrize("name", KINDS)
def test_packaged_weights_pass_their_checksum_and_say_what_they_are(name: str) -> None:
    path = packaged(name)
    assert path.with_suffix(".sha256").exists()
    assert path.with_suffix(".md").exists()
    assert path.stat().st_size < 20e6
    loaded = load_weights(path, KINDS[name])
    assert {"data", "commit", "scores"} <= loaded.card.keys()


@pytest.mark.parametrize("name", KINDS)
def test_a_bare_name_is_one_of_the_weights_that_ship(name: str) -> None:
    assert located(name, "compact") == packaged(name)
    assert located(None, name) == packaged(name)


@pytest.mark.parametrize("path", ["mine.safetensors", "runs/compact", "./compact"])
def test_what_is_no_bare_name_is_a_path(path: str) -> None:
    assert located(path, "compact") == Path(path)


def test_an_unknown_name_is_told_with_those_that_ship() -> None:
    with pytest.raises(FileNotFoundError) as caught:
        Predictor.from_weights("enormous")
    assert str(caught.value) == f"expected weights among {sorted(KINDS)}, got 'enormous'"


def test_a_path_without_a_file_is_told(tmp_path: Path) -> None:
    path = tmp_path / "mine.safetensors"
    with pytest.raises(FileNotFoundError, match=r"mine.*, which is not there"):
        Predictor.from_weights(path)


def test_bowed_edges_of_a_wall_are_found_and_even_faces_are_not(predictor: Predictor) -> None:
    lineness = predictor.lines(_room(), longest=320).lineness
    for row in range(40, 200, 20):
        bow = 12.0 * (1.0 - ((row - 120) / 120) ** 2)
        for edge in (90 - bow, 230 + bow):
            near = lineness[row, int(edge) - 3 : int(edge) + 4]
            assert near.max() > 0.5
    assert np.median(lineness[30:210, 120:200]) < 0.1


def test_estimated_lens_is_a_camera_with_a_spread(predictor: Predictor) -> None:
    found = predictor.lens(_room())
    assert found.camera is not None
    assert 0.3 < found.camera.k[0] < 3.0
    assert abs(found.camera.u0 - 159.5) < 40
    assert found.covariance is not None
    assert np.sqrt(found.covariance[0, 0]) < 1.0


def test_rong_calls_a_bowed_wall_barrel_distorted() -> None:
    assert RongPredictor.from_weights().lens(_room()).lambda_ < 0

"""The ablation study: what is trained once, kept small, and compared with the paper's order."""

import csv
import dataclasses
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner, Result
from safetensors import safe_open
from small_networks import SMALL, SMALL_DLP, write_small_pack

from classical.camera import KannalaBrandt
from eval import ablation
from eval.ablate_command import ablate
from eval.ablation import PERCEPTION, STUDIES, Variant, load_variant
from eval.ablation_table import Row, swaps, to_markdown
from eval.methods import method_of
from eval.published import PublishedRow
from eval.summary import MethodScores, SuiteScores
from learned.dlp import LinePerception
from learned.jobs import WEIGHTS
from learned.predictor import Predictor
from learned.presets import COMPACT
from learned.slf.suite import SuiteCurve, SuiteFolder, SuiteItem
from learned.weights import load_weights, save_weights

CAMERA = KannalaBrandt(np.array([1.1, -0.05, 0.0, 0.0, 0.0]), 80.0, 80.0, 79.5, 79.5, 160, 160)
TINY = dataclasses.replace(
    COMPACT,
    network=dataclasses.replace(
        SMALL, calibration=dataclasses.replace(SMALL.calibration, covariance=False), pixel_stride=4
    ),
)
BUDGET = ["--steps", "2", "--batch", "4", "--size", "64", "--ahead", "8", "--threads", "1", "--cpu"]
BL1, BL6 = STUDIES["parts"][0], STUDIES["parts"][5]


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    torch.set_num_threads(1)
    monkeypatch.setattr("eval.ablation.narrowed", lambda _: TINY)


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small_pack(tmp_path_factory.mktemp("packs") / "tiny.pack")


@pytest.fixture(scope="module")
def init(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lines") / "dlp.safetensors"
    torch.manual_seed(3)
    save_weights(path, LinePerception(SMALL_DLP), {})
    return path


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = SuiteFolder(tmp_path_factory.mktemp("sets") / "drawn")
    folder.begin({"kind": "test", "name": "drawn", "note": "Noise with a line.", "settings": {}})
    line = np.column_stack([np.linspace(-1, 1, 60), np.full(60, 0.5), np.ones(60)])
    points, _ = CAMERA.project(line)
    for index in range(2):
        picture = np.random.default_rng(index).integers(0, 256, (160, 160, 3)).astype(np.uint8)
        item = SuiteItem(index, CAMERA, 1.2, (SuiteCurve(points, line[[0, -1]], 120.0),), "noise")
        folder.write(item, picture, picture, picture[..., 0])
    return folder.path


Command = Callable[..., Result]


@pytest.fixture
def run(pack: Path, init: Path, suite: Path, tmp_path: Path) -> Command:
    """Runs the command in a folder of its own; `trained=False` leaves the pack out."""

    def call(*words: str, trained: bool = True) -> Result:
        training = ["--data", str(pack), "--init", str(init), *BUDGET] if trained else []
        place = ["--suite", str(suite), "--out", str(tmp_path / "study")]
        return CliRunner().invoke(ablate, [*training, *place, *words])

    return call


@pytest.fixture
def trainings(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the presets that are trained from now on; "stop" in it stops the next one."""
    real, names = ablation.run_job, []

    def counted(job, **options):
        if "stop" in names:
            raise KeyboardInterrupt
        names.append(job.preset.name)
        return real(job, **options)

    monkeypatch.setattr("eval.ablation.run_job", counted)
    return names


def test_study_is_trained_once_and_its_table_needs_no_pack(
    run: Command, trainings: list[str], tmp_path: Path
) -> None:
    out = tmp_path / "study"
    first = run("--variants", "BL1,BL6")
    assert first.exit_code == 0, first.output
    assert trainings == ["compact-BL1", "compact-BL6"]
    text = (out / "table.md").read_text()
    row = next(line for line in text.splitlines() if line.startswith("| BL1: I_f |"))
    assert row.endswith("| 4.51 | 16.24 | 0.61 |")
    assert "of 1 pairs differ" in text or "in all 1 pairs" in text
    assert len(list((out / "work" / "samples").iterdir())) == 1

    again = run("--variants", "BL1,BL6")
    assert again.exit_code == 0, again.output
    assert len(trainings) == 2
    (out / "table.md").unlink()
    alone = run(trained=False)
    assert alone.exit_code == 0, alone.output
    assert (out / "table.md").read_text() == text
    rows = list(csv.DictReader((out / "table.csv").read_text().splitlines()))
    assert [(r["study"], r["variant"], r["pictures"]) for r in rows] == [
        ("parts", BL1.name, "2"),
        ("parts", BL6.name, "2"),
    ]


def test_stopped_study_goes_on_where_it_was(run: Command, trainings: list[str]) -> None:
    assert run("--variants", "BL2").exit_code == 0
    trainings.append("stop")
    assert run("--variants", "BL2,BL4").exit_code != 0
    trainings.clear()
    assert run("--variants", "BL2,BL4").exit_code == 0
    assert trainings == ["compact-BL4"]


def test_kept_weights_are_the_calibration_alone_and_give_the_whole_network(
    run: Command, init: Path, tmp_path: Path
) -> None:
    assert run("--variants", "BL6").exit_code == 0
    out = tmp_path / "study"
    kept = out / "BL6" / "seed-1"
    with safe_open(kept / WEIGHTS, framework="pt") as file:
        assert not [name for name in file.keys() if name.startswith("dlp.")]  # noqa: SIM118
    assert json.loads((kept / "log.jsonl").read_text().splitlines()[-1])["step"] == 2
    again = load_variant(BL6, 1, out).network.state_dict()
    whole = Predictor.from_weights(out / "work" / "BL6-seed1" / WEIGHTS).network.state_dict()
    assert set(again) == set(whole)
    for name, value in whole.items():
        assert torch.equal(again[name], value), name
    seen = load_weights(init, LinePerception).network.state_dict()
    for name, value in load_weights(out / PERCEPTION, LinePerception).network.state_dict().items():
        assert torch.equal(value, seen[name]), name


def test_folder_keeps_to_one_budget(run: Command, trainings: list[str]) -> None:
    assert run("--variants", "BL1").exit_code == 0
    other = run("--variants", "BL2", "--steps", "3")
    assert other.exit_code != 0
    assert "steps 2 not 3" in str(other.exception)
    assert trainings == ["compact-BL1"]


def test_whole_network_of_both_studies_is_trained_once(
    run: Command, trainings: list[str], tmp_path: Path
) -> None:
    words = ("--study", "parts", "--study", "data", "--variants", "BL6,SLF", "--seeds", "1,2")
    result = run(*words)
    assert result.exit_code == 0, result.output
    assert trainings == ["compact-BL6"] * 4
    text = (tmp_path / "study" / "table.md").read_text()
    assert "SLF_wf: planes" in text
    assert "SLF: planes, boxes, panoramas" in text
    assert "±" in text


@pytest.mark.parametrize("words", [("--variants", "BL7"), ("--seeds", "one")])
def test_misuse_is_refused_before_anything_is_trained(
    run: Command, trainings: list[str], words: tuple[str, str]
) -> None:
    assert run(*words).exit_code == 2
    assert not trainings


def test_help_comes_without_torch() -> None:
    words = "import sys, eval.ablate_command; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", words], check=False).returncode == 0


def test_table_of_an_empty_folder_is_refused(run: Command) -> None:
    result = run(trained=False)
    assert result.exit_code != 0
    assert "expected trained variants" in str(result.exception)


def _row(name: str, paper: float, *rpe: list[float]) -> Row:
    each = {
        seed: {"rpe": np.array(values), "psnr": np.full(4, 20.0), "ssim": np.full(4, 0.5)}
        for seed, values in enumerate(rpe, start=1)
    }
    return Row(name, PublishedRow(name, 1.0, 0.1, None, paper), each)


def test_pairs_in_another_order_are_named_with_their_errors() -> None:
    rows = [
        _row("first", 3.0, [4.0, 4.0, 4.0, 4.0], [5.0, 5.0, 5.0, 5.0]),
        _row("second", 2.0, [1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0]),
        _row("third", 1.0, [1.0, 2.0, 2.0, 3.0], [2.0, 3.0, 3.0, 4.0]),
    ]
    (swap,) = swaps(rows)
    assert (swap.worse.name, swap.better.name) == ("second", "third")
    assert swap.gap == pytest.approx(1.5)
    # gaps of the pictures, over the seeds: 0.5 1.5 1.5 2.5, so sd = sqrt(2/3), over sqrt(4)
    assert swap.error == pytest.approx(np.sqrt(2 / 3) / 2)
    # of the seeds: 1 and 2
    assert swap.spread == pytest.approx(np.sqrt(0.5))
    assert swaps(rows[:2]) == []


def test_table_says_what_the_order_is() -> None:
    record = {"status": "ok", "paper": {"rpe": 1.0, "psnr": 20.0, "ssim": 0.5}}
    scores = MethodScores(method_of("bl1"), (record,))
    suite = SuiteScores({"suite": {"name": "drawn"}}, ("a",), (scores,))
    ordered = [_row("first", 3.0, [4.0] * 4), _row("second", 2.0, [1.0] * 4)]
    assert "the paper's, in all 1 pairs" in to_markdown("Parts", suite, ordered)
    turned = [_row("first", 3.0, [1.0] * 4), _row("second", 2.0, [4.0] * 4)]
    text = to_markdown("Parts", suite, turned)
    assert "1 of 1 pairs differ" in text
    assert "first and second: 1.00 and 4.00 px, in the paper 3 and 2 px" in text


def test_every_training_has_a_folder_of_its_own() -> None:
    known = {v.trained: v for study in STUDIES.values() for v in study}
    of_scenes: dict[tuple, set[str]] = {}
    for variant in known.values():
        assert isinstance(variant, Variant)
        of_scenes.setdefault((variant.level, variant.scenes), set()).add(variant.trained)
    assert all(len(names) == 1 for names in of_scenes.values())

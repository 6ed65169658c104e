import dataclasses
from pathlib import Path

import pytest
import torch
from click.testing import CliRunner
from small_networks import SMALL, SMALL_RONG, write_small_pack

from hybrid.cli import run
from learned.commands import train as train_command
from learned.dlp import LinePerception
from learned.jobs import JobCfg, Target, run_job
from learned.larecnet import LaRecNet
from learned.presets import COMPACT, Preset
from learned.rong import RongNet
from learned.slf.atlas import load_atlas
from learned.slf.batch import SlfBatch
from learned.slf.stream import SlfStream, StreamCfg
from learned.train import RunCfg
from learned.weights import load_weights

TINY: Preset = dataclasses.replace(COMPACT, network=SMALL, rong=SMALL_RONG)


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small_pack(tmp_path_factory.mktemp("packs") / "tiny.pack")


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    torch.set_num_threads(1)
    monkeypatch.setattr("learned.jobs._TEMPERATURE_BATCHES", 1)


def _job(target: Target, pack: Path, folder: Path, init: Path | None = None) -> JobCfg:
    return JobCfg(
        target=target,
        preset=TINY,
        pack=pack,
        validation=pack,
        folder=folder,
        steps=2,
        batch_size=2,
        size=64,
        init=init,
        validation_batches=1,
        run=RunCfg(steps=2, workers=0, log_every=1),
    )


def test_phase_two_starts_from_phase_one_and_leaves_it_alone(pack: Path, tmp_path: Path) -> None:
    first = run_job(_job("dlp", pack, tmp_path / "dlp"), resume=False, cpu=True, progress=False)
    second = run_job(
        _job("larecnet", pack, tmp_path / "lare", first), resume=False, cpu=True, progress=False
    )
    seen = load_weights(first, LinePerception).network.state_dict()
    found = load_weights(second, LaRecNet)
    for name, value in found.network.dlp.state_dict().items():
        assert torch.equal(value, seen[name]), name
    assert found.network.cfg.frame == 64
    assert found.card["init"] == first.name
    assert "rpe_mean" in found.card["scores"]


def test_training_goes_on_from_finished_weights(pack: Path, tmp_path: Path) -> None:
    first = run_job(_job("rong", pack, tmp_path / "a"), resume=False, cpu=True, progress=False)
    again = run_job(
        _job("rong", pack, tmp_path / "b", first), resume=False, cpu=True, progress=False
    )
    assert isinstance(load_weights(again, RongNet).network, RongNet)


@pytest.mark.slow
def test_command_trains_the_compact_preset(pack: Path, tmp_path: Path) -> None:
    words = ["dlp", "--data", str(pack), "--out", str(tmp_path), "--steps", "1", "--batch", "2"]
    result = CliRunner().invoke(
        train_command, [*words, "--size", "64", "--workers", "0", "--threads", "1", "--cpu"]
    )
    assert result.exit_code == 0, result.output
    assert Path(result.stdout.strip()).exists()


def test_command_trains_on_the_scenes_it_was_given(
    pack: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    batches: list[SlfBatch] = []

    def one_batch(_network, _phase, source, *_arguments, **_options):
        batches.append(source(0))
        raise KeyboardInterrupt

    monkeypatch.setattr("learned.jobs.train", one_batch)
    words = ["rong", "--data", str(pack), "--out", str(tmp_path), "--steps", "1", "--batch", "4"]
    scenes = [
        "--scenes",
        "0.25",
        "1",
        "0",
        "0",
        "--wild",
        "0.125",
        "--straight",
        "0.5",
        "--size",
        "64",
        "--cpu",
    ]
    CliRunner().invoke(train_command, [*words, *scenes])
    given = StreamCfg(
        scenes=(0.25, 1.0, 0.0, 0.0), wild_share=0.125, straight_share=0.5, with_rectified=False
    )
    expected = SlfStream(load_atlas(pack), 1, 4, 64, given).batch(0)
    assert torch.equal(batches[0].image, expected.image)
    assert torch.equal(batches[0].k, expected.k)


def test_command_transposes_so_many_of_the_batches_made_ahead(
    pack: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[float] = []

    def listen(_network, _phase, source, *_arguments, **_options):
        found.append(source.upright)
        raise KeyboardInterrupt

    monkeypatch.setattr("learned.jobs.train", listen)
    words = ["rong", "--data", str(pack), "--out", str(tmp_path), "--steps", "1", "--batch", "4"]
    words += ["--size", "32", "--cpu", "--scenes", "1", "0", "0", "0", "--upright", "0.25"]
    refused = CliRunner().invoke(train_command, words)
    assert refused.exit_code == 2
    assert "--upright is for samples made ahead" in refused.output
    CliRunner().invoke(train_command, [*words, "--ahead", "8"])
    assert found == [0.25]


@pytest.mark.parametrize(
    ("scenes", "code", "message"),
    [
        ("2 0 0 0", 2, "2.0 is not in the range"),
        ("a 0 0 0", 2, "'a' is not a valid"),
        ("1 0 0", 2, "requires 4 arguments"),
        ("0 0 0 0", 1, "expected scenes"),
        ("0 0 1 0", 1, "expected scenes"),  # a pack without panoramas
        ("0 0 0 1", 1, "expected scenes"),  # nor rooms
    ],
)
def test_scenes_that_cannot_be_are_one_line(
    pack: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    scenes: str,
    code: int,
    message: str,
) -> None:
    words = ["train", "rong", "--data", str(pack), "--out", str(tmp_path), "--steps", "1", "--cpu"]
    assert run([*words, "--workers", "0", "--scenes", *scenes.split()]) == code
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert message in said


def test_command_refuses_an_unknown_network(pack: Path, tmp_path: Path) -> None:
    words = ["gpt", "--data", str(pack), "--out", str(tmp_path), "--steps", "1"]
    assert CliRunner().invoke(train_command, words).exit_code == 2

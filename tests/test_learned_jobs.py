import dataclasses
from pathlib import Path

import pytest
import torch
from click.testing import CliRunner
from small_networks import SMALL, SMALL_RONG, write_small_pack

from learned.commands import train as train_command
from learned.dlp import LinePerception
from learned.jobs import JobCfg, Target, run_job
from learned.larecnet import LaRecNet
from learned.presets import COMPACT, Preset
from learned.rong import RongNet
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


def test_command_refuses_an_unknown_network(pack: Path, tmp_path: Path) -> None:
    words = ["gpt", "--data", str(pack), "--out", str(tmp_path), "--steps", "1"]
    assert CliRunner().invoke(train_command, words).exit_code == 2

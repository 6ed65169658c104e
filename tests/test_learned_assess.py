import stat
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from small_networks import SMALL, SMALL_CALIBRATION, write_small_pack

from hybrid.cli import run
from learned.assess import (
    VALIDATIONS,
    assess,
    fit_temperature,
    temperature_batches,
    validation_batches,
)
from learned.dlp import LinePerception
from learned.larecnet import LaRecNet
from learned.mirror import mean_estimate
from learned.rectification import rectify_images
from learned.slf.batch import SlfBatch
from learned.slf.stream import StreamCfg
from learned.weights import load_weights, save_weights


@pytest.fixture(scope="module")
def network() -> LaRecNet:
    torch.manual_seed(0)
    made = LaRecNet(replace(SMALL, frame=32))
    made.parameters_of_lens.whiten(_lenses(400))
    return made.eval()


def _lenses(n: int) -> torch.Tensor:
    k = torch.tensor([1.2, -0.05, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0]).repeat(n, 1)
    spread = torch.tensor([0.1, 0.02, 0.005, 0.002, 0.001, 0.0, 0.01, 0.02, 0.02])
    return k + spread * torch.randn(n, 9)


@pytest.fixture(scope="module")
def batches() -> list[SlfBatch]:
    torch.manual_seed(1)
    found = []
    for _ in range(3):
        k, image = _lenses(16), torch.rand(16, 3, 32, 32)
        lines = (torch.rand(16, 1, 32, 32) < 0.1).float()
        found.append(SlfBatch(image, lines, k, rectify_images(image, k), torch.full((16,), 1.0)))
    return found


def test_temperature_makes_the_intervals_hold(network: LaRecNet, batches: list[SlfBatch]) -> None:
    network.calibration.temperature.fill_(0.2)  # far too sure
    assert assess(network, batches).summary()["held_90"] < 0.6
    fit_temperature(network, batches)
    assert 0.8 < assess(network, batches).summary()["held_90"] < 0.97


def test_truth_has_no_error_and_a_perfect_picture(
    network: LaRecNet, batches: list[SlfBatch]
) -> None:
    with torch.inference_mode():
        k = mean_estimate(network, batches[0].image).k
        truth = replace(batches[0], k=k, rectified=rectify_images(batches[0].image, k))
    found = assess(network, [truth]).summary()
    assert found["rpe_mean_px"] < 1e-3
    assert found["psnr_db"] > 80
    assert found["samples"] == 16


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small_pack(tmp_path_factory.mktemp("packs") / "tiny.pack")


@pytest.fixture
def weights(network: LaRecNet, tmp_path: Path) -> Path:
    """Weights whose card tells more than scores."""
    network.calibration.temperature.fill_(0.2)
    card = {"seed": 7, "scores": {"old": 1.0}, "temperature": 0.2}
    save_weights(tmp_path / "w.safetensors", network, card)
    return tmp_path / "w.safetensors"


@pytest.fixture
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    torch.set_num_threads(1)
    monkeypatch.setattr("learned.assess.VALIDATION_SIZE", 32)
    monkeypatch.setattr("learned.assess.TEMPERATURE_BATCHES", 2)


@pytest.mark.usefixtures("_small")
def test_new_scores_and_temperature_and_nothing_else_change(
    pack: Path, weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "w.safetensors"
    words = ["assess", str(weights), "--validation", str(pack), "--samples", "16"]
    mixture = ["--data", str(pack), "--scenes", "1", "0", "0", "0"]
    assert run([*words, *mixture, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    before, after = (load_weights(path, LaRecNet) for path in (weights, out))
    assert stat.S_IMODE(out.stat().st_mode) == 0o644
    for name, value in after.network.state_dict().items():
        same = torch.equal(value, before.network.state_dict()[name])
        assert same != name.endswith("temperature"), name

    planes = StreamCfg(scenes=(1.0, 0.0, 0.0, 0.0))
    fit_temperature(before.network, temperature_batches(pack, 32, planes))
    temperature = float(before.network.calibration.temperature)
    assert temperature == pytest.approx(float(after.network.calibration.temperature))
    assert after.card.pop("temperature") == round(temperature, 4)
    scores = after.card.pop("scores")
    assert after.card == {"seed": 7}
    assert set(scores) == set(VALIDATIONS)
    for name, mixture_of_cards in VALIDATIONS.items():
        batches = validation_batches(pack, 2, 32, mixture_of_cards)
        expected = assess(after.network, batches).summary()
        assert scores[name] == pytest.approx(expected, abs=1e-4)
        assert f"{expected['rpe_median_px']:.2f}" in said


@pytest.mark.usefixtures("_small")
def test_weights_without_a_spread_are_scored_without_one(
    pack: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = replace(SMALL, frame=32, calibration=replace(SMALL_CALIBRATION, covariance=False))
    save_weights(tmp_path / "plain.safetensors", LaRecNet(plain), {})
    words = ["assess", str(tmp_path / "plain.safetensors"), "--validation", str(pack)]
    out = ["--out", str(tmp_path / "scored.safetensors")]
    assert run([*words, "--samples", "8", *out]) == 0
    card = load_weights(tmp_path / "scored.safetensors", LaRecNet).card
    assert "temperature" not in card
    assert all("held_90" not in scores for scores in card["scores"].values())
    assert run([*words, "--data", str(pack)]) == 2
    assert "predict a spread" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("--samples 12", 2, "expected --samples of 8 each, got 12"),
        ("--samples 0", 2, "got 0"),
        ("--scenes 1 0 0 0", 2, "need --data"),
        ("--wild 0.5", 2, "need --data"),
        ("--straight 0.5", 2, "need --data"),
        ("--out scored.pt", 2, "end in .safetensors, got scored.pt"),
        ("--out there.safetensors", 2, "--overwrite"),
        ("--out w.safetensors --overwrite", 2, "is an input"),
        ("--data w.safetensors", 1, "w.safetensors"),
    ],
)
def test_what_cannot_be_assessed_is_one_line(
    pack: Path,
    weights: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    words: str,
    code: int,
    message: str,
) -> None:
    monkeypatch.chdir(weights.parent)
    Path("there.safetensors").touch()
    before = weights.read_bytes()
    assert run(["assess", weights.name, "--validation", str(pack), *words.split()]) == code
    said = capsys.readouterr().err
    assert said.count("\n") == 1, said
    assert message in said
    assert weights.read_bytes() == before


def test_weights_that_are_no_larecnet_are_refused(
    pack: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_weights(tmp_path / "dlp.safetensors", LinePerception(SMALL.dlp), {})
    assert run(["assess", str(tmp_path / "dlp.safetensors"), "--validation", str(pack)]) == 1
    assert "larecnet" in capsys.readouterr().err
    assert run(["assess", "nothing", "--validation", str(pack)]) == 1
    assert "expected weights among" in capsys.readouterr().err

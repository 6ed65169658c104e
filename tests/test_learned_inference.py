"""A folded network answers as the network that was trained."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import nn

from learned.inference import folded
from learned.larecnet import LaRecNet, LarecnetCfg
from learned.presets import COMPACT, PAPER
from learned.rong import RongNet

ROOT = Path(__file__).resolve().parents[1]
DIGEST = """
import hashlib, sys
import numpy as np
from learned.predictor import Predictor
predictor = Predictor.from_weights()
picture = np.random.default_rng(0).integers(0, 255, (96, 128, 3), dtype=np.uint8)
lens, lines = predictor.lens(picture), predictor.lines(picture)
parts = [lens.camera.to_vector(), lens.covariance, lines.heatmap, lines.lineness]
print(hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest())
"""
NARROW_PAPER = replace(
    PAPER.network,
    dlp=replace(PAPER.network.dlp, width=32, stacks=2),
    calibration=replace(PAPER.network.calibration, widths=(16, 32, 64, 128), branch=64, hidden=32),
)


def _as_if_trained(network: nn.Module) -> None:
    """Means, variances, gains and shifts as different as training makes them."""
    for norm in network.modules():
        if isinstance(norm, nn.BatchNorm2d):
            assert norm.running_mean is not None
            assert norm.running_var is not None
            nn.init.normal_(norm.running_mean, std=0.3)
            nn.init.uniform_(norm.running_var, 0.3, 3.0)
            nn.init.uniform_(norm.weight, -0.2, 1.2)
            nn.init.normal_(norm.bias, std=0.3)


@pytest.fixture(scope="module", params=[COMPACT.network, NARROW_PAPER], ids=["compact", "paper"])
def network(request: pytest.FixtureRequest) -> LaRecNet:
    cfg: LarecnetCfg = request.param
    torch.manual_seed(0)
    network = LaRecNet(cfg)
    _as_if_trained(network)
    return network.eval()


def test_folded_network_sees_the_same_lines_and_lens(network: LaRecNet) -> None:
    image = torch.rand(1, 3, 128, 192)
    fast = folded(network)
    with torch.inference_mode():
        expected, found = network.dlp(image).raw, fast.dlp(image).raw
        lens, same = network(image).k, fast(image).k
        maps, others = network.dlp.maps(image), fast.dlp.maps(image)
    scale = float(expected.abs().max())
    torch.testing.assert_close(found, expected, rtol=0.0, atol=2e-5 * scale)
    torch.testing.assert_close(others, maps, rtol=0.0, atol=1e-4)
    torch.testing.assert_close(same, lens, rtol=0.0, atol=1e-5)


def test_folding_leaves_no_batch_norm_and_the_network_as_it_was(network: LaRecNet) -> None:
    before = {name: value.clone() for name, value in network.state_dict().items()}
    assert not [m for m in folded(network).modules() if isinstance(m, nn.BatchNorm2d)]
    after = network.state_dict()
    assert after.keys() == before.keys()
    assert all(torch.equal(value, before[name]) for name, value in after.items())


def test_folded_baseline_gives_the_same_scores() -> None:
    torch.manual_seed(0)
    network = RongNet(COMPACT.rong).eval()
    _as_if_trained(network)
    image = torch.rand(2, 3, 64, 64)
    fast = folded(network)
    assert not [m for m in fast.modules() if isinstance(m, nn.BatchNorm2d)]
    with torch.inference_mode():
        expected = network(image)
        scale = float(expected.abs().max())
        torch.testing.assert_close(fast(image), expected, rtol=0.0, atol=2e-5 * scale)


def test_every_process_gives_the_same_answer_to_the_last_bit() -> None:
    command = [sys.executable, "-c", DIGEST]
    runs = [
        subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout
        for _ in range(2)
    ]
    assert runs[0] == runs[1]

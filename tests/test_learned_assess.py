from dataclasses import replace

import pytest
import torch
from small_networks import SMALL

from learned.assess import assess, fit_temperature
from learned.larecnet import LaRecNet
from learned.rectification import rectify_images
from learned.slf.batch import SlfBatch


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
        k = network(batches[0].image).k
        truth = replace(batches[0], k=k, rectified=rectify_images(batches[0].image, k))
    found = assess(network, [truth]).summary()
    assert found["rpe_mean_px"] < 1e-3
    assert found["psnr_db"] > 80
    assert found["samples"] == 16

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_networks import SMALL, SMALL_DLP

from learned.calibration import (
    Branch,
    Calibration,
    CalibrationCfg,
    cholesky_factor,
    regions,
)
from learned.config_json import from_json, to_json
from learned.dlp import LinePerception
from learned.larecnet import LaRecNet, LarecnetCfg
from learned.losses import pixel_loss
from learned.parameters import N_FREE, Parameters
from learned.presets import ABLATIONS, COMPACT, PAPER, PRESETS, Preset, ablation, preset
from learned.rong import RongCfg, RongNet, division_parameter
from learned.uncertainty import AttentiveUncertainty


def _parameters(network: torch.nn.Module) -> float:
    return sum(p.numel() for p in network.parameters()) / 1e6


def test_compact_networks_have_at_most_eight_million_parameters() -> None:
    assert _parameters(LaRecNet(COMPACT.network)) <= 8.0


def test_compact_gives_full_size_maps_and_nine_parameters() -> None:
    network = LaRecNet(COMPACT.network).eval()
    image = torch.rand(2, 3, 320, 320)
    with torch.inference_mode():
        out = network(image, rectify=True)
    assert out.heatmap is not None
    assert out.heatmap.shape == (2, 1, 320, 320)
    assert out.k.shape == (2, 9)
    assert out.estimate.local is not None
    assert out.estimate.local.shape == (2, 5, 5)
    assert out.estimate.cholesky is not None
    assert out.estimate.cholesky.shape == (2, N_FREE, N_FREE)
    assert [s.shape[-1] for s in out.estimate.stages] == [80, 40, 20, 10]
    assert out.rectified is not None
    assert out.uncertainty is not None
    assert out.rectified.shape == (2, 3, 80, 80)
    assert out.uncertainty.shape == (2, 1, 80, 80)


@pytest.mark.slow
def test_paper_preset_gives_a_map_of_ten_by_ten_by_1024() -> None:
    network = LaRecNet(PAPER.network).eval()
    image = torch.rand(1, 3, 320, 320)
    with torch.inference_mode():
        out = network(image, rectify=True)
        seen = network.dlp(image)
    assert seen.raw.shape == (1, 1, 320, 320)
    assert len(seen.side) == 4
    assert out.estimate.stages[-1].shape == (1, 1024, 10, 10)
    assert out.uncertainty is not None
    assert out.uncertainty.shape == (1, 1, 320, 320)


@pytest.mark.parametrize("reading", ["conv-first", "layer4"])
def test_both_readings_of_the_ten_by_ten_puzzle_fit(reading: str) -> None:
    deep = reading == "layer4"
    cfg = CalibrationCfg(
        reading=reading,  # type: ignore[arg-type]
        widths=(8, 16, 16, 16, 32) if deep else (8, 16, 16, 16),
        blocks=(1, 1, 1, 1) if deep else (1, 1, 1),
        branch=8,
        hidden=8,
    )
    network = Calibration(cfg).eval()
    with torch.inference_mode():
        image = torch.rand(1, 3, 320, 320)
        map_, stages = network.backbone(torch.cat([image, image[:, :1]], 1))
        out = network(image, image[:, :1], None)
    assert map_.shape == (1, 16, 10, 10)
    assert len(stages) == 4
    assert out.fused.shape == (1, 9)


def test_regions_are_four_quarters_of_5x5_and_a_centre_of_6x6() -> None:
    map_ = torch.arange(100.0).reshape(1, 1, 10, 10)
    parts = regions(map_)
    assert [tuple(p.shape[-2:]) for p in parts] == [(5, 5)] * 4 + [(6, 6)]
    corners = [p[0, 0, 0, 0].item() for p in parts]
    assert corners == [0, 50, 5, 55, 22]  # UL, LL, UR, LR, centre


@pytest.mark.parametrize("fusion", ["mean", "learned"])
def test_fusion_starts_as_the_mean_of_global_and_five_local_estimates(fusion: str) -> None:
    calibration = replace(SMALL.calibration, fusion=fusion)
    network = LaRecNet(replace(SMALL, calibration=calibration)).eval()
    for branch in (network.calibration.glob, network.calibration.local):
        assert branch is not None
        torch.nn.init.normal_(branch.last.weight)
    estimate = network(torch.rand(1, 3, 64, 64)).estimate
    assert estimate.local is not None
    expected = (estimate.glob[0, :5] + estimate.local[0].sum(0)) / 6
    torch.testing.assert_close(estimate.fused[0, :5], expected)
    torch.testing.assert_close(estimate.fused[0, 5:], estimate.glob[0, 5:])


@pytest.mark.parametrize("inputs", [("image",), ("heatmap", "lineness"), ("image", "heatmap")])
@pytest.mark.parametrize("multiscale", [True, False])
def test_ablations_differ_by_one_field(inputs: tuple[str, ...], multiscale: bool) -> None:
    calibration = replace(SMALL.calibration, inputs=inputs, multiscale=multiscale)
    network = LaRecNet(replace(SMALL, calibration=calibration)).eval()
    out = network(torch.rand(1, 3, 64, 64))
    assert (out.heatmap is not None) == (inputs != ("image",))
    assert (out.estimate.local is not None) == multiscale
    assert out.k.shape == (1, 9)


def test_only_branches_with_places_know_what_is_where() -> None:
    torch.manual_seed(0)
    map_ = torch.rand(1, 8, 6, 6)
    turned = map_.flip((2, 3))
    cfg = replace(SMALL.calibration, narrow=4)
    for places, knows in ((0, False), (6, True)):
        branch = Branch(8, cfg, places, 3)
        torch.nn.init.normal_(branch.last.weight)
        same = torch.allclose(branch(map_), branch(turned), atol=1e-5)
        assert same != knows


def test_lines_seen_before_are_not_looked_for_again() -> None:
    network = LaRecNet(SMALL).eval()
    image = torch.rand(2, 3, 64, 64)
    with torch.inference_mode():
        seen = network.dlp.maps(image)
        ahead = network(image, seen=seen)
        fresh = network(image)
        other = network(image, seen=torch.zeros_like(seen))
    torch.testing.assert_close(ahead.k, fresh.k)
    assert other.heatmap is not None
    assert not other.heatmap.any()


def test_no_inputs_are_refused() -> None:
    with pytest.raises(ValueError, match="expected inputs among"):
        CalibrationCfg(inputs=())


def test_line_perception_stays_fixed_in_phase_two() -> None:
    network = LaRecNet(SMALL).train()
    before = {n: t.clone() for n, t in network.dlp.state_dict().items()}
    out = network(torch.rand(2, 3, 64, 64))
    out.k.sum().backward()
    assert all(p.grad is None for p in network.dlp.parameters())
    after = network.dlp.state_dict()
    assert all(torch.equal(before[n], after[n]) for n in before)


@pytest.mark.parametrize("stem", ["patch", "conv"])
@pytest.mark.parametrize("head", ["shuffle", "deconv"])
@pytest.mark.parametrize("target", ["length", "lineness"])
def test_every_variant_of_line_perception_gives_a_map_in_zero_to_one(
    stem: str, head: str, target: str
) -> None:
    cfg = replace(SMALL_DLP, stem=stem, head=head, target=target, width=16)
    network = LinePerception(cfg).eval()
    out = network(torch.rand(1, 3, 48, 64))
    for map_ in (network.heatmap(out.raw), network.lineness(out.raw)):
        assert map_.shape == (1, 1, 48, 64)
        assert map_.min() >= 0
        assert map_.max() <= 1


def test_uncertainty_starts_uniform() -> None:
    for normalise in ("space", "channels"):
        module = AttentiveUncertainty((4, 8), width=2, normalise=normalise)
        features = (torch.rand(1, 4, 8, 8), torch.rand(1, 8, 4, 4))
        out = module(features, torch.rand(1, 3, 16, 16), torch.rand(1, 3, 16, 16))
        torch.testing.assert_close(out, torch.ones(1, 1, 16, 16))


def test_uncertainty_gains_nothing_from_one_pixel() -> None:
    """L_pix must not be least where one pixel has all of U_A."""
    module = AttentiveUncertainty((4,), width=2)
    features = (torch.rand(1, 4, 8, 8),)
    picture = torch.zeros(1, 3, 16, 16)
    picture[..., 3, 5] = 1.0
    losses = []
    for height in (0.0, 12.0):
        torch.nn.init.zeros_(module.last.weight)
        module.last.weight.data[0, 0, 1, 1] = height  # the first channel of the picture, as it is
        found = module(features, picture, picture)
        assert found.log().mean().item() == pytest.approx(0.0, abs=1e-5)
        losses.append(pixel_loss(picture * 0.0 + 0.02, picture * 0.0, found).item())
    assert losses[0] < losses[1]


def test_whitening_decodes_what_it_encodes() -> None:
    rng = np.random.default_rng(0)
    samples = torch.from_numpy(rng.normal(size=(500, 9)) * 0.1).float()
    samples[:, 5] = 1.0
    samples[:, 1] += 0.9 * samples[:, 0]
    coordinates = Parameters()
    coordinates.whiten(samples)
    z = coordinates.encode(samples)
    torch.testing.assert_close(coordinates.decode(z), samples, atol=1e-5, rtol=0)
    spread = torch.cov(z[:, :5].T)
    torch.testing.assert_close(spread, torch.eye(5), atol=0.02, rtol=0)


def test_covariance_follows_the_coordinates() -> None:
    coordinates = Parameters()
    coordinates.factor.mul_(0.5)
    cholesky = 2.0 * torch.eye(N_FREE)[None]  # precision 4, so variance 1/4, times 0.25
    covariance = coordinates.covariance(cholesky)[0]
    expected = torch.full((9,), 0.0625, dtype=torch.float64)
    expected[5] = 0.0  # the gauge
    torch.testing.assert_close(torch.diagonal(covariance), expected)


def test_cholesky_factor_is_lower_with_a_positive_diagonal() -> None:
    factor = cholesky_factor(5.0 * torch.randn(3, N_FREE * (N_FREE + 1) // 2))
    assert torch.equal(factor, torch.tril(factor))
    assert (torch.diagonal(factor, dim1=1, dim2=2) > 0).all()


@pytest.mark.parametrize("name", PRESETS)
def test_configuration_survives_json(name: str) -> None:
    cfg = preset(name).network
    assert from_json(LarecnetCfg, to_json(cfg)) == cfg


def test_unknown_preset_is_refused() -> None:
    with pytest.raises(ValueError, match="expected a preset among"):
        preset("huge")


def test_division_parameter_is_exact_for_a_division_lens() -> None:
    # r / tan θ = 1 + λ r² with λ = −0.2: r as an odd series of θ, fitted up to 45 degrees
    lambda_ = -0.2
    theta = np.linspace(0.01, np.pi / 4, 200)
    tan = np.tan(theta)
    r = (1 - np.sqrt(1 - 4 * lambda_ * tan**2)) / (2 * lambda_ * tan)
    powers = theta[:, None] ** np.array([1, 3, 5, 7, 9])
    k = np.linalg.lstsq(powers, r, rcond=None)[0]
    # beyond 45 degrees the series leaves the division lens, so make it turn there
    vector = torch.tensor([[*k, 1, 1, 0, 0]])
    got = division_parameter(vector).item()
    assert got == pytest.approx(lambda_, abs=0.03)


def test_rong_estimates_the_mean_of_its_classes() -> None:
    network = RongNet(RongCfg(widths=(8, 8, 8, 8), blocks=1, classes=21, low=-2.0, high=0.0))
    lambda_ = torch.tensor([-0.73, -1.2])
    labels = network.labels(lambda_)
    torch.testing.assert_close(labels.sum(1), torch.ones(2))
    torch.testing.assert_close(network.estimate(labels.log()), lambda_, atol=0.01, rtol=0)
    assert network.eval()(torch.rand(1, 3, 64, 64)).shape == (1, 21)


def test_mixed_precision_leaves_the_heads_exact() -> None:
    coordinates = Parameters()
    coordinates.factor.copy_(torch.eye(9) + 0.1)
    z = torch.rand(4, 9)
    with torch.autocast("cpu", torch.bfloat16):
        mixed = coordinates.decode(z)
    assert mixed.dtype == torch.float32
    torch.testing.assert_close(mixed, coordinates.decode(z))


@pytest.mark.parametrize("base", [PAPER, COMPACT], ids=["paper", "compact"])
def test_each_ablation_adds_one_thing(base: Preset) -> None:
    seen = []
    for name in ABLATIONS:
        variant = ablation(base, name)
        calibration, loss = variant.network.calibration, variant.loss
        seen.append((calibration.inputs, calibration.multiscale, loss.geo > 0, loss.pix > 0))
        assert loss.shape == loss.projection == 0  # not the paper's
    both = base.network.calibration.inputs
    assert both[0] == "image"
    assert seen == [
        (both[:1], False, False, False),
        (both[1:], False, False, False),
        (both, False, False, False),
        (both, True, False, False),
        (both, True, True, False),
        (both, True, True, True),
    ]

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from small_networks import SMALL, SMALL_CALIBRATION, SMALL_DLP, SMALL_RONG

from learned.dlp import LinePerception
from learned.larecnet import LaRecNet
from learned.mirror import mean_estimate, mirrored, transposed
from learned.phases import (
    DivisionPhase,
    PerceptionPhase,
    RectificationPhase,
    detection_counts,
    reprojection_errors,
)
from learned.presets import COMPACT
from learned.rectification import pixel_grid, rectify_images, undistort
from learned.rong import RongNet
from learned.schedule import Average, OptimCfg, build_optimizer, rate_at
from learned.slf.batch import SlfBatch
from learned.train import CHECKPOINT, RunCfg, train

SIZE = 32
OPTIM = OptimCfg(kind="adamw", rate=3e-3, schedule="trapezoid", warmup=2)


def grids(number: int, *, batch: int = 2) -> SlfBatch:
    """Pictures of a straight grid, bent by a random lens: lines known in closed form."""
    rng = torch.Generator().manual_seed(number)
    k = torch.tensor([1.2, -0.05, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0]).repeat(batch, 1)
    k[:, 0] += 0.4 * torch.rand(batch, generator=rng) - 0.2
    k[:, 7:] = 0.1 * torch.rand(batch, 2, generator=rng) - 0.05
    points = pixel_grid(SIZE, SIZE).expand(batch, -1, -1)
    straight, _ = undistort(points, k)
    shift = torch.rand(batch, 1, 2, generator=rng)
    away = ((straight / 0.5 + shift) % 1.0 - 0.5).abs().amin(-1)
    on_line = (away < 0.12).reshape(batch, 1, SIZE, SIZE).float()
    image = 0.2 + 0.6 * on_line.repeat(1, 3, 1, 1)
    return SlfBatch(image, 0.4 * on_line, k, rectify_images(image, k), torch.full((batch,), 1.2))


def _train(folder: Path, steps: int, total: int, *, resume: bool = False) -> Average:
    torch.manual_seed(0)
    cfg = RunCfg(total, OPTIM, workers=0, report_every=10**6, log_every=1, checkpoint_minutes=0.0)
    source: Callable[[int], SlfBatch] = grids
    if steps < total:

        def stop_early(number: int) -> SlfBatch:
            if number == steps:
                raise KeyboardInterrupt
            return grids(number)

        source = stop_early
    return train(
        LinePerception(SMALL_DLP),
        PerceptionPhase(SMALL_DLP),
        source,
        [],
        cfg,
        folder=folder,
        resume=resume,
        cpu=True,
        progress=False,
    )


@pytest.fixture
def _one_thread() -> None:
    torch.set_num_threads(1)


@pytest.mark.usefixtures("_one_thread")
def test_resumed_training_equals_an_uninterrupted_one(tmp_path: Path) -> None:
    whole = _train(tmp_path / "whole", 6, 6)
    with pytest.raises(KeyboardInterrupt):
        _train(tmp_path / "parts", 3, 6)
    parts = _train(tmp_path / "parts", 6, 6, resume=True)
    for name, value in whole.values.items():
        assert torch.equal(value, parts.values[name]), name
    assert (tmp_path / "parts" / CHECKPOINT).exists()


def test_reports_leave_a_picture_and_a_line_of_figures(tmp_path: Path) -> None:
    cfg = RunCfg(1, OPTIM, workers=0, report_every=1)
    train(
        LinePerception(SMALL_DLP),
        PerceptionPhase(SMALL_DLP),
        grids,
        [grids(99)],
        cfg,
        folder=tmp_path,
        cpu=True,
        progress=False,
    )
    assert (tmp_path / "heatmaps.png").exists()
    assert '"validation"' in (tmp_path / "log.jsonl").read_text()


def _fit(
    module: torch.nn.Module, phase: PerceptionPhase | RectificationPhase, steps: int, rate: float
) -> list[float]:
    batch = grids(0, batch=8)
    optimizer = build_optimizer(module, replace(OPTIM, rate=rate))
    losses = []
    for _ in range(steps):
        loss, scalars = phase.loss(module.train(), batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(scalars.get("rpe", loss).detach()))
    return losses


@pytest.mark.slow
def test_line_perception_overfits_eight_pictures() -> None:
    torch.manual_seed(0)
    network = LinePerception(SMALL_DLP)
    _fit(network, PerceptionPhase(SMALL_DLP), 120, 1e-2)
    scalars, _ = PerceptionPhase(SMALL_DLP).report(network, [grids(0, batch=8)])
    assert scalars["f"] > 0.97


@pytest.mark.slow
def test_larecnet_overfits_eight_pictures() -> None:
    torch.manual_seed(0)
    network = LaRecNet(SMALL)
    network.parameters_of_lens.whiten(
        torch.cat([grids(i).k for i in range(50)]) + 0.01 * torch.randn(100, 9)
    )
    phase = RectificationPhase(replace(COMPACT, network=SMALL))
    errors = _fit(network, phase, 120, 5e-3)
    assert min(errors[-20:]) < 0.3 * errors[0]


def test_every_phase_gives_gradients_to_all_that_is_trained() -> None:
    torch.manual_seed(0)
    batch = grids(1)
    phases = [
        (LinePerception(SMALL_DLP), PerceptionPhase(SMALL_DLP)),
        (LaRecNet(SMALL), RectificationPhase(replace(COMPACT, network=SMALL))),
        (RongNet(SMALL_RONG), DivisionPhase()),
    ]
    for module, phase in phases:
        loss, _ = phase.loss(module.train(), batch)
        loss.backward()
        wanted = [n for n, p in module.named_parameters() if p.requires_grad and p.grad is None]
        assert not wanted


def test_geo_scale_of_the_preset_reaches_the_loss() -> None:
    torch.manual_seed(0)
    network, batch = LaRecNet(SMALL).eval(), grids(1, batch=1)

    def geo(scale: float) -> float:
        cfg = replace(COMPACT.loss, geo_scale=scale)
        phase = RectificationPhase(replace(COMPACT, network=SMALL, loss=cfg))
        return phase.loss(network, batch)[1]["geo"].item()

    assert geo(0.3) == pytest.approx(0.3 * math.log(1 + geo(0.0) / 0.3), rel=1e-4)


@pytest.mark.parametrize("name", ["geo", "shape", "projection"])
def test_losses_of_the_geometry_count_by_their_weights(name: str) -> None:
    torch.manual_seed(0)
    network, batch = LaRecNet(SMALL).eval(), grids(1, batch=1)

    def total(weight: float) -> tuple[float, float]:
        cfg = replace(COMPACT.loss, **{name: weight})
        phase = RectificationPhase(replace(COMPACT, network=SMALL, loss=cfg))
        loss, parts = phase.loss(network, batch)
        return loss.item(), parts[name].item()

    (without, part), (with_it, _) = total(0.0), total(60.0)
    assert part > 0
    assert with_it - without == pytest.approx(60.0 * part, rel=1e-4)


def test_projection_alone_counts_what_is_beyond_the_rectified_plane() -> None:
    torch.manual_seed(0)
    network = LaRecNet(SMALL).eval()
    wide = torch.tensor([[0.6, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0]])
    phase = RectificationPhase(replace(COMPACT, network=SMALL))

    def parts(theta_max: float) -> dict[str, torch.Tensor]:
        batch = replace(grids(1, batch=1), k=wide, theta_max=torch.tensor([theta_max]))
        return phase.loss(network, batch)[1]

    inner, whole = parts(math.radians(66)), parts(math.radians(100))
    assert whole["geo"].item() == inner["geo"].item()
    assert whole["shape"].item() == inner["shape"].item()
    assert whole["projection"].item() > 1.05 * inner["projection"].item()


def test_reprojection_error_is_zero_for_the_truth_and_a_known_value_for_a_shift() -> None:
    batch = grids(3)
    assert reprojection_errors(batch.k, batch).rpe.max() < 1e-3
    moved = batch.k.clone()
    moved[:, 0] *= 1.01  # a lens one percent longer: rays one percent nearer to the axis
    errors = reprojection_errors(moved, batch)
    assert ((errors.rpe > 0.3) & (errors.rpe < 4.0)).all()
    assert (errors.aligned < 0.5 * errors.rpe).all()


@pytest.mark.parametrize("dims", [(), (2,), (3,), (2, 3)])
def test_mirrored_lens_rectifies_the_mirrored_picture(dims: tuple[int, ...]) -> None:
    batch = mirrored(grids(5), dims)
    again = rectify_images(batch.image, batch.k)
    torch.testing.assert_close(again, batch.rectified, atol=1e-4, rtol=0)


def test_transposed_lens_rectifies_the_transposed_picture() -> None:
    """Off centre and with pixels that are not square, or an exchange of either went unseen."""
    batch = grids(5)
    k = batch.k.clone()
    k[:, 6:] = torch.tensor([0.9, 0.06, -0.03])
    batch = replace(batch, k=k, rectified=rectify_images(batch.image, k))
    upright = transposed(batch)
    again = rectify_images(upright.image, upright.k)
    torch.testing.assert_close(upright.rectified, batch.rectified.transpose(2, 3))
    torch.testing.assert_close(again, upright.rectified, atol=1e-3, rtol=0)
    torch.testing.assert_close(transposed(upright).k, batch.k)


@pytest.mark.parametrize("dims", [(2,), (3,), (2, 3)])
def test_mirrored_picture_has_the_mirrored_estimate(dims: tuple[int, ...]) -> None:
    torch.manual_seed(0)
    blind = replace(SMALL_CALIBRATION, inputs=("image",))  # line perception knows no mirrors
    network = LaRecNet(replace(SMALL, calibration=blind, frame=SIZE)).eval()
    network.parameters_of_lens.whiten(torch.rand(200, 9))
    batch = grids(5)
    with torch.inference_mode():
        found = mean_estimate(network, batch.image)
        turned = mean_estimate(network, batch.image.flip(dims))
        alone = network(batch.image).k
    expected = mirrored(replace(batch, k=found.k), dims).k
    torch.testing.assert_close(turned.k, expected, atol=1e-5, rtol=0)
    assert found.covariance is not None
    assert turned.covariance is not None
    sign = torch.tensor([1.0] * 7 + [-1.0 if 3 in dims else 1.0, -1.0 if 2 in dims else 1.0])
    torch.testing.assert_close(turned.covariance, found.covariance * sign * sign[:, None])
    assert (alone - found.k).abs().max() > 1e-4  # one look is not the mean of four


def test_rate_divides_by_ten_at_half_time_or_rises_holds_and_falls() -> None:
    step = OptimCfg()
    assert [rate_at(i, 100, step) for i in (0, 49, 50, 99)] == [1e-3, 1e-3, 1e-4, 1e-4]
    trapezoid = OptimCfg(rate=1.0, schedule="trapezoid", warmup=10, fall=0.5)
    rates = [rate_at(i, 100, trapezoid) for i in (0, 9, 49, 75, 100)]
    assert rates == pytest.approx([0.1, 1.0, 1.0, 0.5, 0.0])


def test_average_of_a_constant_is_the_constant() -> None:
    module = torch.nn.Linear(2, 2)
    average = Average(module, 0.9)
    before = {n: v.clone() for n, v in average.values.items()}
    average.update(module, 0)
    assert all(torch.equal(before[n], average.values[n]) for n in before)
    with torch.no_grad():
        module.weight.add_(1.0)
    average.update(module, 1000)
    torch.testing.assert_close(average.values["weight"], before["weight"] + 0.1)


def test_detection_counts_allow_two_pixels_of_slack() -> None:
    true = torch.zeros(1, 1, 16, 16, dtype=torch.bool)
    true[..., 8] = True
    for offset, hit in ((2, 16.0), (3, 0.0)):
        found = torch.roll(true, offset, dims=3)
        assert detection_counts(found, true).tolist() == [hit, 16.0, hit, 16.0]

import math

import pytest
import torch

from learned.losses import (
    LossCfg,
    aligned_distances,
    gaussian_nll,
    geometric_loss,
    line_loss,
    lineness_loss,
    local_loss,
    parameter_loss,
    pixel_loss,
    projection_loss,
    ridge_target,
    shape_loss,
)
from learned.rectification import pixel_grid, reprojected, undistort


def test_line_loss_weights_each_side_by_the_other_sides_share() -> None:
    target = torch.tensor([[[[0.5, 0.0], [0.0, 0.0]]]])
    predicted = torch.tensor([[[[0.1, 0.2], [0.0, 0.3]]]])
    # 3/4 of (0.4 squared) + 1/4 of (0.2 squared + 0.3 squared)
    expected = 0.75 * 0.16 + 0.25 * 0.13
    got = line_loss(predicted, target, reduce=False)
    assert got.item() == pytest.approx(expected)
    assert line_loss(predicted, target).item() == pytest.approx(expected / 4)


def test_global_loss_is_the_weighted_square_over_nine() -> None:
    omega = torch.tensor(LossCfg().omega)
    error = torch.tensor([[1.0, 0, 0, 2.0, 0, 0, 0, 0, 3.0]])
    expected = ((0.1 * 1) ** 2 + (1 * 2) ** 2 + (0.1 * 3) ** 2) / 9
    assert parameter_loss(error, torch.zeros(1, 9), omega).item() == pytest.approx(expected)


def test_local_loss_is_summed_over_five_regions_and_divided_by_25() -> None:
    omega = torch.tensor(LossCfg().omega)[:5]
    predicted = torch.zeros(1, 5, 5)
    predicted[0, 2, 2] = 2.0
    predicted[0, 4, 4] = 1.0
    expected = ((0.5 * 2) ** 2 + 1.0) / 25
    assert local_loss(predicted, torch.zeros(1, 5), omega).item() == pytest.approx(expected)


def test_huber_starts_as_the_square_and_goes_on_as_a_line() -> None:
    omega = torch.ones(1)

    def loss(error: float) -> float:
        return parameter_loss(torch.tensor([[error]]), torch.zeros(1, 1), omega, huber=1.0).item()

    assert loss(0.5) == pytest.approx(0.25)
    assert loss(4.0) - loss(3.0) == pytest.approx(2.0)


def test_geometric_loss_counts_line_pixels_twice() -> None:
    predicted = torch.tensor([[[0.1, 0.0], [0.0, -0.2], [5.0, 5.0]]])
    on_line = torch.tensor([[True, False, True]])
    valid = torch.tensor([[True, True, False]])
    got = geometric_loss(predicted, torch.zeros(1, 3, 2), on_line, valid, line_weight=2.0)
    assert got.item() == pytest.approx((2 * 0.1 + 0.2) / 2)


def test_scaled_geometric_loss_is_the_logarithm_of_each_picture() -> None:
    predicted = torch.tensor([[[0.3, 0.0]], [[0.5, -0.4]]])  # L_geo of 0.3 and of 0.9
    everywhere = torch.ones(2, 1, dtype=torch.bool)
    got = geometric_loss(
        predicted, torch.zeros(2, 1, 2), ~everywhere, everywhere, line_weight=2.0, scale=0.3
    )
    # 0.3 log(1 + 1) and 0.3 log(1 + 3)
    assert got.item() == pytest.approx(0.3 * (math.log(2) + math.log(4)) / 2)


def test_shape_loss_forgives_scale_and_shift_and_nothing_else() -> None:
    target = torch.tensor([[[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [9.0, 9.0]]])
    valid = torch.tensor([[True, True, True, True, False]])
    same = 3.0 * target + torch.tensor([0.4, -0.2])
    assert aligned_distances(same, target, valid).item() == pytest.approx(0.0, abs=2e-4)
    # twice as wide as high: the best scale is (2 + 1) / (4 + 1), which leaves 1/5 and 2/5
    wide = target * torch.tensor([2.0, 1.0])
    assert aligned_distances(wide, target, valid).item() == pytest.approx(0.3, abs=1e-4)
    got = shape_loss(wide, target, valid, scale=0.1)
    assert got.item() == pytest.approx(0.1 * math.log(1 + 3), abs=1e-4)


def test_shape_loss_of_the_truth_has_a_gradient() -> None:
    predicted = torch.randn(1, 4, 2, generator=torch.Generator().manual_seed(0)).requires_grad_()
    everywhere = torch.ones(1, 4, dtype=torch.bool)
    shape_loss(predicted, predicted.detach(), everywhere).backward()
    assert predicted.grad is not None
    assert predicted.grad.isfinite().all()


def test_projection_loss_is_the_mean_distance_of_what_is_shown() -> None:
    target = torch.tensor([[[1.0, 0.0], [0.0, 1.0], [9.0, 9.0]]])
    predicted = target + torch.tensor([[[0.3, 0.4], [0.0, -0.1], [5.0, 5.0]]])
    shown = torch.tensor([[True, True, False]])
    assert projection_loss(predicted, target, shown).item() == pytest.approx(0.3, abs=1e-4)
    got = projection_loss(predicted, target, shown, scale=0.1)
    assert got.item() == pytest.approx(0.1 * math.log(1 + 3), abs=1e-4)


def test_projection_loss_is_alike_on_a_field_too_wide_and_one_too_narrow() -> None:
    points = pixel_grid(64, 64)[None]
    true = torch.tensor([[0.6, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0]])
    _, theta = undistort(points, true)
    shown = theta <= math.radians(100)
    lost = []
    for k1 in (0.54, 0.66):  # r(θ) a tenth shorter and a tenth longer
        other = torch.tensor([[k1, *true[0, 1:]]])
        there = reprojected(points, theta, true, other)
        lost.append(projection_loss(there, points, shown).item())
    assert lost[0] == pytest.approx(lost[1], rel=1e-3)
    assert lost[0] == pytest.approx(0.1 * points[shown].norm(dim=-1).mean().item(), rel=1e-3)


def test_pixel_loss_divides_by_the_uncertainty_and_adds_its_logarithm() -> None:
    rectified = torch.full((1, 3, 1, 2), 0.4)
    target = torch.zeros(1, 3, 1, 2)
    uncertainty = torch.tensor([[[[0.5, 2.0]]]])
    expected = (0.4 / 0.5 + math.log(0.5) + 0.4 / 2 + math.log(2.0)) / 2
    assert pixel_loss(rectified, target, uncertainty).item() == pytest.approx(expected)
    assert pixel_loss(rectified, target, None).item() == pytest.approx(0.4)


def test_likelihood_is_lowest_at_the_true_spread() -> None:
    torch.manual_seed(0)
    error = 0.3 * torch.randn(4000, 1)
    losses = [gaussian_nll(error, torch.full((4000, 1, 1), 1 / s)).item() for s in (0.15, 0.3, 0.6)]
    assert losses[1] == min(losses)


def test_ridge_target_is_highest_on_the_line() -> None:
    band = torch.zeros(1, 1, 9, 9)
    band[..., 3:6] = 0.3  # three pixels wide, any length
    ridge = ridge_target(band)[0, 0, 4]
    torch.testing.assert_close(ridge[2:7], torch.tensor([0.25, 0.75, 1.0, 0.75, 0.25]))


def test_lineness_loss_prefers_the_truth() -> None:
    line_map = torch.zeros(1, 1, 16, 16)
    line_map[..., 6:9] = 0.4
    true = torch.cat([torch.logit(ridge_target(line_map), eps=1e-3), line_map], 1)
    wrong = torch.cat([-true[:, :1], line_map], 1)
    short = torch.cat([true[:, :1], 0.5 * line_map], 1)
    good = lineness_loss(true, line_map)
    assert good < lineness_loss(wrong, line_map)
    assert good < lineness_loss(short, line_map)


def test_constants_are_the_papers() -> None:
    cfg = LossCfg()
    assert (cfg.para, cfg.geo, cfg.pix) == (1.0, 100.0, 1.0)
    assert (cfg.shape, cfg.nll, cfg.huber) == (0.0, 0.0, 0.0)  # ours
    assert (cfg.fused, cfg.glob, cfg.local, cfg.line_weight) == (2.0, 1.0, 1.0, 2.0)
    assert cfg.omega == (0.1, 0.1, 0.5, 1.0, 1.0, 0.1, 0.1, 0.1, 0.1)

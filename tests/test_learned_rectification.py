import cv2
import numpy as np
import pytest
import torch

from classical.camera import KannalaBrandt, Pinhole
from learned.rectification import (
    distort,
    pixel_grid,
    rectify_images,
    reprojected,
    undistort,
)

LENSES = {
    "paper": (1.3, -0.08, 0.01, 0.002, -0.001, 1.0, 1.0, 0.0, 0.0),
    "shifted": (1.1, -0.05, 0.005, 0.0, 0.0, 1.0, 1.02, 0.06, -0.04),
    "equidistant 180": (2.0 / np.pi, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0),
}


@pytest.fixture(params=LENSES.values(), ids=list(LENSES))
def lens(request: pytest.FixtureRequest) -> torch.Tensor:
    return torch.tensor([request.param], dtype=torch.float64)


def _camera(lens: torch.Tensor, width: int, height: int) -> KannalaBrandt:
    k = lens[0].numpy()
    half = width / 2
    offset = np.array([(width - 1) / 2, (height - 1) / 2])
    return KannalaBrandt.from_vector(
        np.concatenate([k[:5], k[5:7] * half, k[7:9] * half + offset]), width, height
    )


def test_undistort_inverts_distort(lens: torch.Tensor) -> None:
    points = pixel_grid(64, 64, stride=4).double()[None] * 1.5
    there, _ = distort(points, lens)
    back, _ = undistort(there, lens)
    torch.testing.assert_close(back, points, atol=1e-7, rtol=0)


def test_distort_equals_the_classical_camera(lens: torch.Tensor) -> None:
    width, height = 96, 64
    pinhole = Pinhole(width / 2, width / 2, (width - 1) / 2, (height - 1) / 2, width, height)
    v, u = np.mgrid[:height, :width].astype(np.float64)
    rays, _ = pinhole.unproject(np.stack([u.ravel(), v.ravel()], 1))
    expected, valid = _camera(lens, width, height).project(rays)
    points, inside = distort(pixel_grid(height, width).double()[None], lens)
    pixels = points[0].numpy() * (width / 2) + [(width - 1) / 2, (height - 1) / 2]
    both = valid & inside[0].numpy()
    assert both.mean() > 0.9
    np.testing.assert_allclose(pixels[both], expected[both], atol=1e-6)


def test_reprojected_goes_through_the_rays_of_the_classical_cameras(lens: torch.Tensor) -> None:
    width, height = 96, 64
    other = torch.tensor([LENSES["shifted"]], dtype=torch.float64)
    points = pixel_grid(height, width).double()[None] * 0.7
    _, theta = undistort(points, lens)
    offset = [(width - 1) / 2, (height - 1) / 2]
    rays, seen = _camera(lens, width, height).unproject(points[0].numpy() * (width / 2) + offset)
    expected, valid = _camera(other, width, height).project(rays)
    got = reprojected(points, theta, lens, other)[0].numpy() * (width / 2) + offset
    both = seen & valid
    assert both.mean() > 0.9
    np.testing.assert_allclose(got[both], expected[both], atol=1e-5)


def test_layer_agrees_with_the_classical_warp_to_a_twentieth_pixel(lens: torch.Tensor) -> None:
    width, height = 96, 64
    v, u = np.mgrid[:height, :width].astype(np.float32)
    ramps = torch.from_numpy(np.stack([u, v]))[None].double()
    got = rectify_images(ramps, lens)[0].numpy()
    pinhole = Pinhole(width / 2, width / 2, (width - 1) / 2, (height - 1) / 2, width, height)
    rays, _ = pinhole.unproject(np.stack([u.ravel(), v.ravel()], 1).astype(np.float64))
    points, _ = _camera(lens, width, height).project(rays)
    at = points.reshape(height, width, 2).astype(np.float32)
    inside = (
        (at[..., 0] > 0) & (at[..., 0] < width - 1) & (at[..., 1] > 0) & (at[..., 1] < height - 1)
    )
    for channel, ramp in enumerate((u, v)):
        expected = cv2.remap(ramp, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
        assert np.abs(got[channel] - expected)[inside].max() < 0.05


def test_gradient_reaches_k_through_the_warp(lens: torch.Tensor) -> None:
    # a smooth picture: the bilinear kernel has kinks, which finite differences would straddle
    v, u = torch.meshgrid(torch.arange(32.0), torch.arange(32.0), indexing="ij")
    image = (u * 0.1 + v * 0.07)[None, None].double()
    lens = lens.clone()
    lens[:, :5] *= 0.7  # keeps the frame's corners inside the picture
    free = lens.requires_grad_()
    assert torch.autograd.gradcheck(
        lambda k: rectify_images(image, k, size=(5, 5)), (free,), eps=1e-6, atol=1e-4
    )


def test_gradient_reaches_k_through_the_inverse(lens: torch.Tensor) -> None:
    points = pixel_grid(32, 32, stride=8).double()[None] * 0.8
    assert torch.autograd.gradcheck(
        lambda k: undistort(points, k)[0], (lens.requires_grad_(),), eps=1e-7, atol=1e-5
    )


def test_centre_has_a_finite_gradient() -> None:
    k = torch.tensor([LENSES["paper"]]).requires_grad_()
    points, _ = undistort(torch.zeros(1, 1, 2), k)
    there, _ = distort(torch.zeros(1, 1, 2), k)
    (points.sum() + there.sum()).backward()
    assert k.grad is not None
    assert torch.isfinite(k.grad).all()


def test_nothing_is_shown_where_the_radius_falls() -> None:
    falling = torch.tensor([[1.0, -0.6, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0]])  # turns at 43 degrees
    out = rectify_images(torch.ones(1, 1, 64, 64), falling)[0, 0]
    radius = pixel_grid(64, 64).square().sum(-1).sqrt().reshape(64, 64)
    assert (out[radius > 0.95] == 0).all()
    assert (out[radius < 0.9] > 0.99).all()


def test_frame_of_another_size_spans_the_same_angle() -> None:
    v, u = torch.meshgrid(torch.arange(64.0), torch.arange(64.0), indexing="ij")
    image = (torch.sin(u / 9) + torch.cos(v / 7))[None, None]
    k = torch.tensor([LENSES["paper"]])
    whole = rectify_images(image, k)
    half = rectify_images(image, k, size=(32, 32))
    pooled = torch.nn.functional.avg_pool2d(whole, 2)
    assert (half - pooled)[..., 4:-4, 4:-4].abs().max() < 0.02

"""A fitted lens reaches what its picture shows."""

import numpy as np
import pytest

from classical.camera import KannalaBrandt
from classical.fit import fit_lens
from classical.fit.reach import reaching
from classical.lines import Curve, find_rim

SIZE = 320
TURNING = KannalaBrandt.centred(np.array([1.64, -0.55, -0.005, 0.004, 0.0]), SIZE, SIZE)
COVARIANCE = np.diag(np.array([0.01, 0.02, 0.02, 0.01, 0.002, 0.0, 0.1, 0.2, 0.2]) ** 2)


def circle(radius: float) -> np.ndarray:
    """Points around the picture's middle."""
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)[:, None]
    return (SIZE - 1) / 2 + radius * np.concatenate([np.cos(angle), np.sin(angle)], axis=1)


def reach(camera: KannalaBrandt) -> float:
    """Radius at which the lens turns, pixels."""
    return float(camera.radius(np.array([camera.theta_max]))[0] * camera.m_u)


def shown(radius: float) -> np.ndarray:
    """A grey scene in a black surround."""
    u, v = np.meshgrid(np.arange(SIZE), np.arange(SIZE))
    inside = np.hypot(u - (SIZE - 1) / 2, v - (SIZE - 1) / 2) < radius
    return np.where(inside, 150, 2).astype(np.uint8)


@pytest.mark.parametrize("excess", [-2.0, 0.0, 1.0, 3.0])
def test_a_lens_that_turns_at_the_rim_is_moved_to_reach_it(excess: float) -> None:
    rim = circle(reach(TURNING) + excess)
    camera, reaches = reaching(TURNING, COVARIANCE, rim)
    assert reaches
    assert camera.unproject(rim)[1].all()
    assert reach(camera) > reach(TURNING)


def test_a_lens_that_turns_beyond_the_rim_is_left_alone() -> None:
    camera, reaches = reaching(TURNING, COVARIANCE, circle(0.95 * reach(TURNING)))
    assert reaches
    assert camera is TURNING


def test_moves_begin_at_nothing() -> None:
    """A rim that is nearly far enough inside hardly moves the lens."""
    rim = circle(reach(TURNING) / 1.03 + 0.02)
    camera, _ = reaching(TURNING, COVARIANCE, rim)
    assert 0 < np.abs(camera.k - TURNING.k).max() < 2e-4


def test_a_rim_out_of_belief_is_said_and_not_forced() -> None:
    camera, reaches = reaching(TURNING, COVARIANCE, circle(1.5 * reach(TURNING)))
    assert not reaches
    assert camera is TURNING


def test_the_move_is_the_nearest_by_the_covariance() -> None:
    """What is sure stays: a centre and coefficients without variance do not move."""
    sure = np.zeros((9, 9))
    sure[1, 1] = 0.02**2
    camera, reaches = reaching(TURNING, sure, circle(reach(TURNING) + 1.0))
    assert reaches
    changed = np.flatnonzero(camera.to_vector() != TURNING.to_vector())
    np.testing.assert_array_equal(changed, [1])


def test_rim_of_a_full_picture_is_its_corners() -> None:
    picture = np.full((240, 320, 3), 120, np.uint8)
    rim = find_rim(picture)
    assert {tuple(point) for point in rim} == {(u, v) for u in (0, 319) for v in (0, 239)}


def test_rim_ends_at_a_dark_surround() -> None:
    radius = np.hypot(*(find_rim(shown(150.0)) - (SIZE - 1) / 2).T)
    assert radius.max() == pytest.approx(150.0, abs=2.0)
    assert radius.min() > 145.0


def test_a_date_in_a_black_corner_is_not_shown_by_the_lens() -> None:
    picture = shown(150.0)
    picture[300:310, 280:312] = 220
    assert np.hypot(*(find_rim(picture) - (SIZE - 1) / 2).T).max() < 153.0


def inner_lines(most: float) -> list[Curve]:
    """Pictures of straight lines that stay within a radius."""
    rng, curves = np.random.default_rng(2), []
    while len(curves) < 40:
        ends = rng.uniform(10, SIZE - 10, (2, 2))
        if np.hypot(*(ends[1] - ends[0])) < 60 or not TURNING.unproject(ends)[1].all():
            continue
        rays, _ = TURNING.unproject(ends)
        t = np.linspace(0, 1, 120)[:, None]
        points, _ = TURNING.project(rays[:1] * (1 - t) + rays[1:] * t)
        if np.hypot(*(points - (SIZE - 1) / 2).T).max() < most:
            curves.append(Curve(points + rng.normal(0, 0.1, points.shape), 0.2, 1.0))
    return curves


def test_fit_reaches_the_rim_or_says_that_it_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    curves = inner_lines(130.0)
    alone = fit_lens([curves], SIZE, SIZE)
    assert alone.camera is not None
    near, far = circle(reach(alone.camera) + 1.0), circle(2.5 * reach(alone.camera))
    fit = fit_lens([curves], SIZE, SIZE, rims=[near])
    assert alone.camera.theta_max > np.radians(75)  # a flat picture shows nothing of the rim
    assert fit.camera == alone.camera
    assert fit.reason == alone.reason
    monkeypatch.setattr("classical.fit.reach._SHOWN", np.pi)
    fit = fit_lens([curves], SIZE, SIZE, rims=[near])
    assert fit.camera is not None
    assert fit.camera.unproject(near)[1].all()
    assert not alone.camera.unproject(near)[1].all()
    fit = fit_lens([curves], SIZE, SIZE, rims=[far])
    assert fit.status == "degraded"
    assert "rim" in fit.reason

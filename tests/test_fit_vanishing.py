"""Absolute scale from scenes whose lines run along three orthogonal directions."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from classical.camera import KannalaBrandt
from classical.fit import FitConfig, fit_lens, generic_prior, scale_from_directions
from classical.fit.scale import fused_scale, scale_row, scale_tangent, scale_variance
from classical.fit.vanishing import ScaleEstimate, rescaled
from classical.lines import Curve

LENS = KannalaBrandt.centred(np.array([0.8, 0.01, -0.005, 0.0, 0.0]), 640, 480)


def manhattan_normals(n: int, rng: np.random.Generator, *, noise: float = 0.0) -> np.ndarray:
    """Normals of great circles through three orthogonal directions, none of them on the axis."""
    frame = Rotation.from_euler("yxz", [0.6, 0.35, 0.1]).as_matrix()
    directions = frame[rng.integers(0, 3, n)]
    normals = np.cross(directions, rng.normal(size=(n, 3)))
    normals += noise * rng.normal(size=(n, 3)) * np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def as_seen(normals: np.ndarray, scale: float) -> np.ndarray:
    """Normals under a camera whose rays are (x / scale, y / scale, z)."""
    moved = normals * [1.0, 1.0, 1 / scale]
    return moved / np.linalg.norm(moved, axis=1, keepdims=True)


@pytest.mark.parametrize("scale", [0.8, 1.0, 1.25])
def test_scale_is_recovered(scale: float) -> None:
    rng = np.random.default_rng(0)
    normals = as_seen(manhattan_normals(60, rng, noise=0.003), scale)
    estimate = scale_from_directions(normals, np.ones(60), np.full(60, 0.003), rng=rng)
    assert estimate is not None
    assert estimate.log_scale == pytest.approx(np.log(scale), abs=0.03)
    np.testing.assert_allclose(estimate.frame @ estimate.frame.T, np.eye(3), atol=1e-9)


def test_stray_lines_do_not_vote() -> None:
    rng = np.random.default_rng(1)
    stray = rng.normal(size=(20, 3))
    stray /= np.linalg.norm(stray, axis=1, keepdims=True)
    normals = np.concatenate([as_seen(manhattan_normals(60, rng, noise=0.003), 1.2), stray])
    estimate = scale_from_directions(normals, np.ones(80), np.full(80, 0.003), rng=rng)
    assert estimate is not None
    assert estimate.log_scale == pytest.approx(np.log(1.2), abs=0.05)


def test_one_direction_says_nothing() -> None:
    rng = np.random.default_rng(2)
    direction = np.array([0.3, 0.9, 0.2])
    normals = np.cross(direction, rng.normal(size=(40, 3)))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert scale_from_directions(normals, np.ones(40), np.full(40, 0.003), rng=rng) is None


def test_few_lines_say_nothing() -> None:
    rng = np.random.default_rng(3)
    normals = manhattan_normals(6, rng)
    assert scale_from_directions(normals, np.ones(6), np.full(6, 0.003), rng=rng) is None


def test_rescaling_keeps_straight_lines_straight() -> None:
    """(tan θ)' = s tan θ: rectified positions only grow by s."""
    points = np.stack(np.meshgrid(np.arange(0, 640, 40.0), np.arange(0, 480, 40.0)), -1)
    points = points.reshape(-1, 2)
    rays, _ = LENS.unproject(points)
    moved, _ = rescaled(LENS, 1.15).unproject(points)
    rays, moved = rays[rays[:, 2] > 0.3], moved[rays[:, 2] > 0.3]
    expected = 1.15 * rays[:, :2] / rays[:, 2:]
    np.testing.assert_allclose(moved[:, :2] / moved[:, 2:], expected, atol=2e-3)


BOX_LENS = KannalaBrandt.centred(np.array([0.8, 0.1, 0.01, 0.0, 0.0]), 640, 480)


def box_picture(angles: list[float], seed: int) -> list[Curve]:
    """Lines of a box turned by `angles`, seen by a lens of unusual shape."""
    rng = np.random.default_rng(seed)
    frame = Rotation.from_euler("yxz", angles).as_matrix()
    curves = []
    while len(curves) < 90:
        start = rng.uniform([-2, -2, 0.5], [2, 2, 4])
        line = start + np.linspace(0, 1.5, 120)[:, None] * frame[len(curves) % 3]
        points, valid = BOX_LENS.project(line / np.linalg.norm(line, axis=1, keepdims=True))
        inside = valid & (points >= 0).all(1) & (points < [640, 480]).all(1)
        if inside.all() and np.hypot(*(points[-1] - points[0])) > 60:
            curves.append(Curve(points + rng.normal(0, 0.15, points.shape), 0.15, 1.0))
    return curves


def test_fit_takes_its_scale_from_the_scene() -> None:
    """The prior alone is off, the scene is not."""
    curves = box_picture([0.6, 0.3, 0.1], seed=4)
    without = fit_lens([curves], 640, 480, config=FitConfig(vanishing=None))
    fit = fit_lens([curves], 640, 480)
    assert fit.camera is not None
    assert without.camera is not None
    assert fit.scale_source == "vanishing points"
    assert fit.scale_deviation < without.scale_deviation
    assert abs(fit.camera.k[0] - 0.8) < abs(without.camera.k[0] - 0.8)
    assert fit.camera.k[0] == pytest.approx(0.8, rel=0.04)


def test_each_picture_votes_with_its_own_directions() -> None:
    pictures = [box_picture([0.6, 0.3, 0.1], seed=4), box_picture([-0.4, -0.25, 0.3], seed=5)]
    fit = fit_lens(pictures, 640, 480)
    assert fit.camera is not None
    assert fit.scale_source == "vanishing points"
    assert fit.camera.k[0] == pytest.approx(0.8, rel=0.04)


@pytest.mark.parametrize("k1", [0.5, 0.8, 1.3])
def test_the_scale_moves_by_one_along_its_own_direction(k1: float) -> None:
    lens = KannalaBrandt.centred(k1 * np.array([1, -0.03, 0.01, 0, 0]), 640, 480)
    assert scale_row(lens) @ scale_tangent(lens) == pytest.approx(1.0, abs=0.01)


def test_how_sure_a_fused_scale_is_follows_from_the_gain() -> None:
    """Votes count against the scale with all else held; what that leaves open stays open."""
    covariance = generic_prior(0.8, 640, 480).covariance * 0.3**2
    free = [0, 1, 2, 3, 4, 6, 7, 8]
    tangent = scale_tangent(BOX_LENS)[free]
    held = 1 / (tangent @ np.linalg.solve(covariance[np.ix_(free, free)], tangent))
    before = scale_variance(BOX_LENS, covariance)
    assert before > 1.5 * held
    votes = ScaleEstimate(0.1, float(np.sqrt(held)), np.eye(3), np.ones(3))
    fused = fused_scale(BOX_LENS, covariance, [votes])
    assert fused is not None
    assert fused.gain == pytest.approx(0.5)
    after = scale_variance(BOX_LENS, fused.covariance)
    assert after == pytest.approx(before / 4 + held / 4, rel=0.01)
    assert np.linalg.eigvalsh(fused.covariance[np.ix_(free, free)]).min() > 0

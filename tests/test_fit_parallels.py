"""Directions of parallel lines: found, held to, and of no say in the scale."""

import numpy as np
import pytest

from classical.camera import KannalaBrandt
from classical.fit import FitConfig, ParallelsConfig, fit_lens
from classical.fit.parallels import Parallels, find_parallels
from classical.fit.quality import rectified_grid
from classical.fit.samples import CurveSamples, sample_curves
from classical.fit.scale import held_scale
from classical.fit.straightness import straightness
from classical.fit.vanishing import rescaled
from classical.lines import Curve

WIDTH, HEIGHT = 640, 480
LENS = KannalaBrandt(
    np.array([0.75, 0.01, -0.005, 0.0, 0.0]), 320.0, 320.0, 331.0, 230.0, WIDTH, HEIGHT
)
OTHER = KannalaBrandt(
    np.array([0.78, 0.03, -0.01, 0.0, 0.0]), 320.0, 321.0, 322.0, 238.0, WIDTH, HEIGHT
)
DIRECTIONS = np.array([[1.0, 0.1, 0.4], [-0.2, 1.0, 0.1], [-0.5, 0.0, 1.0]])


def short_lines(
    lens: KannalaBrandt, per_direction: int, rng: np.random.Generator, *, noise: float = 0.0
) -> list[Curve]:
    """Pictures of short lines along three directions, direction by direction."""
    curves: list[Curve] = []
    for direction in DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True):
        found = 0
        while found < per_direction:
            middle, valid = lens.unproject(rng.uniform([60, 60], [580, 420], (1, 2)))
            steps = np.linspace(-0.14, 0.14, 60)[:, None]
            points, seen = lens.project(middle + steps * direction)
            length = np.hypot(*(points[-1] - points[0]))
            if valid.all() and seen.all() and length > 25:
                curves.append(Curve(points + rng.normal(0, noise, points.shape), 0.2, 1.0))
                found += 1
    return curves


def samples_of(curves: list[Curve], pictures: list[int] | None = None) -> CurveSamples:
    numbers = None if pictures is None else np.array(pictures)
    return sample_curves(curves, spacing=6.0, pictures=numbers)


def directions_of(
    samples: CurveSamples, camera: KannalaBrandt, *, tolerance: float = 0.02
) -> Parallels:
    count = samples.n_curves
    return find_parallels(
        straightness(camera, samples).normals,
        samples.lengths,
        np.ones(count),
        np.full(count, 0.001),
        np.zeros(count, int) if samples.pictures is None else samples.pictures,
        tolerance=tolerance,
        config=ParallelsConfig(),
    )


def test_lines_of_one_direction_are_one_group() -> None:
    samples = samples_of(short_lines(LENS, 20, np.random.default_rng(1)))
    parallels = directions_of(samples, LENS)

    owners = np.repeat(np.arange(3), 20)
    large = [group for group in parallels.groups if len(group) >= 15]
    assert len(large) == 3
    for group in large:
        values, counts = np.unique(owners[group], return_counts=True)
        assert counts.max() >= len(group) - 3, values
    residuals = Parallels(large, [np.ones(len(group)) for group in large]).residuals(
        straightness(LENS, samples).normals
    )
    assert np.median(np.abs(residuals)) < 1e-4


def test_lines_of_no_direction_are_no_group() -> None:
    rng = np.random.default_rng(2)
    normals = rng.normal(size=(30, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ones = np.ones(30)
    found = find_parallels(
        normals, 100 * ones, ones, 1e-4 * ones, np.zeros(30, int), tolerance=0.002,
        config=ParallelsConfig(),
    )  # fmt: skip
    assert not found.groups
    assert found.residuals(normals).shape == (0,)
    assert found.jacobian(normals, np.zeros((3, 9, 30))).shape == (0, 9)


def test_pictures_share_no_direction() -> None:
    curves = short_lines(LENS, 12, np.random.default_rng(3))
    pictures = [number % 2 for number in range(len(curves))]
    for group in directions_of(samples_of(curves, pictures), LENS).groups:
        assert len({pictures[curve] for curve in group}) == 1


def test_a_coarse_choice_keeps_the_pictures_of_its_curves() -> None:
    curves = short_lines(LENS, 4, np.random.default_rng(3))
    samples = samples_of(curves, list(range(len(curves))))
    coarse = samples.coarse(curves=5, most=6)
    assert coarse.pictures is not None
    longest = np.sort(np.argsort(-samples.lengths, kind="stable")[:5])
    assert coarse.pictures.tolist() == longest.tolist()


def test_pictures_of_one_scene_count_as_one() -> None:
    curves = short_lines(LENS, 12, np.random.default_rng(3))
    once = directions_of(samples_of(curves), LENS)
    four = directions_of(samples_of(curves * 4, [n for n in range(4) for _ in curves]), LENS)
    told = [sum((weight**2).sum() for weight in each.weights) for each in (once, four)]
    assert told[1] == pytest.approx(told[0], rel=0.2)


def test_the_jacobian_gives_the_gradient_of_the_squares() -> None:
    """It leaves out how residuals turn with d, to which they are orthogonal."""
    samples = samples_of(short_lines(LENS, 12, np.random.default_rng(4), noise=0.05))
    now = straightness(OTHER, samples)
    parallels = directions_of(samples, OTHER, tolerance=0.05)
    residuals = parallels.residuals(now.normals)
    assert len(residuals) > 20
    gradient = residuals @ parallels.jacobian(now.normals, now.normal_jacobian)

    vector = OTHER.to_vector()
    for column in (0, 1, 2, 3, 4, 6, 7, 8):
        step = 1e-5 * max(1.0, abs(vector[column]))
        costs = []
        for sign in (1, -1):
            moved = vector.copy()
            moved[column] += sign * step
            camera = KannalaBrandt.from_vector(moved, WIDTH, HEIGHT)
            moved_residuals = parallels.residuals(straightness(camera, samples).normals)
            costs.append(0.5 * np.sum(moved_residuals**2))
        assert gradient[column] == pytest.approx((costs[0] - costs[1]) / (2 * step), rel=1e-3)


def test_directions_hold_the_principal_point() -> None:
    errors = {}
    for parallels in (None, ParallelsConfig()):
        config = FitConfig(parallels=parallels, vanishing=None, perspective=None)
        off = []
        for seed in range(4):
            curves = short_lines(LENS, 25, np.random.default_rng(seed), noise=0.15)
            camera = fit_lens([curves], WIDTH, HEIGHT, config=config).camera
            assert camera is not None
            off.append(np.hypot(camera.u0 - LENS.u0, camera.v0 - LENS.v0))
        errors[parallels is not None] = float(np.mean(off))
    assert errors[True] < 0.7 * errors[False], errors


def test_parallel_lines_tell_no_scale() -> None:
    samples = samples_of(short_lines(LENS, 20, np.random.default_rng(5)))
    groups = directions_of(samples, LENS).groups
    even = Parallels(groups, [np.ones(len(group)) for group in groups])
    other = rescaled(LENS, 1.25)
    residuals = even.residuals(straightness(other, samples).normals)
    assert np.median(np.abs(residuals)) < 1e-3


@pytest.mark.parametrize("factor", [0.97, 1.04])
def test_the_held_scale_measures_the_rectified_size(factor: float) -> None:
    held = held_scale(LENS)
    vector = LENS.to_vector()
    bigger = rescaled(LENS, factor).to_vector()
    told = (held.matrix @ (bigger - vector))[0]
    assert told == pytest.approx(np.log(factor), rel=0.1)
    positions, by_camera = rectified_grid(LENS)
    assert positions.shape == (by_camera.shape[0], 2)

"""Lenses that bend next to nothing."""

import numpy as np

from learned.slf.lens_shape import radius
from learned.slf.perspective import perspective_lenses
from learned.slf.stream import lens_block


def bends(lenses) -> np.ndarray:
    """How far r / tan θ leaves a constant up to the corner, relative, one a lens."""
    theta = np.linspace(0.05, 1.0, 50) * lenses.theta_max[:, None]
    focal = radius(theta, lenses.vector[:, :5]) / np.tan(theta)
    return np.ptp(focal, axis=1) / focal.mean(axis=1)


def test_straight_lines_stay_all_but_straight():
    lenses = perspective_lenses(np.random.default_rng(0), 400)
    bend = bends(lenses)
    assert np.quantile(bend, 0.99) < 0.05
    assert bend.std() > 0.002  # cameras leave a rest
    assert (lenses.theta_max < np.radians(70)).all()


def test_the_same_generator_draws_the_same_lenses():
    first, second = (perspective_lenses(np.random.default_rng(5), 8) for _ in range(2))
    np.testing.assert_array_equal(first.vector, second.vector)


def test_a_block_has_its_share_of_them_and_keeps_its_other_lenses():
    scenes = (0.25, 0.25, 0.25, 0.25)
    without = [lens_block(3, i, scenes, 0.8)[1] for i in range(8)]
    with_ = [lens_block(3, i, scenes, 0.8, 0.25)[1] for i in range(8)]
    straight = np.concatenate([bends(lenses) < 0.06 for lenses in with_])
    assert 0.15 < straight.mean() < 0.35
    for before, after in zip(without, with_, strict=True):
        kept = (before.vector == after.vector).all(axis=1)
        assert (bends(after)[~kept] < 0.06).all()
        assert kept.mean() > 0.5


def test_a_share_of_fisheyes_changes_wild_lenses_alone():
    scenes = (0.25, 0.25, 0.25, 0.25)
    without = [lens_block(3, i, scenes, 0.8, 0.25) for i in range(8)]
    with_ = [lens_block(3, i, scenes, 0.8, 0.25, 0.5) for i in range(8)]
    kept = []
    for (scene, before), (same_scene, after) in zip(without, with_, strict=True):
        np.testing.assert_array_equal(scene, same_scene)
        kept.append((before.vector == after.vector).all(axis=1))
        assert kept[-1][scene == 0].all()  # planes take no wild lens
    share = 1 - np.concatenate(kept).mean()  # 3/4 no planes, 4/5 wild, 3/4 not straight, half
    assert 0.15 < share < 0.3

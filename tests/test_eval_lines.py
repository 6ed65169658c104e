"""Line maps, their matching and straightness against hand-made cases."""

import itertools

import cv2
import numpy as np
import pytest

from classical.camera import KannalaBrandt, Pinhole
from eval.frame import Similarity
from eval.lines import (
    THRESHOLDS,
    count_matches,
    draw_line_map,
    grid_lines,
    match_line_maps,
    straightness,
    thin,
)

EQUIDISTANT = KannalaBrandt.centred(np.array([1.0, 0, 0, 0, 0]), 320, 320)


def line_map(*rows: tuple[int, int, int]) -> np.ndarray:
    """Level lines (row, first column, length) with their length as value, one pixel wide."""
    canvas = np.zeros((100, 100), dtype=np.uint8)
    for row, column, length in rows:
        canvas[row, column : column + length] = length
    return canvas


def brute_force(found: np.ndarray, true: np.ndarray, limit: float) -> int:
    near = np.linalg.norm(found[:, None] - true[None], axis=2) <= limit
    best = 0
    for order in itertools.permutations(range(len(true)), min(len(found), len(true))):
        for rows in itertools.combinations(range(len(found)), len(order)):
            best = max(best, sum(near[r, c] for r, c in zip(rows, order, strict=True)))
    return best


def test_matching_is_one_to_one():
    true = np.array([[0.0, 0.0]])
    found = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]])
    assert count_matches(found, true, 3.0) == 1


def test_matching_gives_way_for_a_larger_one():
    # Greedy would give the only partner of the second point to the first one
    found = np.array([[0.0, 0.0], [0.0, 4.0]])
    true = np.array([[0.0, 1.0], [0.0, -3.0]])
    assert count_matches(found, true, 3.0) == 2


@pytest.mark.parametrize("seed", range(8))
def test_matching_is_the_largest_of_all(seed):
    rng = np.random.default_rng(seed)
    found, true = rng.uniform(0, 6, size=(4, 2)), rng.uniform(0, 6, size=(5, 2))
    assert count_matches(found, true, 1.8) == brute_force(found, true, 1.8)


def test_nothing_matches_beyond_the_tolerance():
    assert count_matches(np.array([[0.0, 0.0]]), np.array([[0.0, 3.1]]), 3.0) == 0
    assert count_matches(np.array([[0.0, 0.0]]), np.array([[0.0, 3.0]]), 3.0) == 1
    assert count_matches(np.zeros((0, 2)), np.zeros((3, 2)), 3.0) == 0


def test_precision_recall_and_f_by_hand():
    # Tolerance 0.0075 · √2 · 100 = 1.06 px: the line of 30 px meets its truth one row below,
    # the one of 50 px is five rows off, and the truth of 20 px was not found.
    found = line_map((10, 20, 30), (45, 20, 50))
    true = line_map((11, 20, 30), (50, 20, 50), (80, 20, 20))
    counts = match_line_maps(found, true)
    at = dict(zip(THRESHOLDS, range(10), strict=True))
    assert counts.true == 100
    assert counts.found[at[20]] == 0
    assert (counts.found[at[40]], counts.matched[at[40]]) == (30, 30)
    assert (counts.found[at[80]], counts.matched[at[80]]) == (80, 30)
    assert counts.precision[at[20]] == 1.0
    assert counts.recall[at[20]] == 0.0
    assert counts.precision[at[80]] == pytest.approx(30 / 80)
    assert counts.recall[at[255]] == pytest.approx(0.3)
    assert counts.f_score == pytest.approx(2 * 1.0 * 0.3 / 1.3)


def test_the_longest_lines_are_within_the_last_threshold():
    canvas = np.zeros((320, 320), dtype=np.uint8)
    canvas[100, 5:315] = 255
    counts = match_line_maps(canvas, canvas)
    assert counts.found.tolist() == [0] * 9 + [310]
    assert counts.f_score == 1.0


def test_equal_maps_are_perfect_and_empty_ones_miss_everything():
    full, empty = line_map((10, 20, 30)), line_map()
    assert match_line_maps(full, full).f_score == 1.0
    assert match_line_maps(empty, full).f_score == 0.0


def test_a_drawn_line_has_its_length_and_width():
    canvas = draw_line_map([np.array([[20.0, 50.0], [60.0, 50.0]])], 100, 100)
    assert canvas.max() == 40
    assert (canvas[:, 40] > 0).sum() == 3
    assert canvas[50, 40] == 40


def test_long_lines_are_clipped_and_lie_on_top():
    short, long = np.array([[50.0, 0], [50, 99]]), np.array([[0.0, 50], [319, 50]])
    canvas = draw_line_map([long, short], 320, 100)
    assert canvas[50, 50] == 255


def test_thinning_keeps_the_middle_and_its_value():
    canvas = np.zeros((60, 60), dtype=np.uint8)
    cv2.line(canvas, (10, 30), (50, 30), 77, 5)
    skeleton = thin(canvas)
    assert set(np.unique(skeleton)) == {0, 77}
    assert np.flatnonzero(skeleton[:, 30]).tolist() == [30]


def test_straight_lines_have_no_deviation_under_the_truth():
    curves = grid_lines(EQUIDISTANT, theta_max=np.radians(50))
    assert len(curves) == 14
    assert straightness(EQUIDISTANT, curves, 320, 320) == pytest.approx(0, abs=1e-6)


def test_straightness_of_three_points_by_hand():
    # Best line of (0, 0), (2, 0), (1, 0.3): y = 0.1, distances 0.1, 0.1, 0.2
    curve = np.array([[0.0, 0.0], [1.0, 0.3], [2.0, 0.0]])
    expected = np.sqrt((0.01 + 0.01 + 0.04) / 3)
    assert straightness(None, [curve], 320, 320) == pytest.approx(expected)
    assert straightness(None, [curve], 640, 640) == pytest.approx(expected / 2)
    double = Similarity(scale=2.0)
    found = straightness(None, [curve], 320, 320, similarity=double)
    assert found == pytest.approx(2 * expected)


def test_bent_lines_of_a_pinhole_picture_show_their_sagitta():
    curves = grid_lines(EQUIDISTANT, theta_max=np.radians(50))
    alone = straightness(None, curves, 320, 320)
    pinhole = straightness(Pinhole.centred(160.0, 320, 320), curves, 320, 320)
    assert alone == pytest.approx(pinhole)
    assert 2 < alone < 20


def test_no_lines_is_no_number():
    assert np.isnan(straightness(None, [], 320, 320))

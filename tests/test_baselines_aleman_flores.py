"""Laws of the Alemán-Flores baselines."""

import json
import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from classical.baselines import TwoParameterDivision, aleman_flores
from classical.baselines.aleman_flores import AlemanFloresConfig
from classical.baselines.aleman_flores.cleaning import clean_edges
from classical.baselines.aleman_flores.edges import EdgePoints, detect_edges, smoothing_kernel
from classical.baselines.aleman_flores.energy import LineEnergy
from classical.baselines.aleman_flores.hough import HoughMaxima, hough_search, undistort_edges
from classical.baselines.aleman_flores.lines import LineSet, fit_lines, lines_from_maxima
from classical.baselines.aleman_flores.refine import Refined, coefficient, refine_p
from classical.baselines.aleman_flores.refine_two import coefficients, growths, refine_two
from classical.baselines.two_parameter import division, farthest_corner, is_invertible
from classical.camera import Division

WIDTH, HEIGHT = 640, 480
RADIUS = float(np.hypot(WIDTH, HEIGHT)) / 2
CENTRE = (WIDTH / 2, HEIGHT / 2)


def striped_picture(model: Division, *, over: int = 3) -> np.ndarray:
    """Stripes of two directions in the undistorted plane, seen through the model, with noise."""
    size = (model.width * over, model.height * over)
    u, v = np.meshgrid(
        (np.arange(size[0]) + 0.5) / over - 0.5, (np.arange(size[1]) + 0.5) / over - 0.5
    )
    flat = model.undistort(np.stack([u.ravel(), v.ravel()], axis=1))[0]
    x, y = (flat - np.array([model.u0, model.v0])).T
    x, y = np.cos(0.1) * x - np.sin(0.1) * y, np.sin(0.1) * x + np.cos(0.1) * y
    stripe = np.floor(np.where(x < 0, y, x) / (model.width / 10)) % 2
    large = (60 + 130 * stripe).reshape(size[::-1]).astype(np.float32)
    grey = cv2.resize(large, (model.width, model.height), interpolation=cv2.INTER_AREA)
    grey = grey + np.random.default_rng(0).normal(0, 2, grey.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def bent_lines(k: float, count: int = 20, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points of straight lines seen through the model about the middle, and their line."""
    rng = np.random.default_rng(seed)
    model = Division(k, *CENTRE, WIDTH, HEIGHT)
    points, labels = [], []
    while len(points) < count:
        angle, distance = rng.uniform(0, np.pi), rng.uniform(-250, 250)
        t = np.linspace(-2000, 2000, 4000)
        normal = np.array([np.cos(angle), np.sin(angle)])
        line = distance * normal + t[:, None] * np.array([-normal[1], normal[0]])
        seen, valid = model.distort(line + np.array(CENTRE))
        seen = seen[valid & (seen > 0).all(axis=1) & (seen < [WIDTH, HEIGHT]).all(axis=1)]
        if len(seen) > 50:
            labels.append(np.full(len(seen), len(points)))
            points.append(seen)
    return np.concatenate(points), np.concatenate(labels)


def test_p_is_the_growth_of_the_radius_at_the_corner():
    k = coefficient(0.89, RADIUS)
    assert 1 / (1 + k * RADIUS**2) == pytest.approx(1.89)


@pytest.mark.parametrize("sigma", [1.0, 2.0, 3.0])
def test_smoothing_has_its_standard_deviation(sigma: float):
    kernel = smoothing_kernel(sigma)
    offset = np.arange(len(kernel)) - len(kernel) // 2
    assert kernel.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(kernel, kernel[::-1])
    assert np.sqrt((kernel * offset**2).sum()) == pytest.approx(sigma, rel=0.01)


def test_edges_of_a_step_lie_on_it_and_point_to_the_bright_side():
    grey = np.full((60, 80), 50.0, np.float32)
    grey[:, 40:] = 200.0
    edges = detect_edges(grey, config=AlemanFloresConfig())
    assert len(edges) >= 50
    assert np.abs(edges.points[:, 0] - 39.5).max() <= 0.5
    np.testing.assert_allclose(edges.normals, [[1.0, 0.0]] * len(edges), atol=1e-6)


def test_cleaning_keeps_one_point_a_cell_and_drops_the_lonely():
    line = np.stack([np.arange(10.0, 60.0), np.full(50, 30.0)], axis=1)
    points = np.concatenate([line, [[5.0, 5.0]]])
    edges = EdgePoints(points, np.tile([0.0, 1.0], (51, 1)))
    cleaned = clean_edges(edges, 80, 60)
    cells = cleaned.points // 3
    assert len(np.unique(cells, axis=0)) == len(cleaned) == 17
    assert cleaned.points[:, 1].min() == 30.0


def test_normals_follow_the_curve_that_the_points_follow():
    rng = np.random.default_rng(0)
    points, angle = rng.uniform(-300, 300, (50, 2)), rng.uniform(0, 2 * np.pi, 50)
    tangents = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    normals = np.stack([tangents[:, 1], -tangents[:, 0]], axis=1)
    k1, k2, h = -1.5e-6, -2e-12, 1e-3
    moved, turned = undistort_edges(points, normals, k1, k2)
    ahead, _ = undistort_edges(points + h * tangents, normals, k1, k2)
    behind, _ = undistort_edges(points - h * tangents, normals, k1, k2)
    along = (ahead - behind) / np.linalg.norm(ahead - behind, axis=1, keepdims=True)
    squared = (points**2).sum(axis=1, keepdims=True)
    np.testing.assert_allclose(moved, points / (1 + k1 * squared + k2 * squared**2))
    np.testing.assert_allclose((turned * along).sum(axis=1), 0, atol=1e-7)
    assert ((turned[:, 0] * along[:, 1] - turned[:, 1] * along[:, 0]) > 0.99).all()


def brute_force_maxima(
    points: np.ndarray, normals: np.ndarray, end: int, config: AlemanFloresConfig
) -> list[tuple[int, int, float]]:
    """Voting and picking as written in the article: five bins a vote, one maximum at a time.

    Votes for distances from `end` on do not count.
    """
    step, reach, n = np.deg2rad(config.angle_step_deg), config.angle_reach, config.n_angles
    centre = int(np.hypot(*points.T).max()) + 20
    score = np.zeros((n, 2 * centre + 1))
    for (x, y), (nu, nv) in zip(points, normals, strict=True):
        row = round(np.arctan2(nv, nu) / step) % n
        for j in range(row - reach, row + reach + 1):
            a = j * step
            d = int(np.floor(x * np.cos(a) + y * np.sin(a) + centre + 0.5)) - centre
            if abs(d) >= end:
                continue
            sign = 1 if 0 <= j < n else -1
            for nd in range(-2, 3):
                score[j % n, centre + sign * (d + nd)] += 1 / (1 + abs(nd))
    free = np.ones_like(score, bool)
    wide = np.concatenate([score[-1:, ::-1], score, score[:1, ::-1]])
    peak = np.ones_like(free)
    peak[:, [0, -1]] = False
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            shifted = np.roll(wide, (-down, -right), axis=(0, 1))[1:-1]
            peak &= score >= shifted - 1e-9
    picked = []
    rows, columns = round(config.clear_angle_deg / config.angle_step_deg), config.clear_distance
    for _ in range(config.maxima):
        best = np.where(free & peak, score, -1.0)
        row, column = np.unravel_index(np.argmax(np.round(best, 6)), best.shape)
        picked.append((int(row), int(column) - centre, float(score[row, column])))
        for r in range(row - rows, row + rows + 1):
            c = column if 0 <= r < n else 2 * centre - column
            free[r % n, max(c - columns, 0) : c + columns + 1] = False
    return picked


@pytest.mark.parametrize(("radius", "end"), [(100.0, 200), (60.0, 74)])
def test_maxima_are_those_of_the_votes_counted_one_by_one(radius: float, end: int):
    rng = np.random.default_rng(3)
    config = AlemanFloresConfig(
        angle_step_deg=1.0, angle_max_deg=5.0, clear_angle_deg=2.0, clear_distance=4, maxima=6
    )
    t = rng.uniform(-80, 80, 60)
    line = np.stack([t, np.full(60, 7.0) + 0.02 * t], axis=1)  # angle near 90°
    edge = np.stack([np.full(60, -30.0) + 0.005 * t, t], axis=1)  # angle near 0° = 180°
    points = np.concatenate([line, edge, rng.uniform(-80, 80, (40, 2))])
    angle = rng.uniform(0, 2 * np.pi, 40)
    normals = np.concatenate(
        [[[0.0, 1.0]] * 60, [[1.0, -0.01]] * 60, np.stack([np.cos(angle), np.sin(angle)], 1)]
    )
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found = hough_search(points, normals, radius, np.zeros(1), config=config)
    expected = brute_force_maxima(points, normals, end, config)
    np.testing.assert_allclose(found.scores, [score for _, _, score in expected])
    rows = np.rint(np.rad2deg(found.angles))
    assert [(int(r), int(d)) for r, d in zip(rows, found.distances, strict=True)] == [
        (row, distance) for row, distance, _ in expected
    ]


def test_search_does_not_depend_on_the_number_of_workers():
    points, labels = bent_lines(coefficient(0.4, RADIUS), count=8)
    about = points - np.array(CENTRE)
    normals = np.zeros_like(about)
    for i in range(8):
        tangent = np.gradient(about[labels == i], axis=0)
        normals[labels == i] = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    slices = np.array([0.0, 0.2, 0.4, 0.6])
    one, three = (
        hough_search(about, normals, RADIUS, slices, config=AlemanFloresConfig(workers=workers))
        for workers in (1, 3)
    )
    assert one.p == three.p == 0.4
    np.testing.assert_array_equal(one.slice_scores, three.slice_scores)
    np.testing.assert_array_equal(one.distances, three.distances)


@pytest.mark.parametrize("variant", ["2014", "2016"])
@pytest.mark.parametrize("p", [0.0, 0.4, 0.9])
def test_first_look_finds_the_slice_of_the_full_search(variant: aleman_flores.Variant, p: float):
    image = striped_picture(Division(coefficient(p, RADIUS), *CENTRE, WIDTH, HEIGHT))
    config = AlemanFloresConfig.for_variant(variant, p_max=1.5)
    edges = detect_edges(image.astype(np.float32), config=config)
    slices = np.linspace(0, 1.5, 16)
    quick, full = (
        hough_search(
            edges.points - np.array(CENTRE),
            edges.normals,
            RADIUS,
            slices,
            config=replace(config, coarse_angles=coarse),
        )
        for coarse in (5, 1)
    )
    assert len(quick.slice_p) < len(full.slice_p) == 16
    assert quick.p == full.p == pytest.approx(p)
    np.testing.assert_array_equal(quick.distances, full.distances)
    np.testing.assert_array_equal(quick.scores, full.scores)


def test_lines_beyond_the_range_are_not_looked_for():
    t = np.arange(-50.0, 50.0)
    points, normals = np.stack([t, np.full(100, 130.0)], axis=1), np.tile([0.0, 1.0], (100, 1))
    config = AlemanFloresConfig(angle_step_deg=1.0, angle_max_deg=2.0)
    near = hough_search(points, normals, 100.0, np.zeros(1), config=config)
    far = hough_search(
        points, normals, 100.0, np.zeros(1), config=replace(config, distance_range=1.5)
    )
    assert len(near.scores) == 0
    assert far.distances[0] == 130.0


@pytest.mark.parametrize(("side", "count"), [(1.0, 1), (-1.0, 2)])
def test_pieces_of_a_line_merge_if_they_grow_bright_to_the_same_side(side: float, count: int):
    t = np.append(np.arange(-100.0, -20.0), np.arange(20.0, 100.0))
    points = np.stack([t, 0.08 * t], axis=1)
    points[:, 1] += np.where(t < 0, 4.0, -4.0)
    normals = np.stack([np.zeros(160), np.where(t < 0, 1.0, side)], axis=1)
    maxima = HoughMaxima(
        0.0, np.full(2, np.pi / 2 + 0.08), np.array([4.0, -4.0]), np.ones(2), np.ones(1), np.ones(1)
    )
    config = AlemanFloresConfig.for_variant("2016", collect_slack=0.0)
    lines = lines_from_maxima(points, normals, maxima, config=config)
    assert len(lines) == count


def test_points_join_the_first_line_and_near_lines_merge():
    t = np.arange(-100.0, 100.0)
    points = np.concatenate([np.stack([t, np.zeros(200)], 1), np.stack([t, np.full(200, 6.0)], 1)])
    normals = np.tile([0.0, 1.0], (400, 1))
    config = AlemanFloresConfig(angle_step_deg=1.0, maxima=2, clear_distance=3)
    maxima = hough_search(points, normals, 100.0, np.zeros(1), config=config)
    merged = lines_from_maxima(points, normals, maxima, config=config)
    assert len(merged) == 1  # 6 px apart is under the 9 px of the article
    apart = lines_from_maxima(points, normals, maxima, config=replace(config, merge_distance=3.0))
    assert sorted(apart.counts) == [200, 200]


def test_energy_is_the_sum_of_the_total_least_squares_errors():
    rng = np.random.default_rng(1)
    points, labels = rng.uniform(0, 400, (300, 2)), rng.integers(-1, 5, 300)
    k1, k2, centre = -8e-7, -1e-13, (200.0, 150.0)
    offset = points - np.array(centre)
    squared = (offset**2).sum(axis=1, keepdims=True)
    flat = offset / (1 + k1 * squared + k2 * squared**2)
    normals, distances, errors = fit_lines(flat, labels, 5)
    member = labels >= 0
    off = (flat[member] * normals[labels[member]]).sum(axis=1) - distances[labels[member]]
    assert errors.sum() == pytest.approx((off**2).sum())
    assert LineEnergy(points, labels)(k1, k2, centre) == pytest.approx(errors.sum(), rel=1e-6)


def test_refinement_of_2014_finds_p_of_exact_points():
    points, labels = bent_lines(coefficient(0.63, RADIUS))
    refined = refine_p(points, labels, 0.6, CENTRE, RADIUS, config=AlemanFloresConfig())
    assert refined.converged
    assert refined.p[0] == pytest.approx(0.63, rel=1e-4)


def test_refinement_of_2016_finds_the_centre_of_exact_points():
    k = coefficient(0.5, RADIUS)
    points, labels = bent_lines(k)
    start = Refined(growths(0.8 * k, 0.0, RADIUS), (CENTRE[0] + 6, CENTRE[1] - 4), 0.0, 0, False)
    config = AlemanFloresConfig.for_variant("2016")
    refined = refine_two(points, labels, start, (WIDTH, HEIGHT), config=config)
    assert np.hypot(*(np.array(refined.centre) - CENTRE)) < 0.1
    k1, k2 = coefficients(
        refined.p[0], refined.p[1], farthest_corner(*refined.centre, WIDTH, HEIGHT)
    )
    assert k1 + k2 * 200**2 == pytest.approx(k, rel=5e-3)


def test_growths_and_coefficients_are_inverse():
    assert coefficients(*growths(-1.1e-6, -3e-13, RADIUS), RADIUS) == pytest.approx(
        (-1.1e-6, -3e-13)
    )


def test_invertible_is_what_a_fine_sampling_says():
    rng = np.random.default_rng(0)
    t = np.linspace(0, 1, 4001)
    for a, b in zip(rng.uniform(-3, 14, 800), rng.uniform(-16, 3, 800), strict=True):
        margins = (1 + a * t + b * t**2).min(), (1 - a * t - 3 * b * t**2).min()
        if min(np.abs(margins)) > 1e-3:
            assert is_invertible(a, b, 1.0) == (min(margins) > 0), (a, b)


@pytest.mark.parametrize("k2", [0.0, -4e-12, 3e-12])
def test_distort_inverts_undistort(k2: float):
    model = TwoParameterDivision(-1.5e-6, k2, 330.0, 230.0, WIDTH, HEIGHT)
    assert model.is_invertible
    points = np.random.default_rng(0).uniform(0, [WIDTH, HEIGHT], (200, 2))
    flat, valid = model.undistort(points)
    back, found = model.distort(flat)
    assert valid.all()
    assert found.all()
    np.testing.assert_allclose(back, points, atol=1e-6)


def test_two_parameters_with_k2_zero_are_the_division_model():
    points = np.random.default_rng(0).uniform(0, [WIDTH, HEIGHT], (50, 2))
    two = TwoParameterDivision(-4e-6, 0.0, 330.0, 230.0, WIDTH, HEIGHT)
    one = division(-4e-6, 0.0, 330.0, 230.0, WIDTH, HEIGHT)
    assert isinstance(one, Division)
    np.testing.assert_allclose(two.undistort(points)[0], one.undistort(points)[0])
    rays = two.unproject(points)[0]
    np.testing.assert_allclose(rays, one.unproject(points)[0])
    np.testing.assert_allclose(two.project(rays)[0], points, atol=1e-6)


@pytest.mark.parametrize("variant", ["2014", "2016"])
def test_lambda_of_clean_arcs_within_two_percent(variant: aleman_flores.Variant):
    k = coefficient(0.5, RADIUS)
    image = striped_picture(Division(k, *CENTRE, WIDTH, HEIGHT))
    config = AlemanFloresConfig.for_variant(variant, p_max=1.0, workers=1)
    result = aleman_flores.estimate(image, config=config)
    assert result.status == "ok"
    assert result.model is not None
    inner = np.array([[CENTRE[0] + 200.0, CENTRE[1]]])
    moved = result.model.undistort(inner)[0] - result.model.undistort(np.array([CENTRE]))[0]
    lambda_ = (200.0 / np.hypot(*moved[0]) - 1) / 200.0**2
    assert lambda_ == pytest.approx(k, rel=0.02)


def test_a_small_picture_answers_in_its_own_pixels():
    radius = float(np.hypot(320, 320)) / 2
    k = coefficient(0.6, radius)
    image = striped_picture(Division(k, 160.0, 160.0, 320, 320))
    config = AlemanFloresConfig(p_max=1.0)
    result = aleman_flores.estimate(image, config=config)
    assert isinstance(result.model, Division)
    assert aleman_flores.estimate(image, config=config).model == result.model
    assert result.working.grey.shape == (640, 640)
    assert (result.model.width, result.model.height) == (320, 320)
    assert result.model.lambda_ == pytest.approx(k, rel=0.02)
    curves = result.curves()
    assert len(curves) == len(result.lines or ()) > 10
    for curve in curves:
        flat = result.model.undistort(curve)[0]
        assert np.linalg.svd(flat - flat.mean(axis=0))[1][1] / np.sqrt(len(flat)) < 1.0


@pytest.mark.parametrize("variant", ["2014", "2016"])
@pytest.mark.parametrize("sigma", [0.0, 3.0])
def test_noise_alone_is_a_failure_with_its_reason(variant: aleman_flores.Variant, sigma: float):
    noise = np.random.default_rng(0).normal(size=(240, 320)).astype(np.float32)
    noise = cv2.GaussianBlur(noise, (0, 0), sigma) if sigma else noise
    image = np.clip(128 + 50 * noise / noise.std(), 0, 255).astype(np.uint8)
    config = AlemanFloresConfig.for_variant(variant, p_step=0.5)
    result = aleman_flores.estimate(image, config=config)
    assert not result
    assert result.model is None
    assert "chance" in result.reason


def test_an_empty_picture_is_a_failure_with_its_reason():
    result = aleman_flores.estimate(np.full((100, 120, 3), 90, np.uint8))
    assert result.status == "failed"
    assert "edge points" in result.reason


@pytest.mark.parametrize("image", [np.zeros((9, 9)), np.zeros((9, 9, 4), np.uint8)])
def test_other_pictures_are_refused(image: np.ndarray):
    with pytest.raises((ValueError, TypeError)):
        aleman_flores.estimate(image)


def test_config_refuses_what_cannot_be():
    with pytest.raises(ValueError, match="divides 180"):
        AlemanFloresConfig(angle_step_deg=0.7)
    with pytest.raises(ValueError, match="p_step > 0"):
        AlemanFloresConfig(p_step=0.0)


def test_counts_of_an_empty_set_of_lines():
    lines = LineSet(np.zeros((0, 2)), np.zeros(0), np.full(4, -1))
    assert lines.counts.tolist() == []


def shared_references() -> Path | None:
    root = os.environ.get("STRAIGHTLENS_SHARED") or Path(__file__).parents[2] / "shared"
    folder = Path(root) / "data" / "baselines"
    return folder if (folder / "reference.json").exists() else None


@pytest.mark.skipif(shared_references() is None, reason="needs the shared reference pictures")
@pytest.mark.parametrize("answer", ["2014_angle10_lines30", "2014_angle2_lines30", "2016"])
@pytest.mark.parametrize("grid", ["p0.5", "p1.0", "p2.0", "equidistant130"])
def test_grids_agree_with_the_authors_programs(grid: str, answer: str):
    folder = shared_references()
    assert folder is not None
    name = f"grid_{grid}.png"
    entry = next(
        e for e in json.loads((folder / "reference.json").read_text()) if e["image"] == name
    )
    theirs = entry[f"authors_{answer}"]
    image = cv2.imread(str(folder / name))
    assert image is not None
    config = AlemanFloresConfig.for_variant(
        "2016" if answer == "2016" else "2014", angle_max_deg=2.0 if "angle2" in answer else 10.0
    )
    result = aleman_flores.estimate(np.ascontiguousarray(image[..., ::-1]), config=config)
    assert result.model is not None
    radius = float(np.hypot(*entry["size"])) / 4
    expected = radius / (1 + theirs["k1"] * radius**2 + theirs["k2"] * radius**4) - radius
    middle = np.array([[entry["size"][0] / 2 + radius, entry["size"][1] / 2]])
    displacement = (result.model.undistort(middle)[0] - middle)[0, 0]
    assert displacement == pytest.approx(expected, rel=0.015)

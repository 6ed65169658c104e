"""Curves of whole pictures: renders of great circles, boards and clutter with a known lens."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from classical.camera import KannalaBrandt
from classical.lines import (
    Curve,
    HeatmapCurvesConfig,
    ImageCurvesConfig,
    curves_from_both,
    curves_from_heatmap,
    curves_from_image,
    join_curves,
)
from classical.lines.circle import fit_circles
from classical.lines.great_circles import sampson_rays
from classical.lines.pieces import fit_arcs
from classical.lines.smooth import SmoothConfig, smooth_arcs

WIDTH, HEIGHT = 480, 400
LENS = KannalaBrandt.centred(np.array([0.75, -0.03, 0.0, 0.0, 0.0]), WIDTH, HEIGHT)


def normals_of_lines(count, seed):
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3)) * [1, 1, 0.5]
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def picture_of_planes(normals, camera, *, noise=1.5):
    """Every great circle of `normals` flips black and white, a curved chessboard, anti-aliased."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(float)
    rays, _ = camera.unproject(np.stack([u.ravel(), v.ravel()], axis=1))
    parity = np.ones((camera.height, camera.width))
    for normal in normals:
        side = (rays @ normal).reshape(parity.shape)
        distance = side / np.hypot(*np.gradient(side))  # pixels, to first order
        parity *= 2 * np.clip(distance, -0.5, 0.5)
    image = cv2.GaussianBlur(125 + 65 * parity, (0, 0), 0.6)
    rng = np.random.default_rng(1)
    return np.clip(image + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8)


def distances(curve, camera):
    """Sampson distances of a curve's points from its best great circle, pixels."""
    rays, derivative = sampson_rays(curve.points, camera)
    normal = np.linalg.eigh(rays.T @ rays)[1][:, 0]
    return (rays @ normal) / np.linalg.norm(np.einsum("i,nij->nj", normal, derivative), axis=1)


def rms(curve, camera):
    return float(np.sqrt((distances(curve, camera) ** 2).mean()))


NORMALS = normals_of_lines(5, 4)


@pytest.fixture(scope="module")
def image():
    return picture_of_planes(NORMALS, LENS)


@pytest.fixture(scope="module")
def curves(image):
    return curves_from_image(image)


@pytest.fixture(scope="module")
def lines(curves):
    return [curve for curve in curves if curve.length > 60]


def arc(camera, normal, start, stop, *, count=60, noise=0.05, seed=0):
    """A curve on the great circle of `normal` between two angles from its nearest point."""
    normal = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    axis = np.array([0.0, 0.0, 1.0]) - normal * normal[2]
    axis /= np.linalg.norm(axis)
    angle = np.linspace(start, stop, count)[:, None]
    rays = np.cos(angle) * axis + np.sin(angle) * np.cross(normal, axis)
    points, valid = camera.project(rays)
    assert valid.all()
    return Curve(points + np.random.default_rng(seed).normal(0, noise, points.shape), noise, 0.5)


# ---- curves of a picture -------------------------------------------------------------------


def test_curves_of_lines_are_great_circles_to_a_tenth_pixel(curves):
    lengths = np.array([curve.length for curve in curves])
    errors = np.array([rms(curve, LENS) for curve in curves])
    assert lengths @ (errors < 0.1) > 0.9 * lengths.sum()


@pytest.mark.parametrize("normal", NORMALS)
def test_every_line_is_found(normal, curves):
    u, v = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    rays, _ = LENS.unproject(np.stack([u.ravel(), v.ravel()], axis=1))
    on_line = np.abs(rays @ normal) < 0.5 / (LENS.k[0] * LENS.m_u)
    expected = on_line.sum() / 1.27  # pixels in a band of one pixel to length, on average
    found = 0.0
    for curve in curves:
        rays, derivative = sampson_rays(curve.points, LENS)
        away = np.abs(rays @ normal) / np.linalg.norm(
            np.einsum("i,nij->nj", normal, derivative), axis=1
        )
        if np.median(away) < 0.5:
            found += curve.length
    assert found > 0.75 * expected


def test_sigma_is_the_noise_of_the_points(curves):
    errors = [rms(curve, LENS) / curve.sigma for curve in curves if curve.length > 60]
    assert 0.3 < np.median(errors) < 2.0


def test_curves_come_longest_first(curves):
    lengths = [curve.length for curve in curves]
    assert lengths == sorted(lengths, reverse=True)


def test_a_picture_gives_the_same_curves_twice(curves, image):
    again = curves_from_image(image)
    assert len(again) == len(curves)
    assert all(np.array_equal(a.points, b.points) for a, b in zip(again, curves, strict=True))


def test_mirrored_picture_gives_mirrored_curves(curves, image):
    mirrored = curves_from_image(np.ascontiguousarray(image[:, ::-1]))
    errors = [rms(curve, LENS) for curve in mirrored]  # the lens is symmetric
    assert np.median(errors) < 0.1
    total = sum(curve.length for curve in mirrored)
    assert total == pytest.approx(sum(curve.length for curve in curves), rel=0.1)


def test_colour_and_grey_agree(curves, image):
    colour = curves_from_image(np.repeat(image[:, :, None], 3, axis=2))
    assert sum(c.length for c in colour) == pytest.approx(sum(c.length for c in curves), rel=0.02)


def test_small_pictures_are_placed_as_well():
    camera = LENS.resized(240, 200)
    curves = curves_from_image(picture_of_planes(NORMALS, camera))
    lengths = np.array([curve.length for curve in curves])
    errors = np.array([rms(curve, camera) for curve in curves])
    assert lengths.sum() > 400
    assert lengths @ (errors < 0.15) > 0.9 * lengths.sum()


def test_large_pictures_are_refined_at_full_size():
    camera = LENS.resized(960, 800)
    config = ImageCurvesConfig(max_size=480)
    curves = curves_from_image(picture_of_planes(NORMALS, camera), config=config)
    lengths = np.array([curve.length for curve in curves])
    errors = np.array([rms(curve, camera) for curve in curves])
    assert lengths @ (errors < 0.1) > 0.9 * lengths.sum()


@pytest.mark.parametrize("shape", [(1, 1), (1, 300), (5, 5), (64, 64), (50, 60, 3)])
def test_empty_pictures_have_no_curves(shape):
    assert curves_from_image(np.zeros(shape, np.uint8)) == []


@pytest.mark.parametrize("image", [np.zeros((9, 9)), np.zeros((9, 9, 2), np.uint8)])
def test_pictures_of_another_kind_are_refused(image):
    with pytest.raises((ValueError, TypeError)):
        curves_from_image(image)


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 2**31))
def test_noise_of_any_size_is_no_error(height, width, seed):
    noise = np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)
    for curve in curves_from_image(noise):
        assert np.isfinite(curve.points).all()


# ---- what is rejected ----------------------------------------------------------------------


def test_the_border_of_an_image_circle_is_no_curve():
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    radius = np.hypot(u - 240.2, v - 199.1)
    image = np.where(radius < 185, 130, 4).astype(np.uint8)
    image = cv2.GaussianBlur(image, (0, 0), 1.0)
    assert curves_from_image(image) == []


def test_a_bright_surround_hides_no_border():
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    image = np.where(np.hypot(u - 236, v - 203) < 170, 60, 150).astype(np.uint8)
    assert curves_from_image(cv2.GaussianBlur(image, (0, 0), 1.0)) == []


def test_the_frame_of_the_picture_is_no_curve():
    image = np.full((HEIGHT, WIDTH), 120, np.uint8)
    image[:2] = image[-2:] = 0
    image[:, :1] = image[:, -2:] = 255
    assert curves_from_image(image) == []


def test_circles_through_many_points_are_fitted():
    angle = np.linspace(0, 1, 100)
    first = 50 * np.stack([np.cos(angle), np.sin(angle)], axis=1) + [3, 4]
    second = 90 * np.stack([np.cos(2 + angle), np.sin(2 + angle)], axis=1) - [7, 0]
    centres, radii = fit_circles(np.concatenate([first, second]), np.array([0, 100, 200]))
    assert np.allclose(centres, [[3, 4], [-7, 0]], atol=1e-4)
    assert np.allclose(radii, [50, 90], atol=1e-4)


def test_lines_inside_an_image_circle_are_kept(curves, image):
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    inside = np.hypot(u - 240.2, v - 199.1) < 185
    found = curves_from_image(np.where(inside, image, 3).astype(np.uint8))
    assert sum(c.length for c in found) > 0.4 * sum(c.length for c in curves)
    for curve in found:
        assert np.hypot(*(curve.points.mean(axis=0) - [240.2, 199.1])) < 183


def picture_above_parabola(rise):
    """Bright above a parabola over the upper part of the picture, anti-aliased."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    height = 70 - rise * (1 - ((u - 240) / 180) ** 2)
    slope = 2 * rise * (u - 240) / 180**2
    inside = np.clip((height - v) / np.hypot(1, slope) + 0.5, 0, 1)
    inside *= np.abs(u - 240) < 180
    return np.round(90 + 110 * inside).astype(np.uint8)


def test_a_curve_that_bulges_towards_the_centre_is_no_line():
    found = curves_from_image(picture_above_parabola(-30))
    assert all(np.ptp(curve.points[:, 0]) < 150 for curve in found)


def test_the_same_curve_bulging_outwards_is_kept():
    found = curves_from_image(picture_above_parabola(30))
    assert max(np.ptp(curve.points[:, 0]) for curve in found) > 300


def test_small_discs_are_no_lines():
    image = np.full((HEIGHT, WIDTH), 90, np.uint8)
    for u in range(60, 460, 80):
        cv2.circle(image, (u, 200), 25, 210, -1, cv2.LINE_AA)
    assert sum(c.length for c in curves_from_image(image)) < 100


# ---- smooth arcs ---------------------------------------------------------------------------


def test_corners_cut_a_chain():
    leg = np.arange(60.0)
    zero = np.zeros(60)
    points = np.concatenate([np.stack([leg, zero], 1), np.stack([zero + 60, leg + 1], 1)])
    selected, offsets = smooth_arcs(points, np.array([0, 120]), config=SmoothConfig())
    assert len(offsets) == 3
    assert not np.isin([58, 59, 60, 61], selected).any()


def test_an_s_bend_is_cut_where_it_turns():
    s = np.linspace(0, 2 * np.pi, 200)
    points = np.stack([np.arange(200.0), 12 * np.sin(s)], axis=1)
    _, offsets = smooth_arcs(points, np.array([0, 200]), config=SmoothConfig())
    assert len(offsets) == 3
    assert abs(offsets[1] - 100) < 15


def test_one_smooth_arc_stays_whole():
    angle = np.linspace(0, 2.5, 400)
    points = 160 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points += np.random.default_rng(0).normal(0, 0.1, points.shape)
    config = SmoothConfig()
    selected, _ = smooth_arcs(points, np.array([0, 400]), config=config)
    assert len(selected) == 400 - 2 * config.trim


def test_polynomial_fit_gives_distance_and_curvature():
    angle = np.linspace(0, 1, 150)
    points = 100 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    fit = fit_arcs(points, np.array([0, 150]), degree=4)
    assert np.abs(fit.distance).max() < 0.01
    assert np.allclose(np.abs(fit.curvature), 0.01, rtol=0.02)


# ---- joining under a camera ----------------------------------------------------------------


def test_pieces_of_one_line_are_joined_in_order():
    pieces = [
        arc(LENS, [0.2, 1, 0.4], a, a + 0.25, seed=k) for k, a in enumerate((0.1, -0.5, -0.2))
    ]
    joined = join_curves(pieces, LENS)
    assert len(joined) == 1
    steps = np.diff(joined[0].points, axis=0)
    assert (steps[:, 0] > -1).all() or (steps[:, 0] < 1).all()
    assert len(joined[0].points) == sum(len(piece.points) for piece in pieces)


def test_polarity_of_a_chessboard_does_not_hinder_joining(curves):
    joined = join_curves(curves, LENS)
    assert len(joined) < len(curves)
    assert np.median([rms(curve, LENS) for curve in joined]) < 0.12


@pytest.mark.parametrize("shift", [3.0, -4.0])
def test_parallel_lines_stay_apart(shift):
    first = arc(LENS, [0, 1, 0.3], -0.6, -0.1)
    other = arc(LENS, [0, 1, 0.3], 0.0, 0.5)
    moved = Curve(other.points + np.array([0, shift]), other.sigma, other.strength)
    assert len(join_curves([first, moved], LENS)) == 2


def test_two_sides_of_a_bar_are_not_joined():
    first = arc(LENS, [0, 1, 0.3], -0.5, 0.5)
    beside = Curve(first.points + np.array([0, 0.7]), first.sigma, first.strength)
    assert len(join_curves([first, beside], LENS)) == 2


def test_lines_that_cross_stay_apart():
    assert (
        len(join_curves([arc(LENS, [0, 1, 0.1], 0, 0.4), arc(LENS, [1, 0.2, 0], 0, 0.4)], LENS))
        == 2
    )


def test_far_pieces_stay_apart():
    pieces = [arc(LENS, [0, 1, 0.3], -0.9, -0.8), arc(LENS, [0, 1, 0.3], 0.8, 0.9)]
    assert len(join_curves(pieces, LENS)) == 2


def test_joining_nothing_gives_nothing():
    assert join_curves([], LENS) == []


# ---- curves of a heatmap -------------------------------------------------------------------


def heatmap_of(curves, scale):
    heat = np.zeros((round(HEIGHT * scale), round(WIDTH * scale)), np.uint8)
    for curve in curves:
        points = np.round(((curve.points + 0.5) * scale - 0.5) * 256).astype(np.int32)
        cv2.polylines(heat, [points], False, 255, 3, cv2.LINE_AA, 8)
    return heat.astype(np.float32) / 255


@pytest.mark.parametrize("scale", [0.5, 1.0])
def test_curves_of_a_heatmap_are_as_precise_as_those_of_the_picture(scale, lines, image):
    curves = curves_from_heatmap(heatmap_of(lines, scale), image)
    lengths = np.array([curve.length for curve in curves])
    errors = np.array([rms(curve, LENS) for curve in curves])
    assert lengths.sum() > 0.6 * sum(c.length for c in lines)
    assert lengths @ (errors < 0.12) > 0.85 * lengths.sum()


def test_a_heatmap_beside_the_edge_is_pulled_to_it(lines, image):
    moved = [Curve(c.points + np.array([1.2, -0.8]), c.sigma, c.strength) for c in lines]
    curves = curves_from_heatmap(heatmap_of(moved, 1.0), image)
    lengths = np.array([curve.length for curve in curves])
    assert lengths @ np.array([rms(c, LENS) < 0.12 for c in curves]) > 0.8 * lengths.sum()


def picture_of_a_bar(contrast):
    """A bar of width 5 with its axis from (20, 60) to (280, 130)."""
    v, u = np.mgrid[0:200, 0:300].astype(float)
    distance = (v - 60 - 0.27 * (u - 20)) / np.hypot(1, 0.27)
    bar = np.clip(3 - np.abs(distance), 0, 1)
    return np.round(80 + contrast * bar).astype(np.uint8)


@pytest.mark.parametrize("contrast", [120, 5])  # 5: too faint for an edge by itself
def test_every_curve_stays_on_one_side_of_a_bar(contrast):
    heat = np.zeros((100, 150), np.float32)
    cv2.line(heat, (10, 30), (140, 65), 1.0, 3, cv2.LINE_8)
    curves = curves_from_heatmap(heat, picture_of_a_bar(contrast))
    assert 1 <= len(curves) <= 2
    for curve in curves:
        u, v = curve.points.T
        across = (v - 60 - 0.27 * (u - 20)) / np.hypot(1, 0.27)
        assert abs(abs(across.mean()) - 2.5) < 0.3
        assert np.ptp(across) < 0.6


@pytest.mark.parametrize(("contrast", "hinted"), [(120, False), (5, True)])
def test_curves_beside_the_pictures_own_edges_are_known_as_hints(contrast, hinted):
    heat = np.zeros((100, 150), np.float32)
    cv2.line(heat, (10, 30), (140, 65), 1.0, 3, cv2.LINE_8)
    curves = curves_from_both(heat, picture_of_a_bar(contrast))
    assert {curve.is_hinted for curve in curves} == {hinted}


def test_edges_where_the_heatmap_is_cold_give_no_curves(image, lines):
    curves = curves_from_heatmap(heatmap_of(lines[:1], 0.5), image)
    near = [np.abs(c.points[:, None] - lines[0].points).sum(-1).min(axis=1).mean() for c in curves]
    assert len(curves) >= 1
    assert max(near) < 6


def test_strength_is_the_heat_beside_a_curve(image, lines):
    heat = np.maximum(heatmap_of(lines[:1], 0.5), 0.4 * heatmap_of(lines[1:2], 0.5))
    curves = curves_from_heatmap(heat, image)
    long = sorted(curve.strength for curve in curves if curve.length > 200)
    assert long[0] == pytest.approx(0.4, abs=0.1)
    assert long[-1] == pytest.approx(1.0, abs=0.1)


def test_heat_without_edges_keeps_its_centre_line_with_its_uncertainty():
    image = np.full((200, 300), 80, np.uint8)
    heat = np.zeros((200, 300), np.float32)
    heat[99:102, 40:260] = 1
    curves = curves_from_heatmap(heat, image)
    assert len(curves) == 1
    assert curves[0].sigma >= HeatmapCurvesConfig().centre_sigma
    assert np.abs(curves[0].points[:, 1] - 100).max() < 0.2


def test_a_cold_heatmap_has_no_curves(image):
    assert curves_from_heatmap(np.zeros((30, 40), np.float32), image) == []


def test_a_heatmap_of_another_shape_is_refused(image):
    with pytest.raises((ValueError, TypeError)):
        curves_from_heatmap(np.zeros((3, 4, 5), np.float32), image)


# ---- the type ------------------------------------------------------------------------------


def test_thinning_averages_the_noise_away():
    rng = np.random.default_rng(0)
    u = np.linspace(0, 300, 301)
    curve = Curve(np.stack([u, 50 + rng.normal(0, 0.3, 301)], axis=1), 0.3, 1.0)
    coarse = curve.thinned(10.0)
    assert 29 <= len(coarse) <= 33
    assert np.std(coarse[:, 1]) < 0.15
    assert coarse[-1, 0] - coarse[0, 0] == pytest.approx(curve.chord, abs=15)


def test_thinning_leaves_gaps_empty():
    u = np.concatenate([np.arange(0.0, 50), np.arange(150.0, 200)])
    coarse = Curve(np.stack([u, 0 * u], axis=1), 0.1, 1.0).thinned(10.0)
    assert not ((coarse[:, 0] > 60) & (coarse[:, 0] < 140)).any()


@pytest.mark.parametrize(
    "points", [np.zeros((1, 2)), np.array([[0.0, 0.0], [np.nan, 1.0]])], ids=["one", "nan"]
)
def test_a_curve_needs_two_finite_points(points):
    with pytest.raises(ValueError, match="Expected"):
        Curve(points, 0.1, 0.5)

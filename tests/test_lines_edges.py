"""Edge points lie on the edges: renders with exact truth, 8 x 8 samples a pixel."""

import numpy as np
import pytest

from classical.lines.chains import link_points
from classical.lines.edges import EdgeConfig, detect_edges
from classical.lines.ridges import RidgeConfig, detect_ridges

SIZE = 96
CENTRE = (SIZE - 1) / 2
OVERSAMPLING = 8


def render(shape, *, noise=1.0, seed=0):
    """Grey picture that is bright where the distance `shape(u, v)` is positive, contrast 100."""
    axis = (np.arange(SIZE * OVERSAMPLING) + 0.5) / OVERSAMPLING - 0.5
    u, v = np.meshgrid(axis, axis)
    fine = np.clip(shape(u, v) * OVERSAMPLING + 0.5, 0, 1).astype(np.float32)
    coarse = fine.reshape(SIZE, OVERSAMPLING, SIZE, OVERSAMPLING).mean(axis=(1, 3))
    rng = np.random.default_rng(seed)
    return (80 + 100 * coarse + rng.normal(0, noise, coarse.shape)).astype(np.float32)


def side_of(found, degrees, offset):
    return side(found.points[:, 0], found.points[:, 1], degrees, offset)


def side(u, v, degrees, offset):
    angle = np.deg2rad(degrees)
    return (u - CENTRE) * np.cos(angle) + (v - CENTRE) * np.sin(angle) - offset


@pytest.mark.parametrize("degrees", [0, 3, 17, 30, 44, 45, 46, 60, 80, 90, 123, 170])
@pytest.mark.parametrize("offset", [0.0, 0.37])
def test_points_of_a_slanted_edge_are_within_a_tenth_pixel(degrees, offset):
    edges = detect_edges(render(lambda u, v: side(u, v, degrees, offset)))
    distance = side_of(edges, degrees, offset)
    assert len(distance) > 0.6 * SIZE
    assert np.abs(distance).max() < 0.15
    assert np.sqrt((distance**2).mean()) < 0.05


@pytest.mark.parametrize("degrees", [5, 40, 45, 77])
def test_slanted_edges_are_placed_without_bias(degrees):
    edges = detect_edges(render(lambda u, v: side(u, v, degrees, 0.2), noise=0.0))
    assert abs(side_of(edges, degrees, 0.2).mean()) < 0.02


@pytest.mark.parametrize("radius", [20.0, 33.3, 42.0])
def test_points_of_a_disc_are_within_a_tenth_pixel(radius):
    centre = CENTRE + np.array([0.31, -0.18])
    edges = detect_edges(render(lambda u, v: radius - np.hypot(u - centre[0], v - centre[1])))
    error = np.hypot(*(edges.points - centre).T) - radius
    assert np.sqrt((error**2).mean()) < 0.1


@pytest.mark.parametrize("degrees", [10, 45, 70])
def test_both_sides_of_a_bar_are_found(degrees):
    edges = detect_edges(render(lambda u, v: 4 - np.abs(side(u, v, degrees, 0.2))))
    distance = np.abs(side_of(edges, degrees, 0.2)) - 4
    assert np.sqrt((distance**2).mean()) < 0.05
    signs = side_of(edges, degrees, 0.2) > 0
    assert 0.4 < signs.mean() < 0.6


def test_normals_point_to_the_bright_side():
    edges = detect_edges(render(lambda u, v: side(u, v, 30, 0)))
    expected = [np.cos(np.deg2rad(30)), np.sin(np.deg2rad(30))]
    assert (edges.normals @ expected).min() > 0.95


def test_contrast_is_the_height_of_the_step():
    edges = detect_edges(render(lambda u, v: side(u, v, 20, 0)))
    assert np.median(edges.contrast) == pytest.approx(100, rel=0.1)


def test_steps_below_the_smallest_contrast_are_no_edges():
    config = EdgeConfig(min_contrast=130.0)
    assert len(detect_edges(render(lambda u, v: u - CENTRE), config=config).points) == 0


@pytest.mark.parametrize("shape", [(1, 1), (3, 200), (200, 2), (40, 50)])
def test_even_and_tiny_pictures_have_no_edges(shape):
    assert len(detect_edges(np.full(shape, 7, np.float32)).points) == 0


def test_a_disc_is_one_closed_chain_in_order():
    edges = detect_edges(render(lambda u, v: 30 - np.hypot(u - CENTRE, v - CENTRE)))
    chains = link_points(edges)
    lengths = np.diff(chains.offsets)
    longest = lengths.argmax()
    points = edges.points[chains.order[chains.offsets[longest] : chains.offsets[longest + 1]]]
    assert np.hypot(*np.diff(points, axis=0).T).max() < 3
    angle = np.unwrap(np.arctan2(*(points - CENTRE).T[::-1]))
    assert abs(angle[-1] - angle[0]) > 2 * np.pi * 0.95
    assert (np.diff(angle) * np.sign(angle[-1] - angle[0]) > -0.02).all()


def test_no_point_is_in_two_chains():
    rng = np.random.default_rng(3)
    edges = detect_edges(rng.uniform(0, 255, (SIZE, SIZE)).astype(np.float32))
    chains = link_points(edges, min_points=3)
    assert len(chains) > 5
    assert len(np.unique(chains.order)) == len(chains.order)


@pytest.mark.parametrize("degrees", [0, 25, 45, 80])
@pytest.mark.parametrize("width", [2.0, 3.0])
def test_ridge_points_lie_on_the_centre_line(degrees, width):
    heat = render(lambda u, v: width / 2 - np.abs(side(u, v, degrees, 0.3)), noise=0.0)
    ridges = detect_ridges((heat - 80) / 100)
    distance = side_of(ridges, degrees, 0.3)
    assert len(distance) > 0.7 * SIZE
    assert np.sqrt((distance**2).mean()) < 0.05


def test_a_cold_heatmap_has_no_ridges():
    assert len(detect_ridges(np.zeros((40, 60)), config=RidgeConfig()).points) == 0

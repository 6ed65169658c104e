"""Curves that grow along lines of a picture, under the right lens and under one that is near it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from classical.camera import KannalaBrandt
from classical.fit import fit_lens
from classical.fit.quality import disagreement
from classical.lines import Curve, TracingConfig, join_curves, trace_further

WIDTH, HEIGHT = 640, 480
LENS = KannalaBrandt.centred(np.array([0.75, -0.03, 0.0, 0.0, 0.0]), WIDTH, HEIGHT)
NEAR = KannalaBrandt.centred(np.array([0.765, -0.03, 0.0, 0.0, 0.0]), WIDTH, HEIGHT)
NORMAL = np.array([0.1, 1.0, -0.45]) / np.linalg.norm([0.1, 1.0, -0.45])
AXIS = np.array([0.0, 0.0, 1.0]) - NORMAL[2] * NORMAL  # to the middle of the line
AXIS /= np.linalg.norm(AXIS)
SIDE = np.cross(NORMAL, AXIS)  # along it, to the right


def line(start: float, stop: float, count: int = 60) -> np.ndarray:
    """Pixels of the line between two angles from its middle."""
    angle = np.linspace(start, stop, count)[:, None]
    points, seen = LENS.project(np.cos(angle) * AXIS + np.sin(angle) * SIDE)
    assert seen.all()
    return points


def angles(points: np.ndarray) -> np.ndarray:
    """Angle of each point along the line."""
    rays, _ = LENS.unproject(points)
    return np.arctan2(rays @ SIDE, rays @ AXIS)


def off_line(points: np.ndarray) -> np.ndarray:
    """Distance from the line in pixels, to first order."""
    rays, _ = LENS.unproject(points)
    ahead, _ = LENS.unproject(points + np.array([0.0, 0.5]))
    return np.abs((rays @ NORMAL) / ((ahead - rays) @ NORMAL / 0.5))


def picture(stop: float = np.inf, *, contrast: float = 60.0, fade: float = 1.0) -> np.ndarray:
    """The line as an edge up to an angle; beyond its middle by `fade` of the contrast."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    rays, _ = LENS.unproject(np.stack([u.ravel(), v.ravel()], axis=1))
    across = (rays @ NORMAL).reshape(u.shape)
    along = np.arctan2(rays @ SIDE, rays @ AXIS).reshape(u.shape)
    du, dv = np.gradient(across)
    step = np.clip(across / np.hypot(du, dv), -0.5, 0.5)
    height = np.where(along > stop, 0.0, np.where(along > 0.15, fade, 1.0)) * contrast
    image = cv2.GaussianBlur(120 + height * step, (0, 0), 0.7)
    noisy = image + np.random.default_rng(0).normal(0, 1.0, image.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


MIDDLE = Curve(line(-0.15, 0.15), 0.1, 60 / (60 + 20))


@pytest.mark.parametrize("camera", [LENS, NEAR], ids=["its lens", "a lens near it"])
def test_a_curve_grows_along_its_line(camera: KannalaBrandt) -> None:
    (grown,) = trace_further([MIDDLE], camera, picture())
    reached = angles(grown.points)
    assert reached.min() < -0.42
    assert reached.max() > 0.42
    assert (np.diff(reached) > -1e-3).all()
    assert off_line(grown.points).max() < 0.35
    assert np.sqrt((off_line(grown.points) ** 2).mean()) < 0.1


def test_it_grows_further_each_time() -> None:
    curves = [MIDDLE]
    for _ in range(3):
        curves = trace_further(curves, LENS, picture())
    assert curves[0].points[:, 0].min() < 30
    assert curves[0].points[:, 0].max() > WIDTH - 31


def test_it_ends_where_the_line_ends() -> None:
    (grown,) = trace_further([MIDDLE], LENS, picture(0.3))
    assert 0.27 < angles(grown.points).max() < 0.33
    assert angles(grown.points).min() < -0.42


@pytest.mark.parametrize("reverse", [False, True])
def test_order_is_kept(reverse: bool) -> None:
    curve = replace(MIDDLE, points=MIDDLE.points[::-1]) if reverse else MIDDLE
    (grown,) = trace_further([curve], LENS, picture())
    turn = np.diff(angles(grown.points)) * (-1 if reverse else 1)
    assert (turn > -1e-3).all()
    assert (grown.sigma, grown.strength) == (curve.sigma, curve.strength)


def test_a_fainter_edge_is_another_one() -> None:
    (grown,) = trace_further([MIDDLE], LENS, picture(fade=0.5))
    assert angles(grown.points).max() < 0.2
    assert angles(grown.points).min() < -0.42


def test_a_share_bounds_the_growth() -> None:
    (grown,) = trace_further([MIDDLE], LENS, picture(), config=TracingConfig(share=0.5))
    assert np.ptp(angles(grown.points)) == pytest.approx(2 * 0.3, abs=0.03)


def test_what_has_no_edge_beside_it_stays() -> None:
    empty = np.full((HEIGHT, WIDTH), 120, np.uint8)
    short = Curve(line(-0.005, 0.005, 6), 0.1, 0.5)
    behind = Curve(np.array([[5.0, 5.0], [400.0, 8.0]]), 0.1, 0.5)
    narrow = KannalaBrandt(
        np.array([0.75, -0.3, 0.0, 0.0, 0.0]), 320.0, 320.0, 319.5, 239.5, 640, 480
    )
    assert trace_further([MIDDLE], LENS, empty)[0] is MIDDLE
    assert trace_further([short], LENS, picture())[0] is short
    assert trace_further([behind], narrow, picture())[0] is behind
    assert trace_further([], LENS, empty) == []


def test_colour_and_size_do_not_matter() -> None:
    grey = picture()
    (one,) = trace_further([MIDDLE], LENS, grey)
    (coloured,) = trace_further([MIDDLE], LENS, np.repeat(grey[..., None], 3, axis=2))
    np.testing.assert_array_equal(one.points, coloured.points)
    large = cv2.resize(grey, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
    big = replace(MIDDLE, points=(MIDDLE.points + 0.5) * 4 - 0.5, strength=0.6)
    (grown,) = trace_further([big], LENS.resized(4 * WIDTH, 4 * HEIGHT).normalized(), large)
    points = (grown.points + 0.5) / 4 - 0.5
    assert np.ptp(angles(points)) == pytest.approx(np.ptp(angles(one.points)), abs=0.05)
    assert off_line(points).max() < 0.35


def test_a_line_of_hints_is_a_hint() -> None:
    left = Curve(line(-0.3, -0.05), 0.1, 0.5, is_hinted=True)
    right = Curve(line(0.0, 0.3), 0.1, 0.5, is_hinted=True)
    assert [curve.is_hinted for curve in join_curves([left, right], LENS)] == [True]
    seen = replace(right, is_hinted=False)
    assert [curve.is_hinted for curve in join_curves([left, seen], LENS)] == [False]


def middles_of_lines(count: int, seed: int) -> tuple[np.ndarray, list[Curve]]:
    """A curved chessboard whose lines are known by a fifth of their length, a little off."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    rays, _ = LENS.unproject(np.stack([u.ravel(), v.ravel()], axis=1))
    parity, curves = np.ones(u.shape), []
    for _ in range(count):
        normal = rng.normal(size=3) * [1.0, 1.0, 0.6]
        normal /= np.linalg.norm(normal)
        across = (rays @ normal).reshape(u.shape)
        du, dv = np.gradient(across)
        parity *= 2 * np.clip(across / np.hypot(du, dv), -0.5, 0.5)
        axis = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
        axis /= np.linalg.norm(axis)
        angle = np.linspace(-0.15, 0.15, 40)[:, None]
        points, _ = LENS.project(np.cos(angle) * axis + np.sin(angle) * np.cross(normal, axis))
        inside = ((points > 5) & (points < [WIDTH - 6, HEIGHT - 6])).all(axis=1)
        if inside.all():
            noisy = points + rng.normal(0, 0.3, points.shape)
            curves.append(Curve(noisy, 0.3, 0.6))
    image = cv2.GaussianBlur(125 + 65 * parity, (0, 0), 0.7)
    return np.clip(image + rng.normal(0, 1.5, image.shape), 0, 255).astype(np.uint8), curves


def test_a_fit_that_sees_the_picture_knows_the_lens_better() -> None:
    image, curves = middles_of_lines(14, 5)
    assert len(curves) >= 8
    blind, seeing = (
        fit_lens([curves], WIDTH, HEIGHT, pictures=pictures) for pictures in ([], [image])
    )
    assert blind.camera is not None
    assert seeing.camera is not None
    blind_px, seeing_px = disagreement(blind.camera, LENS), disagreement(seeing.camera, LENS)
    assert seeing_px < 0.5 * blind_px
    lengths = [
        sum(np.ptp(each.points, axis=0).max() for each in fit.curves[0]) for fit in (blind, seeing)
    ]
    assert lengths[1] > 1.5 * lengths[0]


def test_a_fit_wants_one_picture_for_each_set_of_curves() -> None:
    image, curves = middles_of_lines(14, 5)
    with pytest.raises(ValueError, match="Expected a picture for each of 2 sets of curves, got 1"):
        fit_lens([curves, curves], WIDTH, HEIGHT, pictures=[image])

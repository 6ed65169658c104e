"""Laws of the Bukhari–Dailey baseline."""

import cv2
import numpy as np
import pytest

from classical.baselines import bukhari
from classical.baselines.bukhari import BukhariConfig
from classical.baselines.bukhari.arcs import find_arcs, find_contours, path_length
from classical.baselines.bukhari.circle import (
    circles_through,
    distances,
    fit_geometric,
    fit_taubin,
    normalised,
    shifted,
)
from classical.baselines.bukhari.refinement import residuals
from classical.baselines.bukhari.sampling import Frame, hypotheses, is_plausible, straightness
from classical.camera import Division

WIDTH, HEIGHT = 640, 480


def circle(a: float, b: float, radius: float) -> np.ndarray:
    """(A, B, C, D) of a circle about (a, b), scaled to B² + C² − 4 A D = 1."""
    values = np.array([[1.0, -2 * a, -2 * b, a * a + b * b - radius**2]])
    return normalised(values)[0]


def bent_contours(model: Division, count: int, noise: float, seed: int = 0) -> list[np.ndarray]:
    """Contours of straight lines seen through the model, one point a pixel, with noise."""
    rng = np.random.default_rng(seed)
    contours: list[np.ndarray] = []
    while len(contours) < count:
        angle, distance = rng.uniform(0, np.pi), rng.uniform(-1, 1) * model.width
        t = np.linspace(-6 * model.width, 6 * model.width, 20000)
        normal = np.array([np.cos(angle), np.sin(angle)])
        line = distance * normal + t[:, None] * np.array([-normal[1], normal[0]])
        seen, valid = model.distort(line + np.array([model.u0, model.v0]))
        inside = (seen >= 0).all(axis=1) & (seen <= [model.width - 1, model.height - 1]).all(axis=1)
        seen = seen[valid & inside]
        if len(seen) > 10 and path_length(seen) > 100:
            s = np.append(0.0, np.cumsum(np.hypot(*np.diff(seen, axis=0).T)))
            at = np.arange(0.0, s[-1])
            even = np.stack([np.interp(at, s, seen[:, i]) for i in (0, 1)], axis=1)
            contours.append(even + rng.normal(0, noise, even.shape))
    return contours


def estimate(model: Division, config: BukhariConfig, noise: float) -> bukhari.BukhariResult:
    rng = np.random.default_rng(1)
    arcs = find_arcs(bent_contours(model, 20, noise), config=config, rng=rng)
    return bukhari.estimate_from_arcs(arcs, model.width, model.height, config=config, rng=rng)


def test_distance_to_a_circle_is_signed_and_exact():
    points = np.array([[13.0, 5.0], [3.0, 5.0], [3.0, 1.0]])
    found = distances(circle(3.0, 5.0, 4.0), points)[0]
    np.testing.assert_allclose(found, [6.0, -4.0, 0.0], atol=1e-12)


def test_moving_the_origin_moves_the_circle():
    by = np.array([20.0, -7.0])
    points = np.random.default_rng(0).uniform(-50, 50, (20, 2))
    before = distances(circle(3.0, 5.0, 40.0), points)
    np.testing.assert_allclose(distances(shifted(circle(3.0, 5.0, 40.0), by), points + by), before)


def test_circle_through_three_points_meets_them():
    triples = np.random.default_rng(0).uniform(0, 500, (100, 3, 2))
    triples[0] = [[0, 0], [10, 10], [30, 30]]  # a straight line is a circle too
    circles, valid = circles_through(triples)
    assert valid.all()
    off = [np.abs(distances(c[None], t)).max() for c, t in zip(circles, triples, strict=True)]
    assert max(off) < 1e-6


@pytest.mark.parametrize("fit", [fit_taubin, fit_geometric])
def test_fits_are_exact_on_an_exact_arc(fit):
    t = np.linspace(0.3, 0.6, 80)
    points = np.stack([900 + 700 * np.cos(t), -300 + 700 * np.sin(t)], axis=1)
    assert np.abs(distances(fit(points)[None], points)).max() < 1e-6


def test_short_noisy_arcs_keep_their_curvature():
    # The plain algebraic fit loses a third and more of the curvature here.
    rng = np.random.default_rng(0)
    t = np.linspace(-0.05, 0.05, 100)
    arc = np.stack([1000 * np.cos(t) - 1000, 1000 * np.sin(t)], axis=1)
    fitted = [fit_geometric(arc + rng.normal(0, 0.5, arc.shape)) for _ in range(200)]
    curvature = np.median([2 * abs(c[0]) for c in fitted])
    assert curvature == pytest.approx(1 / 1000, rel=0.05)


def test_geometric_fit_is_no_worse_than_taubin():
    rng = np.random.default_rng(0)
    t = np.linspace(0, 0.4, 60)
    points = np.stack([300 * np.cos(t), 300 * np.sin(t)], axis=1) + rng.normal(0, 1, (60, 2))
    cost = [np.sum(distances(f(points)[None], points) ** 2) for f in (fit_geometric, fit_taubin)]
    assert cost[0] <= cost[1]


def test_a_contour_of_two_arcs_is_cut_in_two():
    t = np.linspace(0, 0.3, 150)
    first = np.stack([500 * np.sin(t), 500 * np.cos(t)], axis=1)
    turn = first[-1] + np.stack([np.zeros(120), np.arange(1.0, 121.0)], axis=1)
    arcs = find_arcs(
        [np.concatenate([first, turn])], config=BukhariConfig(), rng=np.random.default_rng(0)
    )
    lengths = sorted(arc.length for arc in arcs)
    assert len(arcs) == 2
    assert lengths[0] == pytest.approx(120, abs=20)
    assert lengths[1] == pytest.approx(150, abs=20)


def test_contours_of_a_disc_lie_on_its_rim():
    picture = np.zeros((200, 200), np.uint8)
    cv2.circle(picture, (100 << 4, 100 << 4), 60 << 4, 200, -1, cv2.LINE_AA, 4)
    contours = find_contours(picture.astype(np.float32), config=BukhariConfig())
    radius = np.hypot(*(np.concatenate(contours) - 100).T)
    assert sum(map(path_length, contours)) > 0.9 * 2 * np.pi * 60
    # The blur moves an edge towards the outside of a curve by σ² / (2 radius), well under 0.1 px.
    assert np.abs(radius - np.median(radius)).max() < 0.5
    assert np.median(radius) == pytest.approx(60, abs=0.6)


def test_every_triple_of_exact_arcs_proposes_the_lens():
    model = Division(-4e-6, 300.0, 260.0, WIDTH, HEIGHT)
    config, rng = BukhariConfig(triples=300), np.random.default_rng(0)
    arcs = find_arcs(bent_contours(model, 12, 0.0), config=config, rng=rng)
    frame = Frame.of_picture(WIDTH, HEIGHT)
    found = hypotheses(frame.circles(arcs), frame, config=config, rng=rng)
    centre = found[:, 1:] * frame.unit + frame.middle
    assert np.median(found[:, 0]) / frame.unit**2 == pytest.approx(-4e-6, rel=1e-3)
    np.testing.assert_allclose(np.median(centre, axis=0), [300.0, 260.0], atol=0.5)


def test_implausible_lenses_are_refused():
    frame = Frame.of_picture(WIDTH, HEIGHT)
    found = np.array([[-0.5, 0.0, 0.0], [-1.2, 0.0, 0.0], [-0.5, 0.9, 0.0]])
    assert is_plausible(found, frame).tolist() == [True, False, False]


def test_straightness_does_not_reward_shrinking():
    frame = Frame.of_picture(WIDTH, HEIGHT)
    t = np.linspace(0, 1, 16)
    bent = np.stack([t - 0.5, 0.3 + 0.05 * (t - 0.5) ** 2], axis=1)[None]
    found = np.array([[0.0, 0.0, 0.0]])
    small = straightness(found, bent, frame)
    plain = np.std(0.05 * (t - 0.5) ** 2) * frame.unit
    assert small[0, 0] == pytest.approx(plain, rel=0.05)


def test_jacobian_of_the_refinement_is_that_of_differences():
    rng = np.random.default_rng(0)
    points, arc = rng.uniform(-0.8, 0.8, (40, 2)), np.repeat([0, 1], 20)
    q, lines = np.array([-0.4, 0.02, -0.03]), np.array([[0.3, 0.4], [2.0, -0.2]])
    _, shared, own = residuals(points, arc, q, lines)
    h = 1e-6
    for i in range(3):
        step = h * np.eye(3)[i]
        numeric = residuals(points, arc, q + step, lines)[0]
        numeric = (numeric - residuals(points, arc, q - step, lines)[0]) / (2 * h)
        np.testing.assert_allclose(shared[:, i], numeric, atol=1e-7)
    for i in range(2):
        step = np.zeros((2, 2))
        step[:, i] = h
        numeric = residuals(points, arc, q, lines + step)[0]
        numeric = (numeric - residuals(points, arc, q, lines - step)[0]) / (2 * h)
        np.testing.assert_allclose(own[:, i], numeric, atol=1e-7)


@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_lambda_and_centre_of_arcs_with_a_free_centre(noise: float):
    model = Division(-4e-6, 300.0, 260.0, WIDTH, HEIGHT)
    result = estimate(model, BukhariConfig(), noise)
    assert result.status == "ok"
    assert result.model is not None
    assert result.model.lambda_ == pytest.approx(-4e-6, rel=0.02)
    assert np.hypot(result.model.u0 - 300, result.model.v0 - 260) < 1.0
    assert result.rms < noise + 0.05


@pytest.mark.parametrize("lambda_", [-1e-6, -4e-6])
def test_lambda_of_arcs_with_a_fixed_centre(lambda_: float):
    model = Division(lambda_, (WIDTH - 1) / 2, (HEIGHT - 1) / 2, WIDTH, HEIGHT)
    result = estimate(model, BukhariConfig(centre="fixed"), 0.2)
    assert result.model is not None
    assert result.model.lambda_ == pytest.approx(lambda_, rel=0.02)
    assert (result.model.u0, result.model.v0) == (model.u0, model.v0)


def test_a_picture_of_bent_stripes_gives_its_lambda():
    model = Division(-5e-6, 319.5, 239.5, WIDTH, HEIGHT)
    u, v = np.meshgrid(np.arange(2 * WIDTH) / 2 - 0.25, np.arange(2 * HEIGHT) / 2 - 0.25)
    flat = model.undistort(np.stack([u.ravel(), v.ravel()], axis=1))[0]
    x, y = (flat - np.array([model.u0 + 5, model.v0 + 9])).T
    stripe = np.floor(np.where(x + 0.1 * y < 0, y - 0.1 * x, x + 0.1 * y) / 60) % 2
    large = (60 + 130 * stripe).reshape(2 * HEIGHT, 2 * WIDTH).astype(np.float32)
    grey = cv2.resize(large, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    image = np.repeat(np.rint(grey).astype(np.uint8)[..., None], 3, axis=2)
    result = bukhari.estimate(image)
    assert result.model is not None
    assert result.model.lambda_ == pytest.approx(-5e-6, rel=0.02)


def test_the_same_arcs_give_the_same_answer():
    model = Division(-4e-6, 300.0, 260.0, WIDTH, HEIGHT)
    first, second = (estimate(model, BukhariConfig(), 0.2) for _ in range(2))
    assert first.model == second.model


@pytest.mark.parametrize("sigma", [0.0, 4.0, 8.0])
@pytest.mark.parametrize("centre", ["free", "fixed"])
def test_noise_alone_is_a_failure_with_its_reason(centre, sigma: float):
    noise = np.random.default_rng(0).normal(size=(480, 640)).astype(np.float32)
    noise = cv2.GaussianBlur(noise, (0, 0), sigma) if sigma else noise
    image = np.clip(128 + 50 * noise / noise.std(), 0, 255).astype(np.uint8)
    result = bukhari.estimate(image, config=BukhariConfig(centre=centre))
    assert not result
    assert result.model is None
    assert "arcs" in result.reason


def test_config_refuses_what_cannot_be():
    with pytest.raises(ValueError, match="arc_length > 0"):
        BukhariConfig(arc_length=0.0)

"""The straightness fit on curves made from known lenses."""

from dataclasses import replace

import numpy as np
import pytest

from classical.camera import KannalaBrandt
from classical.camera.ray_field import ray_field
from classical.fit import (
    Doubt,
    Estimate,
    FitConfig,
    LensPrior,
    fit_lens,
    generic_prior,
    of_belief,
    of_belief_field,
)
from classical.fit.candidate import UNTOLD, Candidate, is_better_alone, is_open
from classical.fit.perspective import Perspective, bend_of
from classical.fit.prior import FREE, generic_surprise
from classical.fit.quality import predicted_error
from classical.fit.samples import CurveSamples, sample_curves
from classical.fit.search import family_field, projection
from classical.fit.solve import solve
from classical.fit.straightness import straightness
from classical.fit.vanishing import rescaled
from classical.lines import Curve

WIDTH, HEIGHT = 640, 480
LENS = KannalaBrandt(
    np.array([0.75, 0.03, -0.01, 0.003, -0.0004]), 320.0, 320.0, 312.0, 247.0, WIDTH, HEIGHT
)
NEAR = KannalaBrandt(
    np.array([0.85, -0.03, -0.01, 0.003, -0.0004]), 320.0, 325.0, 315.0, 246.0, WIDTH, HEIGHT
)


def line_pictures(
    lens: KannalaBrandt, n_curves: int, rng: np.random.Generator, *, noise: float = 0.0
) -> list[Curve]:
    """Pictures of straight lines between random pixels."""
    curves = []
    while len(curves) < n_curves:
        ends = rng.uniform([5, 5], [lens.width - 5, lens.height - 5], (2, 2))
        distance = np.hypot(*(ends[1] - ends[0]))
        if distance < 80:
            continue
        rays, valid = lens.unproject(ends)
        if not valid.all():
            continue
        t = np.linspace(0, 1, int(distance))[:, None]
        points, _ = lens.project(rays[:1] * (1 - t) + rays[1:] * t)
        curves.append(Curve(points + rng.normal(0, noise, points.shape), 0.2, 1.0))
    return curves


def bent_things(n_curves: int, rng: np.random.Generator) -> list[Curve]:
    """Arcs of random circles, which are no lines."""
    curves = []
    for _ in range(n_curves):
        centre, radius = rng.uniform([100, 100], [540, 380]), rng.uniform(40, 150)
        angles = rng.uniform(0, 2 * np.pi) + np.linspace(0, rng.uniform(0.8, 2.0), 80)
        points = centre + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        curves.append(Curve(points, 0.2, 1.0))
    return curves


def aligned_error(estimate: KannalaBrandt, truth: KannalaBrandt) -> float:
    """Mean distance of rectified positions after the best similarity, 320 frame, up to 60°."""
    grid = np.stack(np.meshgrid(np.arange(0, WIDTH, 8.0), np.arange(0, HEIGHT, 8.0)), -1)
    points = grid.reshape(-1, 2)
    true_rays, _ = truth.unproject(points)
    rays, _ = estimate.unproject(points)
    seen = (true_rays[:, 2] > 0.5) & (rays[:, 2] > 0.05)
    a = 160 * (rays[seen, 0] + 1j * rays[seen, 1]) / rays[seen, 2]
    b = 160 * (true_rays[seen, 0] + 1j * true_rays[seen, 1]) / true_rays[seen, 2]
    design = np.stack([a, np.ones_like(a)], axis=1)
    return float(np.abs(design @ np.linalg.lstsq(design, b, rcond=None)[0] - b).mean())


def samples_of(lens: KannalaBrandt, *, noise: float, seed: int = 0) -> CurveSamples:
    rng = np.random.default_rng(seed)
    return sample_curves(line_pictures(lens, 40, rng, noise=noise), spacing=8.0)


def test_lines_are_straight_under_their_own_lens() -> None:
    samples = samples_of(LENS, noise=0.0)
    result = straightness(LENS, samples)
    assert result.reached.all()
    assert np.abs(result.residuals).max() < 0.05  # what binning leaves on the strongest bends


def test_residual_is_a_distance_in_pixels() -> None:
    """A curve moved across itself by 0.7 px at one point shows it there."""
    rays, _ = LENS.unproject(np.array([[60.0, 60.0], [560.0, 90.0]]))
    t = np.linspace(0, 1, 41)[:, None]
    points, _ = LENS.project(rays[:1] * (1 - t) + rays[1:] * t)
    tangent = points[21] - points[19]
    normal = np.array([-tangent[1], tangent[0]]) / np.hypot(*tangent)
    points[20] += 0.7 * normal
    samples = CurveSamples(points, np.array([0]), np.ones(41))
    weights = np.ones(41)
    weights[20] = 0.0  # the bump must not move the line
    residuals = straightness(LENS, samples, weights).residuals
    assert abs(residuals[20]) == pytest.approx(0.7, abs=2e-3)
    assert np.abs(np.delete(residuals, 20)).max() < 1e-3


@pytest.mark.parametrize("parameter", range(9))
def test_jacobian_equals_central_differences(parameter: int) -> None:
    samples = samples_of(LENS, noise=0.3)
    weights = np.random.default_rng(1).uniform(0.5, 1.0, len(samples.points))
    exact = straightness(NEAR, samples, weights)
    vector = NEAR.to_vector()
    step = np.zeros(9)
    step[parameter] = 2e-6 * max(1.0, abs(vector[parameter]))
    sides = []
    for sign in (1, -1):
        moved = KannalaBrandt.from_vector(vector + sign * step, WIDTH, HEIGHT)
        other = straightness(moved, samples, weights)
        flip = np.sign((other.normals * exact.normals).sum(axis=1))[samples.owner]
        sides.append(other.residuals * flip)  # an eigenvector has no sign
    numeric = (sides[0] - sides[1]) / (2 * step[parameter])
    scale = np.abs(numeric).max()
    np.testing.assert_allclose(exact.jacobian[:, parameter], numeric, atol=2e-4 * scale)


def test_pixels_out_of_reach_pull_the_lens() -> None:
    short = KannalaBrandt.centred(np.array([0.6, -0.1, 0.0, 0.0, 0.0]), WIDTH, HEIGHT)
    points = np.stack([np.full(20, 10.0), np.linspace(20, 460, 20)], axis=1)
    samples = CurveSamples(points, np.array([0]), np.ones(20))
    result = straightness(short, samples)
    outside = ~result.reached
    assert outside.any()
    assert (result.residuals[outside] > 0).all()
    assert (result.jacobian[outside, 0] < 0).all()  # a larger k1 reaches farther


@pytest.mark.parametrize("b", [-0.5, 0.0, 0.5, 1.0])
def test_projection_family_holds_the_classical_lenses(b: float) -> None:
    lens = projection(0.9, b, WIDTH, HEIGHT)
    theta = np.linspace(0.05, 1.0, 20)
    expected = {
        -0.5: 2 * np.tan(theta / 2),
        0.0: theta,
        0.5: 2 * np.sin(theta / 2),
        1.0: np.sin(theta),
    }[b]
    np.testing.assert_allclose(lens.radius(theta), 0.9 * expected, rtol=2e-3)


@pytest.mark.parametrize(("strength", "b"), [(0.7, 0.0), (0.9, 0.5), (0.6, -0.5), (1.2, 0.0)])
def test_fit_finds_the_lens_of_noisy_lines(strength: float, b: float) -> None:
    truth = projection(strength, b, WIDTH, HEIGHT)
    rng = np.random.default_rng(3)
    fit = fit_lens([line_pictures(truth, 60, rng, noise=0.3)], WIDTH, HEIGHT)
    assert fit.status == "ok"
    assert fit.camera is not None
    assert aligned_error(fit.camera, truth) < 1.0


def test_bent_things_are_outvoted() -> None:
    rng = np.random.default_rng(4)
    curves = line_pictures(LENS, 50, rng, noise=0.3) + bent_things(15, rng)
    fit = fit_lens([curves], WIDTH, HEIGHT)
    assert fit.camera is not None
    assert aligned_error(fit.camera, LENS) < 1.5


def test_more_pictures_of_one_lens_tell_more() -> None:
    rng = np.random.default_rng(5)
    pictures = [line_pictures(LENS, 12, rng, noise=0.4) for _ in range(6)]
    alone, together = (fit_lens(sets, WIDTH, HEIGHT) for sets in (pictures[:1], pictures))
    assert together.predicted_error_px < alone.predicted_error_px
    assert together.camera is not None
    assert aligned_error(together.camera, LENS) < 1.0
    assert len(together.curves) == 6


def test_prior_fixes_what_lines_cannot_see() -> None:
    """Lines leave the scale open; a sure prior brings it."""
    rng = np.random.default_rng(6)
    curves = line_pictures(LENS, 60, rng, noise=0.2)
    deviation = np.array([0.005, 0.02, 0.02, 0.01, 0.005, 1.0, 2.0, 8.0, 8.0])
    belief = of_belief(LensPrior(LENS.to_vector(), np.diag(deviation**2)), "network")
    fit = fit_lens([curves], WIDTH, HEIGHT, observations=[belief])
    assert fit.camera is not None
    assert fit.camera.k[0] == pytest.approx(LENS.k[0], rel=0.01)
    assert fit.scale_source == "network"


def test_prior_coordinates_round_trip() -> None:
    prior = generic_prior(0.8, WIDTH, HEIGHT)
    again = prior.decode(prior.encode(LENS), WIDTH, HEIGHT)
    np.testing.assert_allclose(again.to_vector(), LENS.to_vector(), rtol=1e-10)


def test_surprise_is_the_distance_in_prior_coordinates() -> None:
    ratios, shift = np.array([0.05, -0.02, 0.004, 0.001]), np.array([0.01, -0.03])
    lens = KannalaBrandt.centred(0.8 * np.array([1.0, *ratios]), WIDTH, HEIGHT)
    vector = lens.to_vector()
    vector[7:] += shift * WIDTH / 2
    moved = KannalaBrandt.from_vector(vector, WIDTH, HEIGHT)
    z = generic_prior(0.8, WIDTH, HEIGHT).encode(moved)
    assert generic_surprise(ratios, shift) == pytest.approx(z @ z, rel=1e-9)


@pytest.mark.parametrize("b", [-0.5, 0.0, 0.4])
def test_search_sees_with_the_lens_that_it_hands_on(b: float) -> None:
    """The family's exact member against its polynomial: same rays, same Sampson field."""
    u, v = np.random.default_rng(0).uniform([0, 0], [WIDTH, HEIGHT], (200, 2)).T
    lens = projection(0.9, b, WIDTH, HEIGHT)
    expected, _ = ray_field(lens, u, v)
    field, reached = family_field((expected.x, expected.y), 0.9, b, WIDTH / 2)
    assert reached.all()
    np.testing.assert_allclose(field.rays(), expected.rays(), atol=2e-4)
    np.testing.assert_allclose(field.jacobian(), expected.jacobian(), atol=2e-5)


def test_no_curve_is_a_failure_with_its_reason() -> None:
    fit = fit_lens([[]], WIDTH, HEIGHT)
    assert (fit.status, fit.camera) == ("failed", None)
    assert "no curve" in fit.reason


def test_two_curves_are_never_ok() -> None:
    curves = line_pictures(LENS, 2, np.random.default_rng(7))
    assert fit_lens([curves], WIDTH, HEIGHT).status == "failed"


def test_radial_lines_tell_nothing() -> None:
    """Lines through the centre stay straight under every lens, so nothing is learnt from them."""
    t = np.linspace(-180, 180, 200)[:, None]
    angles = np.linspace(0, np.pi, 9)[:-1]
    centre = np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])
    curves = [Curve(centre + t * [np.cos(a), np.sin(a)], 0.1, 1.0) for a in angles]
    assert fit_lens([curves], WIDTH, HEIGHT).status != "ok"


def test_same_curves_give_the_same_bits() -> None:
    curves = line_pictures(LENS, 30, np.random.default_rng(8), noise=0.3)
    first, second = (fit_lens([curves], WIDTH, HEIGHT).camera for _ in range(2))
    assert first == second


def test_predicted_error_ignores_similarities() -> None:
    """Turning or moving the rectified plane is no error; a change of k1 alone mostly is."""
    nothing = predicted_error(LENS, np.zeros((9, 9)))
    bent = np.zeros((9, 9))
    bent[1, 1] = 0.01**2
    assert nothing == 0.0
    assert predicted_error(LENS, bent) > 0.3


def test_solver_meets_a_known_minimum_with_prior() -> None:
    """Min (z − 3)² / redundancy + z² in one dimension."""
    from classical.fit import SolverConfig

    config = SolverConfig(loss_scale=1e6, redundancy=4.0, tolerance=1e-12)
    solution = solve(lambda z: z - 3.0, lambda _z: np.eye(1), np.zeros(1), config=config)
    assert solution.value[0] == pytest.approx(0.75 / 1.25, abs=1e-6)


def test_solver_refuses_steps_without_a_camera() -> None:
    def residuals(z: np.ndarray) -> np.ndarray:
        if z[0] > 1.0:
            raise ValueError("no camera there")
        return z - 0.9

    solution = solve(residuals, lambda _z: np.eye(1), np.zeros(1))
    assert solution.value[0] <= 1.0


def test_larger_pictures_give_the_same_lens() -> None:
    rng = np.random.default_rng(9)
    curves = line_pictures(LENS, 40, rng, noise=0.2)
    double = [Curve(curve.points * 2 + 0.5, curve.sigma * 2, 1.0) for curve in curves]
    small = fit_lens([curves], WIDTH, HEIGHT, config=FitConfig()).camera
    large = fit_lens([double], 2 * WIDTH, 2 * HEIGHT, config=FitConfig()).camera
    assert small is not None
    assert large is not None
    assert aligned_error(large.resized(WIDTH, HEIGHT), small) < 0.1


def test_straight_pictures_stay_as_they_are() -> None:
    """Straight lines under a perspective lens: rectified positions are the picture's, scaled."""
    truth = projection(1.6, -1.0, WIDTH, HEIGHT)
    curves = line_pictures(truth, 50, np.random.default_rng(10), noise=0.3)
    fit = fit_lens([curves], WIDTH, HEIGHT)
    assert fit.camera is not None
    assert "straight already" in fit.reason
    assert fit.status == "ok"
    assert aligned_error(fit.camera, truth) < 0.05


@pytest.mark.parametrize("hinted", [True, False])
def test_a_bend_that_only_a_heatmap_hints_at_is_no_bend_of_a_straight_picture(hinted: bool) -> None:
    rng = np.random.default_rng(10)
    truth = projection(1.6, -1.0, WIDTH, HEIGHT)
    own = line_pictures(truth, 40, rng, noise=0.3)
    others = [replace(curve, is_hinted=hinted) for curve in line_pictures(LENS, 60, rng, noise=0.3)]
    fit = fit_lens([[*own, *others]], WIDTH, HEIGHT)
    assert fit.camera is not None
    assert (aligned_error(fit.camera, truth) < 0.05) is hinted


def straight_pieces(count: int, rng: np.random.Generator) -> list[Curve]:
    """Straight lines of 40 to 120 pixels, anywhere."""
    pieces = []
    for _ in range(count):
        middle = rng.uniform([60, 60], [WIDTH - 60, HEIGHT - 60])
        angle, length = rng.uniform(0, np.pi), rng.uniform(40, 120)
        along = np.linspace(-length / 2, length / 2, max(20, int(length / 2)))[:, None]
        points = middle + along * [np.cos(angle), np.sin(angle)]
        pieces.append(Curve(points + rng.normal(0, 0.2, points.shape), 0.3, 1.0))
    return pieces


def bowed(curve: Curve, bow: float) -> Curve:
    """The curve with its middle pushed aside by so many pixels."""
    points, along = curve.points, np.linspace(-1, 1, len(curve.points))[:, None]
    u, v = (points[-1] - points[0]) / np.hypot(*(points[-1] - points[0]))
    return Curve(points + bow * (1 - along**2) * np.array([-v, u]), curve.sigma, curve.strength)


def outward_side(curve: Curve) -> float:
    """The sign of `bowed` that pushes the curve away from the picture's middle."""
    u, v = curve.points[-1] - curve.points[0]
    away = curve.points[len(curve.points) // 2] - [(WIDTH - 1) / 2, (HEIGHT - 1) / 2]
    return float(np.sign(away @ [-v, u]))


@pytest.mark.parametrize(
    ("n_curves", "n_bent", "bow", "noise"), [(20, 8, 2.0, 0.3), (12, 5, 1.5, 0.2)]
)
def test_a_few_bent_things_do_not_bend_a_straight_picture(
    n_curves: int, n_bent: int, bow: float, noise: float
) -> None:
    """Kerbs and curtains among few lines: some lens makes their bows a little smaller."""
    rng = np.random.default_rng(1)
    curves = line_pictures(projection(1.6, -1.0, WIDTH, HEIGHT), n_curves, rng, noise=noise)
    curves[:n_bent] = [bowed(curve, rng.normal(0, bow)) for curve in curves[:n_bent]]
    assert "straight already" in fit_lens([curves], WIDTH, HEIGHT).reason


@pytest.mark.parametrize("seed", [2, 3])
def test_a_bend_that_hardly_moves_the_picture_needs_more_proof(seed: int) -> None:
    """All lines bow outwards by half a pixel: a lens explains that well, and does little."""
    rng = np.random.default_rng(seed)
    curves = line_pictures(projection(1.6, -1.0, WIDTH, HEIGHT), 20, rng, noise=0.3)
    curves = [bowed(curve, 0.5 * outward_side(curve)) for curve in curves]
    assert "straight already" in fit_lens([curves], WIDTH, HEIGHT).reason


def test_a_belief_in_a_fisheye_does_not_bend_a_straight_picture() -> None:
    rng = np.random.default_rng(12)
    curves = line_pictures(projection(1.6, -1.0, WIDTH, HEIGHT), 50, rng, noise=0.3)
    belief = LensPrior(LENS.to_vector(), np.diag((0.02 * LENS.to_vector()) ** 2 + 1e-6))
    fit = fit_lens([curves], WIDTH, HEIGHT, observations=[of_belief(belief, "a network")])
    assert "straight already" in fit.reason


@pytest.mark.parametrize("seed", [0, 3])
def test_a_belief_in_a_fisheye_does_not_silence_short_lines_that_are_straight(seed: int) -> None:
    """Under a lens that bends short lines by less than they err, they cannot tell it from none."""
    rng = np.random.default_rng(seed)
    curves = [bowed(piece, rng.normal(0, 0.3)) for piece in straight_pieces(15, rng)]
    wide = projection(0.9, 0.0, WIDTH, HEIGHT)
    general = generic_prior(float(wide.k[0]), WIDTH, HEIGHT)
    belief = of_belief(LensPrior(wide.to_vector(), general.covariance * 0.001), "a network")
    fit = fit_lens([curves], WIDTH, HEIGHT, observations=[belief], starts=[wide])
    assert "straight already" in fit.reason
    assert fit.camera is not None
    assert bend_of(fit.camera) < 0.1


def test_a_slight_gain_by_a_bend_is_asked_for_without_the_belief() -> None:
    straight = projection(1.6, -1.0, WIDTH, HEIGHT)

    def candidate(*, gain: float, allowed: bool, untold: bool = False) -> Candidate:
        said = Perspective(straight, gain, allowed, is_proven=False, is_untold=untold)
        return Candidate(LENS, np.eye(9), "prior", perspective=said)

    config = FitConfig()
    weak, clear = (candidate(gain=gain, allowed=False) for gain in (3.0, 30.0))
    assert is_open(weak, config)
    assert not is_open(clear, config)
    assert is_open(replace(clear, note=UNTOLD), config)
    assert is_better_alone(candidate(gain=0.0, allowed=True), weak, config)
    assert not is_better_alone(candidate(gain=0.0, allowed=True, untold=True), weak, config)
    assert not is_better_alone(weak, weak, config)


def test_a_belief_in_a_wide_fisheye_does_not_bend_a_slight_bend_further() -> None:
    truth = projection(1.8, -0.8, WIDTH, HEIGHT)
    wide = projection(0.9, 0.0, WIDTH, HEIGHT)
    curves = line_pictures(truth, 12, np.random.default_rng(12), noise=0.3)
    general = generic_prior(float(wide.k[0]), WIDTH, HEIGHT)
    belief = of_belief(LensPrior(wide.to_vector(), general.covariance * 0.05), "a network")
    heard, unheard = (
        fit_lens(
            [curves],
            WIDTH,
            HEIGHT,
            config=FitConfig(slight_bend=slight),
            observations=[belief],
            starts=[wide],
        )
        for slight in (0.0, 4.0)
    )
    assert heard.camera is not None
    assert unheard.camera is not None
    assert aligned_error(unheard.camera, truth) < 0.3
    assert aligned_error(heard.camera, truth) > 2 * aligned_error(unheard.camera, truth)


def test_a_belief_decides_where_the_lines_cannot_tell_straight_from_bent() -> None:
    """Lines through the middle are straight under every lens."""
    rng = np.random.default_rng(4)
    angles = rng.uniform(0, np.pi, 8)
    along = np.linspace(-200, 200, 60)[:, None]
    middle = np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])
    lines = [along * np.array([np.cos(a), np.sin(a)]) + middle for a in angles]
    curves = [Curve(line + rng.normal(0, 0.3, line.shape), 0.3, 1.0) for line in lines]
    general = generic_prior(float(LENS.k[0]), WIDTH, HEIGHT)
    belief = of_belief(LensPrior(LENS.to_vector(), general.covariance * 0.1), "network")
    without, with_ = (
        fit_lens([curves], WIDTH, HEIGHT, observations=observations, starts=[LENS])
        for observations in ([], [belief])
    )
    assert with_.status == "degraded"
    assert "could not tell" in with_.reason
    assert with_.camera is not None
    assert without.camera is not None
    assert aligned_error(with_.camera, LENS) < 0.5 * aligned_error(without.camera, LENS)


def test_a_weak_bend_is_not_called_straight() -> None:
    truth = projection(1.5, 0.0, WIDTH, HEIGHT)
    curves = line_pictures(truth, 50, np.random.default_rng(11), noise=0.3)
    fit = fit_lens([curves], WIDTH, HEIGHT)
    assert fit.camera is not None
    assert "straight already" not in fit.reason
    assert aligned_error(fit.camera, truth) < 0.5


def test_an_estimate_is_doubted_as_far_as_the_curves_lose_under_it() -> None:
    belief = LensPrior(LENS.to_vector(), generic_prior(0.75, WIDTH, HEIGHT).covariance)
    estimate = Estimate(belief, "a network", Doubt(least=2.0, most=8.0, field=4.0, unit=2.0))
    for loss, doubt in (
        (-1.0, 2.0),
        (0.0, 2.0),
        (6.0, 4.0),
        (16.0, 6.0),
        (1e3, 8.0),
        (np.inf, 8.0),
    ):
        field, whole = estimate.observations(loss)
        free = belief.covariance[np.ix_(FREE, FREE)]
        np.testing.assert_allclose(whole.covariance, doubt**2 * free)
        np.testing.assert_allclose(field.covariance, min(doubt, 4.0) ** 2 * field_of(belief))
    assert len(Estimate(belief, "a network", Doubt(2.0, 8.0)).observations()) == 1


def field_of(belief: LensPrior) -> np.ndarray:
    return of_belief_field(belief, "a network").covariance


def test_curves_decide_how_far_an_estimate_counts_in_what_they_do_not_tell() -> None:
    """Straight lines leave the scale open: there an estimate counts that leaves them straight."""
    rng = np.random.default_rng(3)
    curves = line_pictures(LENS, 40, rng, noise=0.3)
    spread = 0.001 * generic_prior(0.75, WIDTH, HEIGHT).covariance

    def fitted(lens: KannalaBrandt, doubt: Doubt) -> KannalaBrandt:
        estimate = Estimate(LensPrior(lens.to_vector(), spread), "a network", doubt)
        fit = fit_lens([curves], WIDTH, HEIGHT, estimate=estimate, config=FitConfig(vanishing=None))
        assert fit.camera is not None
        assert fit.scale_source == "a network"
        return fit.camera

    doubts = (Doubt(2.0, 8.0, unit=2.0), Doubt(8.0, 8.0, unit=2.0))
    wider = rescaled(LENS, 0.8)
    believed, doubted = (fitted(wider, doubt).k[0] for doubt in doubts)
    assert abs(believed - wider.k[0]) < 0.5 * abs(doubted - wider.k[0])
    bent = replace(wider, k=wider.k * np.array([1.0, -2.0, 1.0, 1.0, 1.0]))
    anyhow, doubted = (fitted(bent, doubt) for doubt in doubts)
    np.testing.assert_array_equal(anyhow.to_vector(), doubted.to_vector())

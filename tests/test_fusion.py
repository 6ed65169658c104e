"""The hybrid on pictures whose lens is known: a shipped render, and the example."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from small_networks import SMALL

from classical.camera import KannalaBrandt
from classical.fit import Estimate, fit_lens, of_belief, of_belief_field
from classical.lines import curves_from_image
from eval.metrics import aligned_error
from hybrid import Rectifier, RectifyConfig, read_picture
from hybrid.config import METHOD_VARIANTS
from hybrid.fusion import VARIANTS, HybridConfig
from hybrid.networks import network_belief
from hybrid.orientation import Orientation
from learned.larecnet import LaRecNet
from learned.predictor import LensPrediction, Predictor
from learned.weights import save_weights

EXAMPLE = Path(__file__).parents[1] / "examples" / "room.jpg"


@pytest.fixture(scope="module")
def room():
    return read_picture(EXAMPLE).pixels


@pytest.fixture(scope="module")
def truth() -> KannalaBrandt:
    known = json.loads(EXAMPLE.with_name("room.truth.json").read_text())
    return KannalaBrandt(
        np.array(known["k"]),
        *(known[name] for name in ("m_u", "m_v", "u0", "v0", "width", "height")),
    )


@pytest.fixture(scope="module")
def hybrid():
    return Rectifier(RectifyConfig(method="hybrid"))


@pytest.fixture(scope="module")
def found(hybrid, room):
    return hybrid.rectify(room)


def error(camera: KannalaBrandt | None, truth: KannalaBrandt) -> float:
    assert camera is not None
    return aligned_error(camera, truth, width=truth.width, height=truth.height, spacing=4.0)


def test_the_example_becomes_straight(found, truth):
    assert found.status == "ok"
    assert error(found.camera, truth) < 1.0
    assert found.camera.k[0] * found.camera.m_u == pytest.approx(truth.k[0] * truth.m_u, rel=0.03)


def test_the_same_picture_gives_the_same_bits(hybrid, found, room):
    again = hybrid.rectify(room)
    np.testing.assert_array_equal(again.camera.to_vector(), found.camera.to_vector())
    np.testing.assert_array_equal(again.image, found.image)


@pytest.mark.parametrize("turn", ["quarter", "mirror"])
def test_a_turned_picture_has_the_same_lens(hybrid, found, room, turn):
    picture = np.rot90(room) if turn == "quarter" else room[:, ::-1]
    camera = hybrid.rectify(np.ascontiguousarray(picture)).camera
    theta = np.linspace(0.1, 1.0, 19)
    np.testing.assert_allclose(
        camera.radius(theta) * (camera.m_v if turn == "quarter" else camera.m_u),
        found.camera.radius(theta) * found.camera.m_u,
        rtol=1e-9,
    )


@pytest.mark.parametrize("variant", sorted(VARIANTS))
def test_each_variant_finds_a_lens(room, truth, variant):
    camera = Rectifier(RectifyConfig(method="hybrid", variant=variant)).calibrate([room]).camera
    assert error(camera, truth) < 6.0


def test_both_methods_follow_lines_in_the_picture(room):
    def length(found):
        return sum(np.ptp(curve.points, axis=0).max() for curve in found.curves[0])

    edges, followed = (
        Rectifier(RectifyConfig(method="hybrid", variant=variant)).calibrate([room])
        for variant in ("edges", "followed")
    )
    assert length(followed) > 1.005 * length(edges)
    seen = Orientation.of([room]).seen(room)
    height, width = seen.shape[:2]
    blind = fit_lens([curves_from_image(seen)], width, height)
    seeing = Rectifier(RectifyConfig(method="classical")).calibrate([room])
    assert length(seeing) > 1.005 * length(blind)


def test_variants_of_the_configuration_are_those_that_exist():
    assert METHOD_VARIANTS["hybrid"] == tuple(VARIANTS)
    with pytest.raises(ValueError, match="Expected a variant of hybrid"):
        RectifyConfig(method="hybrid", variant="2014")


@pytest.mark.parametrize("method", ["hybrid", "classical"])
def test_a_focal_length_given_is_kept(room, truth, method):
    focal = truth.k[0] * truth.m_u * 1.1  # wrong by so much that only the user can have said it
    config = RectifyConfig(
        method=method, camera_focal=focal, variant="edges" if method == "hybrid" else None
    )
    found = Rectifier(config).calibrate([room])
    assert found.camera is not None
    assert found.camera.k[0] * found.camera.m_u == pytest.approx(focal, rel=0.08)
    if method == "hybrid":
        assert found.quality.scale_source == "the focal length given"


@pytest.mark.parametrize("name", ["camera_focal", "camera_fov", "circle_fov"])
def test_impossible_knowledge_is_refused(name):
    bad: dict[str, Any] = {name: -1.0}
    with pytest.raises(ValueError, match=f"Expected {name}"):
        RectifyConfig(**bad)


def test_a_circle_that_is_not_there_is_refused(room):
    with pytest.raises(ValueError, match="Expected an image circle"):
        Rectifier(RectifyConfig(method="classical", circle_fov=180.0)).calibrate([room])


@pytest.mark.parametrize("level", [0, 128])
def test_a_picture_of_nothing_fails(hybrid, level):
    found = hybrid.rectify(np.full((240, 320, 3), level, np.uint8), throw=False)
    assert found.status == "failed"
    assert found.camera is None


def test_weights_without_a_covariance_are_believed_as_far_as_lenses_differ(truth):
    belief = network_belief([LensPrediction(truth, None, None)])
    assert belief is not None
    assert np.allclose(belief.mean, truth.normalized().to_vector())
    assert np.sqrt(belief.covariance[0, 0]) > 0.1 * truth.normalized().k[0]
    assert network_belief([LensPrediction(None, None, None)]) is None


@pytest.mark.parametrize("doubt", [3.0, None])
def test_weights_with_a_doubt_speak_of_the_lens_and_others_of_its_field_more_surely(
    tmp_path, monkeypatch, doubt
):
    torch.manual_seed(0)
    path = tmp_path / "small.safetensors"
    save_weights(path, LaRecNet(SMALL), {} if doubt is None else {"doubt": doubt})
    heard: list[Estimate] = []

    def listen(*arguments, estimate, **options):
        heard.append(estimate)
        return fit_lens(*arguments, estimate=estimate, **options)

    monkeypatch.setattr("hybrid.fusion.fit_lens", listen)
    picture = np.random.default_rng(0).integers(0, 255, (96, 128, 3), dtype=np.uint8)
    Rectifier(RectifyConfig(method="hybrid", weights=str(path))).calibrate([picture])
    belief = network_belief([Predictor.from_weights(path).lens(picture)])
    assert belief is not None
    usual, lens = HybridConfig().doubt, of_belief(belief, "network")
    # k1..k5, m_v, u0, v0: lenses are not centred better than so, whatever the network says
    slack = np.diag([0.0] * 6 + [(usual.centring * 64) ** 2] * 2)
    field = of_belief_field(belief, "network")
    assert usual.field is not None
    unsure = [
        (field, usual.field**2 * field.covariance),
        (lens, usual.most**2 * lens.covariance + slack),
    ]
    told = unsure if doubt is None else [(lens, doubt**2 * lens.covariance)]
    least = usual.least if doubt is None else doubt
    agreed = heard[0].observations(0.0)
    np.testing.assert_allclose(agreed[-1].covariance[0, 0], least**2 * lens.covariance[0, 0])
    assert doubt is not None or heard[0].doubt == usual
    for one, (other, covariance) in zip(heard[0].observations(), told, strict=True):
        assert one.source == "network"
        np.testing.assert_array_equal(one.matrix, other.matrix)
        np.testing.assert_allclose(one.value, other.value)
        np.testing.assert_allclose(one.covariance, covariance)


@pytest.mark.parametrize("tells", [True, False])
def test_learned_is_the_networks_lens_whether_or_not_it_says_how_sure_it_is(tmp_path, tells):
    torch.manual_seed(0)
    calibration = replace(SMALL.calibration, covariance=tells)
    path = tmp_path / "small.safetensors"
    save_weights(path, LaRecNet(replace(SMALL, calibration=calibration)), {})
    picture = np.random.default_rng(0).integers(0, 255, (96, 128, 3), dtype=np.uint8)
    found = Rectifier(RectifyConfig(method="learned", weights=str(path))).calibrate([picture])
    alone = Predictor.from_weights(path).lens(picture).camera
    assert found.camera is not None
    assert alone is not None
    np.testing.assert_allclose(found.camera.to_vector(), alone.normalized().to_vector(), rtol=1e-6)


def test_threads_do_not_change_the_answer(found, room):
    alone = Rectifier(RectifyConfig(method="hybrid", threads=1)).rectify(room)
    assert alone.camera is not None
    assert np.array_equal(alone.camera.to_vector(), found.camera.to_vector())


@pytest.mark.parametrize(
    ("deviation", "off", "status", "reason"),
    [
        (1e-3, 0.0, "ok", "become straight"),
        (0.008, 0.0, "degraded", "the error may be 6.9 px"),  # three times what is expected
        (0.3, 0.0, "degraded", "unsure"),
        (1e-3, -0.45, "degraded", "of the curves' length only"),
    ],
)
def test_the_network_alone_is_ok_where_it_is_sure_and_curves_become_straight(
    monkeypatch: pytest.MonkeyPatch,
    room: np.ndarray,
    truth: KannalaBrandt,
    deviation: float,
    off: float,
    status: str,
    reason: str,
) -> None:
    vector = truth.normalized().to_vector()
    vector[1] -= off * vector[0]
    camera = KannalaBrandt.from_vector(vector, truth.width, truth.height)
    covariance = np.diag([*np.full(5, deviation * vector[0]), 0.0, 1.0, 1.0, 1.0]) ** 2
    answer = LensPrediction(camera, covariance, None)
    monkeypatch.setattr(Predictor, "lens", lambda self, picture: answer)
    found = Rectifier(RectifyConfig(method="learned")).calibrate([room])
    assert found.status == status, found.reason
    assert reason in found.reason


@pytest.mark.parametrize("deviation", [0.02, 1e-4])
def test_the_networks_lens_reaches_the_corners_or_the_result_says_that_it_does_not(
    monkeypatch: pytest.MonkeyPatch, room: np.ndarray, deviation: float
) -> None:
    height, width = room.shape[:2]
    ratio = -0.33  # of k2 to k1: r turns at 58°
    turn = 1 / np.sqrt(-3 * ratio)
    k1 = 0.985 * np.hypot(1, height / width) / (turn * 2 / 3)  # just before the corners
    camera = KannalaBrandt(
        np.array([k1, ratio * k1, 0, 0, 0]),
        *(width / 2, width / 2, (width - 1) / 2, (height - 1) / 2, width, height),
    )
    covariance = np.diag([*np.full(5, deviation * k1), 0.0, 1.0, 1.0, 1.0]) ** 2
    answer = LensPrediction(camera, covariance, None)
    monkeypatch.setattr(Predictor, "lens", lambda self, picture: answer)
    found = Rectifier(RectifyConfig(method="learned")).calibrate([room])
    assert found.camera is not None
    corners = np.array([[0.0, 0.0], [width - 1.0, height - 1.0]])
    assert not camera.unproject(corners)[1].any()
    assert found.camera.unproject(corners)[1].all() == (deviation > 1e-3)
    assert deviation > 1e-3 or found.status == "degraded"

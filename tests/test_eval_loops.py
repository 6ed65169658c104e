"""The two loops: what is kept, what is done again, and that failures count."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from classical.camera import Division, KannalaBrandt
from eval.cases import Case, Suite
from eval.folder import RunFolder, claim_folder
from eval.methods import METHODS, Method, method_of, parse_methods
from eval.predict import predict_suite, settings_of
from eval.prediction import Prediction
from eval.score import score_suite

CAMERA = KannalaBrandt(np.array([1.1, -0.05, 0.0, 0.0, 0.0]), 80.0, 80.0, 78.0, 61.0, 160, 120)
LINES = tuple(
    np.column_stack([np.linspace(10, 150, 60), 60 + offset + 0.002 * np.linspace(-70, 70, 60) ** 2])
    for offset in (-30, 5, 30)
)
TRUE, LEFT, BROKEN = Method("true", "Truth", "#000000"), method_of("identity"), method_of("broken")


@pytest.fixture
def suite(tmp_path: Path) -> Suite:
    cases = []
    for index in range(3):
        rng = np.random.default_rng(index)
        picture = cv2.GaussianBlur(rng.integers(0, 256, (120, 160, 3)).astype(np.uint8), (0, 0), 3)
        path = tmp_path / f"{index}.png"
        cv2.imwrite(str(path), cv2.normalize(picture, None, 0, 255, cv2.NORM_MINMAX))  # pyright: ignore
        cases.append(Case(f"picture{index}", path, CAMERA, "one lens", LINES))
    return Suite("toy", tuple(cases), is_real=False)


class Recorder:
    """A factory whose predictors count their calls and may be interrupted."""

    def __init__(self, *, stop_at: int | None = None) -> None:
        self.calls = 0
        self.stop_at = stop_at

    def __call__(self, tag: str, settings: tuple):
        return lambda pictures: [self.answer(tag) for _ in pictures]

    def answer(self, tag: str) -> Prediction:
        self.calls += 1
        if self.calls == self.stop_at:
            raise KeyboardInterrupt
        if tag == "broken":
            raise RuntimeError("no lines")
        return Prediction(CAMERA if tag == "true" else None, "ok")


def run(suite: Suite, root: Path, methods: tuple[Method, ...], factory, **options) -> RunFolder:
    folder = RunFolder(root)
    claim_folder(folder, suite, {method: {} for method in methods})
    list(predict_suite(suite, {m: {} for m in methods}, folder, factory=factory, **options))
    list(score_suite(suite.cases, suite.theta_max, methods, folder, **options))
    return folder


def scores(folder: RunFolder, tag: str) -> dict:
    return json.loads(folder.score("picture1").read_text())["methods"][tag]


def test_a_prediction_survives_the_disk(tmp_path):
    curves = tuple(line.astype(np.float32) for line in LINES)
    inlier = np.array([True, False, True])
    covariance = np.diag(np.arange(9.0))
    before = Prediction(CAMERA, "degraded", "few lines", 0.1, 2.5, curves, inlier, covariance)
    before.save(tmp_path / "a.npz")
    after = Prediction.load(tmp_path / "a.npz")
    assert after.camera == CAMERA
    assert (after.status, after.reason, after.seconds) == ("degraded", "few lines", 0.1)
    assert all(np.array_equal(a, b) for a, b in zip(after.curves, curves, strict=True))
    assert after.inlier is not None
    assert after.inlier.tolist() == inlier.tolist()
    assert after.covariance is not None
    assert after.covariance.tolist() == covariance.tolist()


def test_a_division_camera_survives_the_disk(tmp_path):
    camera = Division(-1.23e-6, 159.5, 100.25, 320, 240)
    Prediction(camera, "ok").save(tmp_path / "a.npz")
    after = Prediction.load(tmp_path / "a.npz").camera
    assert isinstance(after, Division)
    assert (after.lambda_, after.u0, after.focal_px) == (-1.23e-6, 159.5, 160.0)


def test_what_is_done_is_not_done_again(suite, tmp_path):
    run(suite, tmp_path / "out", (TRUE,), Recorder())
    again = Recorder()
    run(suite, tmp_path / "out", (TRUE,), again)
    assert again.calls == 0


def test_an_interrupted_run_loses_the_picture_in_hand_and_no_other(suite, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run(suite, tmp_path / "out", (TRUE,), Recorder(stop_at=2))
    assert len(list((tmp_path / "out" / "predictions" / "true").iterdir())) == 1
    rest = Recorder()
    run(suite, tmp_path / "out", (TRUE,), rest)
    assert rest.calls == 2


def test_a_method_added_later_runs_alone(suite, tmp_path):
    run(suite, tmp_path / "out", (TRUE,), Recorder())
    added = Recorder()
    folder = run(suite, tmp_path / "out", (TRUE, LEFT), added)
    assert added.calls == 3
    assert set(folder.read_config()["methods"]) == {"true", "identity"}


def test_other_settings_of_a_method_are_refused_by_name(suite, tmp_path):
    folder = RunFolder(tmp_path / "out")
    claim_folder(folder, suite, {TRUE: {"seed": 0}})
    with pytest.raises(ValueError, match=r"true\.seed 0 not 1"):
        claim_folder(folder, suite, {TRUE: {"seed": 1}})


def test_other_pictures_are_refused(suite, tmp_path):
    folder = RunFolder(tmp_path / "out")
    claim_folder(folder, suite, {TRUE: {}})
    cv2.imwrite(str(suite.cases[0].picture), np.zeros((120, 160, 3), np.uint8))
    with pytest.raises(ValueError, match="fingerprint"):
        claim_folder(folder, Suite("toy", suite.cases, is_real=False), {TRUE: {}})


def test_the_truth_scores_perfectly(suite, tmp_path):
    score = scores(run(suite, tmp_path / "out", (TRUE,), Recorder()), "true")
    for protocol in ("paper", "aligned"):
        assert score[protocol]["rpe"] == pytest.approx(0, abs=1e-6)
        assert score[protocol]["psnr"] > 60
        assert score[protocol]["ssim"] > 0.999
        assert score[protocol]["f"] > 0.999
    assert score["focal_error"] == pytest.approx(0, abs=1e-6)
    assert score["angular_error"] == pytest.approx(0, abs=1e-6)


def test_an_exception_is_a_failure_scored_as_left_alone(suite, tmp_path):
    folder = run(suite, tmp_path / "out", (LEFT, BROKEN), Recorder())
    failed, left = scores(folder, "broken"), scores(folder, "identity")
    assert failed["status"] == "failed"
    assert failed["reason"] == "RuntimeError: no lines"
    for protocol in ("paper", "aligned"):
        assert failed[protocol] == left[protocol]
    assert failed["straightness"] == left["straightness"] > 0


def test_a_changed_answer_is_scored_again(suite, tmp_path):
    folder = run(suite, tmp_path / "out", (TRUE,), Recorder())
    Prediction(None, "ok").save(folder.prediction("true", "picture1"))
    list(score_suite(suite.cases, suite.theta_max, (TRUE,), folder))
    assert scores(folder, "true")["paper"]["rpe"] > 1


def test_two_workers_give_the_scores_of_one(suite, tmp_path):
    with threadpool_limits(2):  # whatever the environment says
        one, two = (
            run(suite, tmp_path / f"out{workers}", (LEFT,), None, workers=workers)
            for workers in (1, 2)
        )
    first, second = scores(one, "identity"), scores(two, "identity")
    for score in (first, second):
        del score["seconds"], score["digest"]
    assert first == second


def test_a_method_that_takes_a_camera_at_once_sees_all_its_pictures(suite, tmp_path):
    seen = []

    def factory(estimator: str, settings: tuple):
        def predict(pictures):
            seen.append((estimator, len(pictures)))
            return [Prediction(CAMERA, "ok") for _ in pictures]

        return predict

    folder = run(suite, tmp_path / "out", (method_of("hybrid-together"),), factory)
    assert seen == [("hybrid", 3)]
    assert scores(folder, "hybrid-together")["paper"]["rpe"] == pytest.approx(0, abs=1e-6)


def test_names_of_pictures_must_differ(suite):
    with pytest.raises(ValueError, match="distinct names"):
        Suite("toy", (suite.cases[0], suite.cases[0]), is_real=False)


def test_methods_come_in_the_order_of_the_tables():
    assert [method.tag for method in parse_methods("hybrid, identity")] == ["identity", "hybrid"]
    with pytest.raises(ValueError, match="got 'magic'"):
        parse_methods("magic")


def test_colours_of_methods_differ():
    assert len({method.color for method in METHODS}) == len(METHODS)


def test_the_field_of_view_of_a_case_by_hand():
    camera = KannalaBrandt.centred(np.array([1.0, 0, 0, 0, 0]), 320, 240)
    case = Case("a", Path("a.png"), camera, "one")
    assert case.fov == pytest.approx(np.degrees(2.0))  # one radian to each side


def test_steps_of_the_hybrid_are_methods_of_their_own(suite) -> None:
    (step,) = parse_methods("hybrid-snapped")
    assert step.estimator == "hybrid"
    assert settings_of(step, suite, seed=3)["variant"] == "snapped"
    assert "variant" not in settings_of(parse_methods("hybrid")[0], suite, seed=3)

"""The best fixed lens: a yardstick that sees the truth, and is told apart."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from classical.camera import KannalaBrandt
from eval.cases import Case, Suite
from eval.commands import evaluate, report
from eval.fixed import UNITS, FixedLens, best_fixed_lens
from eval.folder import RunFolder
from eval.methods import FIXED, METHODS, parse_methods
from eval.metrics import THETA_MAX, aligned_error
from eval.predict import project_method, settings_of
from eval.prediction import Prediction
from eval.summary import MethodScores, SuiteScores, load_scores, median, paper_columns
from eval.tables import make_table, overview
from learned.slf.suite import SuiteFolder, SuiteItem

ODD = np.array([0.91, -0.13, 0.06, -0.012, 0.0])  # no standard projection


def case(k: np.ndarray, width: int, height: int, *, unit: str = "half width", name="a") -> Case:
    """A picture that nobody opens, of a lens in some unit."""
    camera = FixedLens(unit, tuple(k)).camera(width, height)
    return Case(name, Path("missing.png"), camera, "one")


def left(lens: FixedLens, cases: list[Case]) -> float:
    """Median aligned error where all pictures are given a lens."""
    sizes = [(c.camera.width, c.camera.height) for c in cases]
    return float(
        np.median(
            [
                aligned_error(lens.camera(*size), c.camera, width=size[0], height=size[1])
                for c, size in zip(cases, sizes, strict=True)
            ]
        )
    )


def test_a_lens_in_a_unit_by_hand():
    # k1 = 1 a half height: half a picture 300 px high is one radian
    camera = FixedLens("half height", (1.0, 0.0, 0.0, 0.0, 0.0)).camera(400, 300)
    points, _ = camera.project(np.array([[0.0, np.sin(1.0), np.cos(1.0)]]))
    assert points[0] == pytest.approx([199.5, 149.5 + 150])
    assert FixedLens("half width", tuple(ODD)).camera(400, 300) == KannalaBrandt.centred(
        ODD, 400, 300
    )


@pytest.mark.parametrize("unit", UNITS)
def test_pictures_that_share_a_lens_are_given_it_in_the_unit_they_share(unit):
    sizes = [(320, 320), (320, 240), (640, 360)]
    cases = [case(ODD, *size, unit=unit) for size in sizes]
    found = best_fixed_lens(cases, THETA_MAX)
    assert found == FixedLens(unit, tuple(ODD))
    assert left(found, cases) < 1e-6


def test_standard_projections_are_candidates():
    # each picture has a lens of its own, and an equidistant one of 120° lies between them
    cases = [
        case(np.array([k, 0.0, 0.0, 0.0, 0.0]), 320, 320) for k in 1 / np.radians([52, 56, 64, 68])
    ]
    found = best_fixed_lens(cases, THETA_MAX)
    truths = [FixedLens("half width", tuple(c.camera.k)) for c in cases]
    assert left(found, cases) < min(left(lens, cases) for lens in truths)


def test_principal_point_and_aspect_of_a_candidate_are_left_out():
    bent = KannalaBrandt(ODD, 160.0, 150.0, 170.0, 140.0, 320, 320)
    cases = [Case("a", Path("missing.png"), bent, "one"), case(ODD, 320, 320, name="b")]
    found = best_fixed_lens([*cases, case(ODD, 320, 320, name="c")], THETA_MAX)
    assert found == FixedLens("half width", tuple(ODD))


def test_it_is_asked_for_by_name_only():
    assert FIXED not in METHODS
    assert parse_methods("fixed") == (FIXED,)
    assert "knows the truth" in FIXED.full_name


def test_its_settings_are_the_lens_and_give_each_picture_its_own_size(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((240, 320, 3), np.uint8))
    only = replace(case(ODD, 320, 240), picture=tmp_path / "a.png")
    settings = settings_of(FIXED, Suite("toy", (only,), is_real=False), seed=5)
    assert settings == {"unit": "half width", "k": tuple(ODD)}
    answer = project_method("fixed", tuple(sorted(settings.items())))
    (found,) = answer([np.zeros((120, 160, 3), np.uint8)])
    assert found == Prediction(KannalaBrandt.centred(ODD, 160, 120), "ok")


def test_what_knows_the_truth_is_never_the_best_of_a_table():
    def row(method, error):
        values = {"rpe": error, "psnr": 20.0, "ssim": 0.5}
        record = {"paper": values, "aligned": values, "status": "ok"}
        return MethodScores(method, (record,))

    rows = (row(METHODS[0], 9.0), row(METHODS[1], 4.0), row(FIXED, 0.0))
    suite = SuiteScores({"suite": {"name": "toy"}}, ("a",), rows)
    assert suite.primary.method == METHODS[1]
    assert [cells[0].best for _, _, cells in overview([suite]).rows] == [False, True, False]
    errors = make_table("t", suite, paper_columns("aligned")[3:4])
    assert [cells[0].best for _, _, cells in errors.rows] == [False, True, False]


def test_evaluate_and_report_take_it_like_any_method(tmp_path):
    folder = SuiteFolder(tmp_path / "own" / "drawn")
    folder.begin({"kind": "test", "name": "drawn", "note": "Noise.", "settings": {}})
    for index, focal in enumerate((1.0, 1.0, 1.2)):
        camera = KannalaBrandt.centred(ODD * focal, 160, 120)
        picture = np.random.default_rng(index).integers(0, 256, (120, 160, 3), dtype=np.uint8)
        picture = cv2.GaussianBlur(picture, (0, 0), 3)
        folder.write(SuiteItem(index, camera, 1.2, (), "noise"), picture, picture, picture[..., 0])
    words = ["--suite", str(folder.path), "--out", str(tmp_path / "runs"), "--methods", "fixed"]
    for _ in range(2):  # the same lens again, so that the folder is taken up
        result = CliRunner().invoke(evaluate, words, catch_exceptions=False)
        assert result.exit_code == 0, result.output
    run = RunFolder(tmp_path / "runs" / "drawn")
    assert run.read_config()["methods"] == {"fixed": {"unit": "half width", "k": ODD.tolist()}}
    errors = load_scores(run).methods[0].values("aligned", "rpe")
    assert errors[:2] == pytest.approx(0, abs=1e-4)
    assert median(errors) < 1e-4 < errors[2]
    words = [str(tmp_path / "runs"), "--out", str(tmp_path / "report")]
    assert CliRunner().invoke(report, words, catch_exceptions=False).exit_code == 0
    text = (tmp_path / "report" / "report.md").read_text(encoding="utf-8")
    assert "| Best fixed lens (knows the truth) |" in text

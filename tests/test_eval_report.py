"""From a test set on disk to the report: loaders, tables, choice of cases, files, commands."""

import csv
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from classical.camera import KannalaBrandt
from eval.commands import evaluate, report
from eval.doubt import expected_error
from eval.folder import RunFolder
from eval.gallery import choose, network_maps
from eval.methods import Method, method_of
from eval.open_suite import bend, open_suite
from eval.published import SLF
from eval.report import write_report
from eval.summary import (
    Column,
    MethodScores,
    SuiteScores,
    fov_bins,
    fov_columns,
    load_scores,
    median,
    paper_columns,
    trust_columns,
)
from eval.tables import make_table, published_table
from hybrid import read_picture
from learned.slf.suite import SuiteCurve, SuiteFolder, SuiteItem

CAMERA = KannalaBrandt(np.array([1.1, -0.05, 0.0, 0.0, 0.0]), 80.0, 80.0, 79.5, 59.5, 160, 120)


def picture(seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).integers(0, 256, (120, 160, 3)).astype(np.uint8)
    return cv2.GaussianBlur(noise, (0, 0), 2)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory) -> Path:
    """A list of calibrated photographs of two cameras, one of them nearly straight."""
    folder = tmp_path_factory.mktemp("real") / "lenses"
    folder.mkdir()
    K, D = CAMERA.to_opencv()
    entries = []
    for index, (name, focal) in enumerate([("wide", 1.0), ("wide", 1.0), ("narrow", 6.0)]):
        cv2.imwrite(str(folder / f"{index}.png"), picture(index))
        lens = {"fx": K[0, 0] * focal, "fy": K[1, 1] * focal, "cx": K[0, 2], "cy": K[1, 2]}
        size = {"width": 160, "height": 120, "D": D.tolist(), "camera": name}
        entries.append({"image": f"{index}.png", **lens, **size})
    (folder / "suite.json").write_text(json.dumps(entries))
    return folder


@pytest.fixture(scope="module")
def synthesised(tmp_path_factory) -> Path:
    """A set in the project's own format, with one marked line a picture."""
    folder = SuiteFolder(tmp_path_factory.mktemp("own") / "drawn")
    folder.begin({"kind": "test", "name": "drawn", "note": "Noise with a line.", "settings": {}})
    line = np.column_stack([np.linspace(-1, 1, 60), np.full(60, 0.5), np.ones(60)])
    points, _ = CAMERA.project(line)
    curve = SuiteCurve(points, line[[0, -1]], 120.0)
    for index in range(3):
        item = SuiteItem(index, CAMERA, 1.2, (curve,), f"noise {index}")
        folder.write(item, picture(index), picture(index), picture(index)[..., 0])
    return folder.path


@pytest.fixture(scope="module")
def finished(photographs, synthesised, tmp_path_factory) -> Path:
    """Both suites evaluated for doing nothing, and their report."""
    out = tmp_path_factory.mktemp("run")
    suites = ["--suite", str(synthesised), "--suite", str(photographs)]
    arguments = [*suites, "--out", str(out / "runs"), "--methods", "identity"]
    result = CliRunner().invoke(evaluate, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    arguments = [str(out / "runs"), "--out", str(out / "report")]
    result = CliRunner().invoke(report, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return out


def scores_of(*rpe: float, tag: str = "identity", failed: int = 0) -> MethodScores:
    """Scores with these aligned errors, the last `failed` of them failures."""
    records = []
    for index, value in enumerate(rpe):
        counts = {"matched": [1, 2], "found": [2, 4], "true": 4, "f": 0.5}
        status = "failed" if index >= len(rpe) - failed else "ok"
        values = {"rpe": value, "psnr": 10.0 + value, "ssim": 0.5, **counts}
        records.append({"paper": values, "aligned": values, "status": status, "reason": ""})
    return MethodScores(method_of(tag), tuple(records))


def test_a_list_of_photographs_is_read_with_its_cameras(photographs):
    suite = open_suite(photographs)
    assert suite.is_real
    assert suite.name == "lenses"
    assert [case.group for case in suite.cases] == ["wide", "wide", "narrow"]
    assert suite.cases[0].camera.to_vector() == pytest.approx(CAMERA.to_vector())


def test_nearly_straight_pictures_can_be_left_out(photographs):
    suite = open_suite(photographs, min_bend=3.0)
    assert len(suite.cases) == 2
    assert "1 nearly straight" in suite.note
    assert all(bend(case) > 3 for case in suite.cases)


def test_a_set_of_our_own_is_read_with_its_lines(synthesised):
    suite = open_suite(synthesised, every=2)
    assert [case.name for case in suite.cases] == ["000000", "000002"]
    assert suite.name == "drawn"
    assert len(suite.cases[0].curves) == 1


def test_a_folder_without_a_set_is_misuse(tmp_path):
    with pytest.raises(ValueError, match="expected a folder with pictures"):
        open_suite(tmp_path)


def test_counts_are_summed_over_the_suite_before_f():
    counts = scores_of(1.0, 2.0).counts("paper")
    assert counts is not None
    assert counts.matched.tolist() == [2, 4]
    assert counts.true == 8
    # precision 1/2, recall 4/8 at the second threshold
    assert counts.f_score == pytest.approx(0.5)


def test_failures_are_in_every_number():
    row = scores_of(1.0, 3.0, 11.0, tag="classical", failed=1)
    suite = SuiteScores({}, ("a", "b", "c"), (row,))
    columns = {column.title: column for column in paper_columns("aligned")}
    assert columns["Aligned error, mean (px)"].value(row, suite) == pytest.approx(5.0)
    assert columns["median (px)"].value(row, suite) == pytest.approx(3.0)
    assert row.failed.sum() == 1


def test_the_best_of_a_column_is_marked_and_dashes_are_not():
    rows = (scores_of(4.0), scores_of(2.0, tag="classical"), scores_of(3.0, tag="hybrid"))
    small = Column("x", ".1f", lambda row, _: float(row.values("paper", "rpe")[0]))
    nothing = Column("never", ".1f", lambda row, _: float("nan"))
    table = make_table("t", SuiteScores({}, ("a",), rows), (small, nothing))
    assert table.head == ("x",)
    assert [cells[0].best for _, _, cells in table.rows] == [False, True, False]


@pytest.mark.parametrize(
    ("fov", "expected"),
    [
        # quartiles 74.75, 94.5 and 114.25
        (np.arange(55.0, 135.0), [("under 75°", 20), ("75–95°", 20), ("95–115°", 20)]),
        # 120° is in the range that begins there
        (np.repeat([100.0, 120.0], 20), [("under 120°", 20)]),
        # three of 30 at 140°, too few for a range
        (np.repeat([60.0, 90.0, 140.0], [17, 10, 3]), [("under 90°", 17)]),
        (np.full(100, 121.0), []),
        (np.linspace(60, 180, 23), []),
        (np.concatenate([np.full(30, 100.0), [160.0] * 7]), []),
    ],
)
def test_ranges_of_the_field_of_view_hold_enough_pictures_each(fov, expected):
    found = fov_bins(fov)
    assert [(words, int(inside.sum())) for words, inside in found[:-1]] == expected
    if found:
        assert sum(inside.sum() for _, inside in found) == len(fov)
        assert np.sum([inside for _, inside in found], axis=0).max() == 1
        assert min(inside.sum() for _, inside in found) >= 8
        assert found[-1][0].endswith("° up")


def test_errors_by_field_of_view_are_medians_of_its_pictures():
    fov = np.repeat([70.0, 110.0], 12)
    row = scores_of(*np.where(fov < 100, 3.0, 1.0) + np.tile([0.0, 0.0, 9.0], 8))
    suite = SuiteScores({}, tuple(str(i) for i in range(24)), (row, row))
    table = make_table("t", suite, fov_columns(fov))
    assert table.head[1::2] == ("RPE, 110° up (12)", "Aligned, 110° up (12)")
    assert [cell.text for cell in table.rows[0][2]] == ["3.00", "1.00", "3.00", "1.00"]
    assert fov_columns(fov[:20]) == ()


def test_the_report_has_a_table_by_field_of_view(finished, tmp_path, monkeypatch):
    words = "By horizontal field of view"
    assert words not in (finished / "report" / "report.md").read_text(encoding="utf-8")
    monkeypatch.setattr("eval.summary._LEAST_BIN", 1)
    monkeypatch.setattr("eval.summary._LEAST_BINNED", 3)
    arguments = [str(finished / "runs"), "--out", str(tmp_path)]
    CliRunner().invoke(report, arguments, catch_exceptions=False)
    for name in ("report.html", "report.md"):
        text = (tmp_path / name).read_text(encoding="utf-8")
        assert text.count(f"{words}: median") >= 1
        assert text.count("Aligned, under") == 1  # the drawn set has one lens


def test_trust_compares_the_expected_error_with_the_aligned_one():
    row = scores_of(0.5, 1.0, 2.0, 4.0, 99.0, tag="hybrid", failed=1)
    for record, expected in zip(row.records, [0.4, 1.0, 3.0, 2.5, 50.0], strict=True):
        record["predicted_error_px"] = expected
    row.records[1]["status"] = "degraded"
    suite = SuiteScores({}, tuple("abcde"), (row,))
    rank, ratio, ok, honest = (column.value(row, suite) for column in trust_columns())
    assert rank == pytest.approx(0.8)  # of four pictures: the failure gave no lens
    assert ratio == pytest.approx((1.0 + 1.25) / 2)
    assert ok == 3
    assert honest == pytest.approx(2 / 3)


def test_the_report_tells_how_far_what_expects_an_error_can_be_trusted(finished, tmp_path):
    run = RunFolder(shutil.copytree(finished / "runs" / "drawn", tmp_path / "drawn"))
    write_report([run], tmp_path)
    assert "can be trusted" not in (tmp_path / "report.md").read_text()
    for index, name in enumerate(load_scores(run).names):
        scores = json.loads(run.score(name).read_text())
        scores["methods"]["identity"]["predicted_error_px"] = 1.0 + index
        run.score(name).write_text(json.dumps(scores))
    write_report([run], tmp_path)
    assert "can be trusted" in (tmp_path / "report.md").read_text()


def test_median_ignores_what_is_unknown():
    assert median(np.array([1.0, np.nan, 3.0])) == 2.0
    assert np.isnan(median(np.array([np.nan])))


def test_published_numbers_are_never_marked():
    table = published_table("paper", SLF)
    assert not any(cell.best for _, _, cells in table.rows for cell in cells)
    assert table.rows[4][2][3].text == "0.33"
    assert table.rows[3][2][2].text == "–"


def test_cases_are_chosen_by_error_then_name():
    errors = np.array([5.0, 1.0, 9.0, 1.0, 3.0, 4.0, 8.0])
    names = ["a", "c", "b", "b2", "d", "e", "f"]
    assert choose(errors, names) == [
        (3, "best"),
        (1, "best"),
        (4, "median"),
        (5, "median"),
        (6, "worst"),
        (2, "worst"),
    ]


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_few_cases_are_shown_once(n):
    indices = [index for index, _ in choose(np.arange(float(n)), [str(i) for i in range(n)])]
    assert sorted(indices) == list(range(n))


def test_expected_error_of_a_shift_by_hand():
    # One pixel of doubt in u0 moves the middle of an equidistant picture by 1 / k1 pixels
    camera = KannalaBrandt.centred(np.array([0.8, 0, 0, 0, 0]), 320, 320)
    covariance = np.zeros((9, 9))
    covariance[7, 7] = 1.0
    error = expected_error(camera, covariance)
    assert error[40, 40] == pytest.approx(1 / 0.8, rel=1e-3)


def test_expected_error_is_unknown_where_nothing_is_shown():
    camera = KannalaBrandt.centred(np.array([1.8, 0, 0, 0, 0]), 320, 320)
    error = expected_error(camera, np.eye(9))
    assert np.isnan(error[0, 0])
    assert np.isfinite(error[40, 40])


class Page(HTMLParser):
    """Collects what the tests look at."""

    def __init__(self) -> None:
        super().__init__()
        self.images: list[dict[str, str | None]] = []
        self.links: list[str] = []
        self.ids: list[str] = []
        self.figures = 0
        self.tags: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.tags.add(tag)
        if tag == "img":
            self.images.append(values)
        if tag == "a":
            self.links.append(values["href"] or "")
        if tag == "svg":
            self.figures += values.get("role") == "img" and bool(values.get("aria-label"))
        if values.get("id"):
            self.ids.append(str(values["id"]))


def test_the_page_stands_alone_and_every_picture_has_its_text(finished):
    text = (finished / "report" / "report.html").read_text(encoding="utf-8")
    page = Page()
    page.feed(text)
    assert page.images
    assert all(str(image["src"]).startswith("data:image/jpeg") for image in page.images)
    assert all(image.get("alt") for image in page.images)
    assert page.figures == text.count("<svg")
    assert "script" not in page.tags
    assert set(page.links) <= {f"#{name}" for name in page.ids}
    outside = re.findall(r'(?:src|href)="(?!data:|#)([^"]+)"', text)
    assert outside == []


def test_the_page_shows_all_protocols_cameras_and_published_numbers(finished):
    for name in ("report.html", "report.md"):
        text = (finished / "report" / name).read_text(encoding="utf-8")
        for words in ("Protocol 1", "Protocol 2", "Protocol 3", "Protocol 4", "Left alone"):
            assert words in text
        assert "wide" in text
        assert "narrow" in text
        assert "164.75" in text
        assert "not public" in text


def read_rows(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


def test_the_csv_holds_a_row_a_photograph(finished):
    rows = read_rows(finished / "report" / "scores.csv")
    assert [(row["suite"], row["picture"]) for row in rows] == [
        *(("drawn", f"{index:06d}") for index in range(3)),
        *(("lenses", str(index)) for index in range(3)),
    ]
    for row in rows:
        assert float(row["aligned_rpe"]) <= float(row["paper_rpe"])
        assert bool(row["paper_f"]) == (row["suite"] == "drawn")
    summary = read_rows(finished / "report" / "summary.csv")
    mean = np.mean([float(row["paper_rpe"]) for row in rows if row["suite"] == "drawn"])
    assert float(summary[0]["paper_rpe_mean"]) == pytest.approx(mean, abs=1e-5)


def test_the_report_needs_the_scores_alone_and_is_the_same_again(finished, tmp_path):
    runs = [str(finished / "runs" / name) for name in ("drawn", "lenses")]
    CliRunner().invoke(report, [*runs, "--out", str(tmp_path)], catch_exceptions=False)
    for name in ("report.html", "report.md", "summary.csv", "scores.csv"):
        assert (tmp_path / name).read_bytes() == (finished / "report" / name).read_bytes()


def test_pictures_of_a_suite_can_be_left_out(finished, tmp_path):
    arguments = [str(finished / "runs"), "--out", str(tmp_path), "--without-pictures", "lenses"]
    CliRunner().invoke(report, arguments, catch_exceptions=False)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Fisheye photograph 000000" in text
    assert 'Fisheye photograph 0"' not in text


def test_the_gallery_shows_what_the_network_sees_where_one_answered(
    finished, photographs, tmp_path
):
    assert not list((finished / "runs").glob("*/gallery/*--heatmap.jpg"))
    arguments = ["--suite", str(photographs), "--out", str(tmp_path), "--methods", "learned"]
    CliRunner().invoke(evaluate, arguments, catch_exceptions=False)
    gallery = RunFolder(tmp_path / "lenses").gallery
    rows = json.loads((gallery / "index.json").read_text())["rows"]
    assert {row["case"] for row in rows} == {"0", "1", "2"}
    for row in rows:
        files = [shown["file"] for shown in row["maps"]]
        assert files[:2] == [f"{row['case']}--{tag}.jpg" for tag in ("heatmap", "uncertainty")]
        assert all((gallery / file).is_file() for file in files)


def test_maps_of_the_network_are_bright_on_lines_and_tell_doubt_by_its_geometric_mean():
    photo = read_picture(Path(__file__).parents[1] / "examples" / "room.jpg").pixels
    heatmap, uncertainty = (each.values(photo) for each in network_maps())
    assert heatmap.max() > 0.4
    assert np.median(heatmap) < 0.05
    # bright from three times its geometric mean
    assert np.log(3 * uncertainty).mean() == pytest.approx(0.0, abs=1e-3)


def test_an_unknown_method_is_misuse(photographs, tmp_path):
    arguments = ["--suite", str(photographs), "--out", str(tmp_path), "--methods", "magic"]
    assert CliRunner().invoke(evaluate, arguments).exit_code == 2


def test_a_folder_without_runs_is_refused(tmp_path):
    result = CliRunner().invoke(report, [str(tmp_path), "--out", str(tmp_path / "r")])
    assert result.exit_code != 0
    assert "evaluate" in str(result.exception)


def test_an_unfinished_run_is_refused(finished, tmp_path):
    folder = RunFolder(tmp_path)
    source = RunFolder(finished / "runs" / "drawn")
    folder.config.write_text(source.config.read_text())
    with pytest.raises(ValueError, match="3 are missing"):
        load_scores(folder)


def test_ablation_rows_show_ours_beside_the_papers():
    from eval.tables import ablation

    row = MethodScores(Method("bl1", "BL1", "#000000"), scores_of(2.0, 4.0).records)
    (table,) = ablation([SuiteScores({"suite": {"name": "toy"}}, ("a", "b"), (row,))])
    assert [cell.text for cell in table.rows[0][2]] == [
        "13.00",
        "0.500",
        "3.00",
        "16.24",
        "0.61",
        "4.51",
    ]

"""The report: one static HTML page, the same in Markdown, and the scores as CSV."""

import base64
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from classical.files import atomic_path, remove_leftovers
from eval import plots, published
from eval.export import score_rows, summary_rows, to_csv
from eval.folder import RunFolder
from eval.summary import (
    Column,
    SuiteScores,
    camera_columns,
    fov_columns,
    load_scores,
    median,
    paper_columns,
    straightness_columns,
    trust_columns,
)
from eval.tables import Table, ablation, make_table, overview, published_table

_TEMPLATES = Path(__file__).parent / "templates"

_PROTOCOLS = (
    ("Protocol 1, paper: pinhole of f = 160 px, as estimated", paper_columns("paper")),
    ("Protocol 2, aligned: after the best similarity", paper_columns("aligned")),
    ("Protocol 3, straightness; and angles, failures, time", straightness_columns()),
)

_TRUST = "How far a method can be trusted: the error that it expects, against the aligned error"

KINDS = {
    "best": "Best",
    "median": "Median",
    "worst": "Worst",
    "camera": "Median of a camera",
}


def write_report(
    folders: Sequence[RunFolder], target: Path, *, without_pictures: Sequence[str] = ()
) -> None:
    """Write `report.html`, `report.md`, `summary.csv` and `scores.csv`, from the scores alone.

    Args:
        folders: Runs that `evaluate` has finished, in the order of the report.
        target: Folder for the files; made if missing.
        without_pictures: Names of suites whose photographs must not be shown.

    Raises:
        ValueError: If there is no run, or one is not finished.
    """
    if not folders:
        raise ValueError("expected at least one evaluated suite, got none")
    suites = [load_scores(folder) for folder in folders]
    page = {
        "overview": overview(suites),
        "suites": [
            _suite_page(suite, folder, show=suite.name not in without_pictures)
            for suite, folder in zip(suites, folders, strict=True)
        ],
        "ablation": ablation(suites),
        "published": [
            published_table("SLF test set of the paper (2,163 samples, not public)", published.SLF),
            published_table("Fisheye video dataset (real lenses)", published.FISHEYE_VIDEO),
        ],
        "thresholds": plots.thresholds_text(),
    }
    target.mkdir(parents=True, exist_ok=True)
    remove_leftovers(target)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=jinja2.select_autoescape(["html"]),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    style = Markup((_TEMPLATES / "report.css").read_text(encoding="utf-8"))
    for name in ("report.html", "report.md"):
        text = environment.get_template(name).render(style=style, **page)
        _write(target / name, text)
    _write(target / "summary.csv", to_csv(summary_rows(suites)))
    _write(target / "scores.csv", to_csv(score_rows(suites)))


def _suite_page(suite: SuiteScores, folder: RunFolder, *, show: bool) -> dict[str, Any]:
    """Everything that the templates say about a suite."""
    gallery, by = _gallery(folder) if show else ([], "")
    groups = list(dict.fromkeys(suite.groups)) if suite.is_real else []
    return {
        "name": suite.name,
        "anchor": _anchor(suite.name),
        "config": suite.config,
        "settings": _settings(suite),
        "origins": _origins(suite),
        "n": len(suite.names),
        "fov": f"{suite.fov.min():.0f}° to {suite.fov.max():.0f}°",
        "tables": [
            *(make_table(caption, suite, columns) for caption, columns in _tables(suite)),
            *_trust_table(suite),
        ],
        "real": make_table("Protocol 4, real cameras: all photographs", suite, camera_columns())
        if suite.is_real
        else None,
        "cameras": [
            {
                "name": group,
                "anchor": _anchor(f"{suite.name}-{group}"),
                "n": len(suite.part(group).names),
                "fov": f"{median(suite.part(group).fov):.0f}°",
                "table": make_table(group, suite.part(group), camera_columns()),
                "rows": [
                    row for row in gallery if (row["group"], row["kind"]) == (group, "camera")
                ],
            }
            for group in groups
        ],
        "figures": list(_figures(suite)),
        "gallery": [row for row in gallery if row["kind"] != "camera"],
        "by": by,
        "failures": _failures(suite),
    }


def _tables(suite: SuiteScores) -> Iterator[tuple[str, Sequence[Column]]]:
    """Captions and columns of a suite's tables of all methods."""
    yield from _PROTOCOLS
    if columns := fov_columns(suite.fov):
        yield "By horizontal field of view: median error in px (pictures in brackets)", columns


def _trust_table(suite: SuiteScores) -> Iterator[Table]:
    """What the methods say of their own error, where any says something."""
    rows = tuple(row for row in suite.methods if row.expects.any())
    if rows:
        yield make_table(_TRUST, SuiteScores(suite.config, suite.names, rows), trust_columns())


def _figures(suite: SuiteScores) -> Iterator[dict[str, str]]:
    """The plots of a suite as SVG with captions."""
    errors = [(row.method, row.values("aligned", "rpe")) for row in suite.methods]
    for protocol, words in (("paper", "as estimated"), ("aligned", "after the best similarity")):
        curves = [(row.method, row.counts(protocol)) for row in suite.methods]
        marked = [(method, counts) for method, counts in curves if counts is not None]
        if marked:
            caption = f"Precision and recall of the rectified lines, {words}, on {suite.name}"
            yield _figure(plots.precision_recall(marked), caption)
    caption = f"Share of photographs of {suite.name} with an aligned error below a bound"
    yield _figure(plots.error_shares(errors), caption)
    if np.ptp(suite.fov) > 5:
        caption = f"Aligned error against field of view on {suite.name}"
        yield _figure(plots.error_by_fov(errors, suite.fov), caption)
    trust = [
        (row.method, row.values("predicted_error_px")[kept], row.values("aligned", "rpe")[kept])
        for row in suite.methods
        if (kept := row.expects).any()
    ]
    if trust:
        caption = f"Error that a method expects of itself, against its aligned one, on {suite.name}"
        yield _figure(plots.trust(trust), caption)
    times = [(row.method, row.values("seconds")) for row in suite.methods]
    if any(np.median(values) > 1e-3 for _, values in times):
        yield _figure(
            plots.seconds(times),
            f"Time of an estimate on {suite.name}: bar, median; line, 90th percentile",
        )


def _figure(figure: Any, caption: str) -> dict[str, str]:
    return {"svg": Markup(plots.to_svg(figure, caption)), "caption": caption}


def _gallery(folder: RunFolder) -> tuple[list[dict[str, Any]], str]:
    """The chosen cases with their pictures as data; nothing where `evaluate` wrote none."""
    index = folder.gallery / "index.json"
    if not index.is_file():
        return [], ""
    record = json.loads(index.read_text(encoding="utf-8"))
    for row in record["rows"]:
        row["kind_text"] = KINDS[row["kind"]]
        for picture in (*row["pictures"], *row["maps"]):
            data = (folder.gallery / picture["file"]).read_bytes()
            picture["src"] = f"data:image/jpeg;base64,{base64.b64encode(data).decode()}"
    return record["rows"], record["by"]


def _failures(suite: SuiteScores) -> list[tuple[str, list[tuple[str, int]]]]:
    """Reasons of failures and how often, by method."""
    listed = []
    for row in suite.methods:
        reasons = [r["reason"] or "no reason given" for r in row.records if r["status"] == "failed"]
        counted = {reason: reasons.count(reason) for reason in dict.fromkeys(reasons)}
        if counted:
            ordered = sorted(counted.items(), key=lambda item: -item[1])[:5]
            listed.append((row.method.full_name, ordered))
    return listed


def _origins(suite: SuiteScores) -> list[dict[str, Any]]:
    """Where numbers come from; methods of one origin together."""
    listed: list[dict[str, Any]] = []
    for row in suite.methods:
        found = suite.config["origins"][row.method.tag]
        same = next((o for o in listed if {**o, "names": ""} == {**found, "names": ""}), None)
        if same is None:
            listed.append({**found, "names": row.method.full_name})
        else:
            same["names"] += f", {row.method.full_name}"
    return listed


def _settings(suite: SuiteScores) -> list[tuple[str, str]]:
    """Settings of each method as text."""
    methods = suite.config["methods"]
    return [
        (row.method.full_name, json.dumps(methods.get(row.method.tag, {}), sort_keys=True))
        for row in suite.methods
    ]


def _anchor(name: str) -> str:
    return "".join(letter if letter.isalnum() else "-" for letter in name.lower())


def _write(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")

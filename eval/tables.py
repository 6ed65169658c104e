"""Tables of the report: numbers of our methods, and published ones apart."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from eval import published
from eval.summary import Column, SuiteScores, median

_DASH = "–"


@dataclass(frozen=True)
class Cell:
    """One number of a table."""

    text: str
    best: bool = False


@dataclass(frozen=True)
class Table:
    """A table ready to print."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, str, tuple[Cell, ...]], ...]
    """Name, colour and numbers of each row."""


def make_table(caption: str, suite: SuiteScores, columns: Sequence[Column]) -> Table:
    """Numbers of all methods on a suite, the best of each column marked.

    Columns without any number are left out. What knows the truth is never the best.
    """
    values = np.array([[column.value(row, suite) for column in columns] for row in suite.methods])
    shown = [index for index in range(len(columns)) if np.isfinite(values[:, index]).any()]
    fair = np.array([not row.method.knows_truth for row in suite.methods])
    marks = {index: _best_rows(columns[index], values[:, index], fair) for index in shown}
    rows = []
    for number, row in enumerate(suite.methods):
        cells = tuple(
            Cell(_text(values[number, index], columns[index].form), number in marks[index])
            for index in shown
        )
        rows.append((row.method.full_name, row.method.color, cells))
    return Table(caption, tuple(columns[index].title for index in shown), tuple(rows))


def published_table(caption: str, rows: Sequence[published.PublishedRow]) -> Table:
    """Numbers of a paper, in the paper's columns; nothing is marked, nothing of ours is in it."""
    forms = {"psnr": ".2f", "ssim": ".2f", "f": ".2f", "rpe": ".2f"}
    body = tuple(
        (row.name, "", tuple(Cell(_text(getattr(row, key), form)) for key, form in forms.items()))
        for row in rows
    )
    return Table(caption, ("PSNR (dB)", "SSIM", "F", "RPE (px)"), body)


def overview(suites: Sequence[SuiteScores]) -> Table:
    """The fair number, median aligned error, of each method on each suite."""
    methods = dict.fromkeys(row.method for suite in suites for row in suite.methods)
    found = {
        (suite.name, row.method): median(row.values("aligned", "rpe"))
        for suite in suites
        for row in suite.methods
    }
    fair = {
        suite.name: [
            found[suite.name, row.method] for row in suite.methods if not row.method.knows_truth
        ]
        for suite in suites
    }
    rows = tuple(
        (
            method.full_name,
            method.color,
            tuple(
                _mark(
                    found.get((suite.name, method), math.nan),
                    [] if method.knows_truth else fair[suite.name],
                )
                for suite in suites
            ),
        )
        for method in methods
    )
    head = tuple(f"{suite.name} ({len(suite.names)})" for suite in suites)
    return Table("Median aligned error in px of a 320 px frame (pictures in brackets)", head, rows)


def ablation(suites: Sequence[SuiteScores]) -> list[Table]:
    """Variants BL1 to BL6 where they were run, with the paper's numbers beside ours."""
    tables = []
    for suite in suites:
        rows = [row for row in suite.methods if row.method.tag in published.ABLATION]
        if not rows:
            continue
        body = []
        for row in rows:
            theirs = published.ABLATION[row.method.tag]
            ours = [float(np.mean(row.values("paper", key))) for key in ("psnr", "ssim", "rpe")]
            numbers = [*ours, theirs.psnr, theirs.ssim, theirs.rpe]
            forms = (".2f", ".3f", ".2f", ".2f", ".2f", ".2f")
            cells = tuple(Cell(_text(*pair)) for pair in zip(numbers, forms, strict=True))
            body.append((theirs.name, "", cells))
        head = ("PSNR", "SSIM", "RPE", "paper: PSNR", "paper: SSIM", "paper: RPE")
        tables.append(Table(f"Ablation on {suite.name} (paper: on SLF)", head, tuple(body)))
    return tables


def _best_rows(column: Column, values: Float[ndarray, " m"], fair: Bool[ndarray, " m"]) -> set[int]:
    """Rows that show the best number among the fair ones; ties as printed share the mark."""
    values = np.where(fair, values, math.nan)
    finite = [float(value) for value in values if math.isfinite(value)]
    if not column.best or len(finite) < 2:
        return set()
    best = min(finite) if column.best == "min" else max(finite)
    text = _text(best, column.form)
    return {index for index, value in enumerate(values) if _text(value, column.form) == text}


def _mark(value: float, rivals: Sequence[float]) -> Cell:
    """A number, marked where it is the least of several."""
    text = _text(value, ".2f")
    return Cell(text, len(rivals) > 1 and text != _DASH and text == _text(min(rivals), ".2f"))


def _text(value: float | None, form: str) -> str:
    return _DASH if value is None or not math.isfinite(value) else format(value, form)

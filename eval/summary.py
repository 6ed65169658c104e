"""From scores on disk to the numbers of the tables."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.stats import rankdata

from classical.fit import LARGEST_ERROR
from eval.folder import RunFolder
from eval.lines import MatchCounts
from eval.methods import EVERY, IDENTITY, METHODS, Method, method_of

_BINS, _LEAST_BIN, _LEAST_BINNED = 4, 8, 24  # ranges of the field of view, photographs
_ROUND = 5.0  # degrees


@dataclass(frozen=True)
class MethodScores:
    """All scores of one method on one suite, one entry a photograph in the suite's order."""

    method: Method
    records: tuple[dict[str, Any], ...]

    def values(self, *keys: str) -> Float[ndarray, " n"]:
        """A number of each photograph by its path of keys; NaN where there is none."""
        return np.array([_number(_at(record, keys)) for record in self.records])

    @cached_property
    def failed(self) -> Bool[ndarray, " n"]:
        """Where the method gave no camera; such photographs count as left alone."""
        return np.array([record["status"] == "failed" for record in self.records])

    @cached_property
    def expects(self) -> Bool[ndarray, " n"]:
        """Where the method gave a camera and the error that it expects of it."""
        return np.isfinite(self.values("predicted_error_px")) & ~self.failed

    def counts(self, protocol: str) -> MatchCounts | None:
        """Matches of line pixels summed over the suite; `None` where no lines are marked."""
        rows = [record[protocol] for record in self.records if "matched" in record[protocol]]
        if not rows:
            return None
        total = sum(row["true"] for row in rows)
        return MatchCounts(_sum(rows, "matched"), _sum(rows, "found"), total)


@dataclass(frozen=True)
class SuiteScores:
    """Everything the report says about one suite."""

    config: dict[str, Any]
    names: tuple[str, ...]
    methods: tuple[MethodScores, ...]

    @property
    def name(self) -> str:
        """Name of the suite."""
        return self.config["suite"]["name"]

    @property
    def is_real(self) -> bool:
        """True for real photographs."""
        return self.config["suite"]["is_real"]

    @cached_property
    def fov(self) -> Float[ndarray, " n"]:
        """Horizontal field of view of each photograph in degrees."""
        return np.array([self.config["suite"]["cases"][name]["fov"] for name in self.names])

    @cached_property
    def groups(self) -> tuple[str, ...]:
        """Camera or collection of each photograph."""
        return tuple(self.config["suite"]["cases"][name]["group"] for name in self.names)

    @property
    def left_alone(self) -> MethodScores | None:
        """The do-nothing row, if it was run."""
        return next((row for row in self.methods if row.method == IDENTITY), None)

    @property
    def primary(self) -> MethodScores:
        """The method by which cases are chosen for galleries: the last of the tables' order."""
        known = [row for row in self.methods if row.method in METHODS]
        return (known or list(self.methods))[-1]

    def part(self, group: str) -> "SuiteScores":
        """The photographs of one camera or collection."""
        chosen = [index for index, name in enumerate(self.groups) if name == group]
        rows = tuple(
            MethodScores(row.method, tuple(row.records[index] for index in chosen))
            for row in self.methods
        )
        return SuiteScores(self.config, tuple(self.names[index] for index in chosen), rows)


def load_scores(folder: RunFolder) -> SuiteScores:
    """Read the scores of all methods that are complete.

    Raises:
        ValueError: If a photograph has no scores yet, or no method is scored on all of them.
    """
    config = folder.read_config()
    names = tuple(config["suite"]["cases"])
    missing = [name for name in names if not folder.score(name).is_file()]
    if missing:
        raise ValueError(f"expected scores of {len(names)} pictures, {len(missing)} are missing")
    files = [json.loads(folder.score(name).read_text(encoding="utf-8")) for name in names]
    tags = [tag for tag in _ordered(config["methods"]) if all(tag in f["methods"] for f in files)]
    if not tags:
        raise ValueError(f"expected a method scored on all pictures of {folder.root}, got none")
    rows = tuple(
        MethodScores(method_of(tag), tuple(file["methods"][tag] for file in files)) for tag in tags
    )
    return SuiteScores(config, names, rows)


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        title: Heading, with its unit.
        form: Format of the number.
        value: Takes the scores of a method on a suite; NaN shows as a dash.
        best: "min", "max" or "" where there is no best.
    """

    title: str
    form: str
    value: Callable[[MethodScores, SuiteScores], float]
    best: str = "min"


def paper_columns(protocol: str) -> tuple[Column, ...]:
    """The paper's columns under protocol "paper" or "aligned", and two robust ones."""

    def mean(key: str) -> Callable[[MethodScores, SuiteScores], float]:
        return lambda row, _: float(np.mean(row.values(protocol, key)))

    def f_score(row: MethodScores, _: SuiteScores) -> float:
        counts = row.counts(protocol)
        return float("nan") if counts is None else counts.f_score

    error = "RPE" if protocol == "paper" else "Aligned error"
    return (
        Column("PSNR (dB)", ".2f", mean("psnr"), "max"),
        Column("SSIM", ".3f", mean("ssim"), "max"),
        Column("F", ".3f", f_score, "max"),
        Column(f"{error}, mean (px)", ".2f", mean("rpe")),
        Column("median (px)", ".2f", lambda row, _: median(row.values(protocol, "rpe"))),
        Column("90th pct. (px)", ".2f", lambda row, _: upper(row.values(protocol, "rpe"))),
    )


def straightness_columns() -> tuple[Column, ...]:
    """Protocol 3, and what goes with it."""
    return (
        Column(
            "Straightness, median (px)", ".2f", lambda row, _: median(row.values("straightness"))
        ),
        Column("90th pct. (px)", ".2f", lambda row, _: upper(row.values("straightness"))),
        Column("Ray angle, median (°)", ".2f", lambda row, _: median(row.values("angular_error"))),
        Column("Focal error, median (%)", ".1f", focal_error_of),
        Column("Worse than left alone", ".0%", _worse_share),
        Column("Failed", ".0f", lambda row, _: float(row.failed.sum()), ""),
        Column("Time, median (s)", ".2f", lambda row, _: median(row.values("seconds")), ""),
    )


def camera_columns() -> tuple[Column, ...]:
    """Protocol 4: real cameras."""
    return (
        Column("RPE, median (px)", ".2f", lambda row, _: median(row.values("paper", "rpe"))),
        Column("90th pct. (px)", ".2f", lambda row, _: upper(row.values("paper", "rpe"))),
        Column("Aligned, median (px)", ".2f", lambda row, _: median(row.values("aligned", "rpe"))),
        Column("90th pct. (px)", ".2f", lambda row, _: upper(row.values("aligned", "rpe"))),
        Column("Focal error, median (%)", ".1f", focal_error_of),
        Column("Worse than left alone", ".0%", _worse_share),
        Column("Failed", ".0f", lambda row, _: float(row.failed.sum()), ""),
    )


def trust_columns() -> tuple[Column, ...]:
    """How far what a method says of its own error comes true, by the aligned error it speaks of."""
    return (
        Column(
            "Rank correlation", ".2f", lambda row, _: rank_correlation(*_expected_and_true(row)), ""
        ),
        Column("True / expected, median", ".2f", _true_to_expected, ""),
        Column("Called ok", ".0f", lambda row, _: float(_is_ok(row).sum()), ""),
        Column(f"Of these under {LARGEST_ERROR:g} px", ".1%", _honest_share, ""),
    )


def rank_correlation(expected: Float[ndarray, " n"], true: Float[ndarray, " n"]) -> float:
    """Spearman's rank correlation; NaN for fewer than three values or where all are alike."""
    if len(true) < 3 or np.ptp(expected) == 0 or np.ptp(true) == 0:
        return float("nan")
    return float(np.corrcoef(rankdata(expected), rankdata(true))[0, 1])


def _expected_and_true(row: MethodScores) -> tuple[Float[ndarray, " n"], Float[ndarray, " n"]]:
    kept = row.expects
    return row.values("predicted_error_px")[kept], row.values("aligned", "rpe")[kept]


def _true_to_expected(row: MethodScores, _: SuiteScores) -> float:
    expected, true = _expected_and_true(row)
    return median(true / np.maximum(expected, 1e-9))


def _is_ok(row: MethodScores) -> Bool[ndarray, " n"]:
    return np.array([record["status"] == "ok" for record in row.records])


def _honest_share(row: MethodScores, _: SuiteScores) -> float:
    """Share under `LARGEST_ERROR` of what was called ok."""
    errors = row.values("aligned", "rpe")[_is_ok(row)]
    return float(np.mean(errors < LARGEST_ERROR)) if len(errors) else float("nan")


def fov_columns(fov: Float[ndarray, " n"]) -> tuple[Column, ...]:
    """Median errors by field of view; none where there is nothing to tell apart.

    Args:
        fov: Horizontal field of view of each photograph in degrees.
    """
    bins = fov_bins(fov)

    def of(title: str, key: str, inside: Bool[ndarray, " n"]) -> Column:
        return Column(title, ".2f", lambda row, _: median(row.values(key, "rpe")[inside]))

    return tuple(
        of(f"{error}, {words} ({inside.sum()})", key, inside)
        for key, error in (("paper", "RPE"), ("aligned", "Aligned"))
        for words, inside in bins
    )


def fov_bins(fov: Float[ndarray, " n"]) -> list[tuple[str, Bool[ndarray, " n"]]]:
    """About four ranges of the field of view with as many photographs each, in words and masks.

    Edges are quantiles rounded to 5 degrees; of a range with fewer than `_LEAST_BIN` photographs
    the edge to its smaller neighbour is dropped. None where one range would be left, or where there
    are fewer than `_LEAST_BINNED` photographs.
    """
    if len(fov) < _LEAST_BINNED:
        return []
    quantiles = np.nanquantile(fov, np.linspace(0, 1, _BINS + 1)[1:-1])
    edges = sorted({float(_ROUND * round(edge / _ROUND)) for edge in quantiles})
    while edges:
        counts = [int(inside.sum()) for inside in _between(fov, edges)]
        smallest = int(np.argmin(counts))
        if counts[smallest] >= _LEAST_BIN:
            break
        around = {at: counts[at] for at in (smallest - 1, smallest + 1) if 0 <= at < len(counts)}
        edges.pop(min(smallest, min(around, key=around.__getitem__)))
    if not edges:
        return []
    middle = [f"{low:.0f}–{high:.0f}°" for low, high in pairwise(edges)]
    words = [f"under {edges[0]:.0f}°", *middle, f"{edges[-1]:.0f}° up"]
    return list(zip(words, _between(fov, edges), strict=True))


def _between(fov: Float[ndarray, " n"], edges: Sequence[float]) -> list[Bool[ndarray, " n"]]:
    ends = [-np.inf, *edges, np.inf]
    return [(fov >= low) & (fov < high) for low, high in pairwise(ends)]


def focal_error_of(row: MethodScores, _: SuiteScores) -> float:
    """Median absolute focal error in per cent over the photographs with a camera."""
    if not row.method.knows_focal:
        return float("nan")
    return median(np.abs(row.values("focal_error")))


def _worse_share(row: MethodScores, suite: SuiteScores) -> float:
    """Share of photographs whose aligned error is above that of leaving them alone."""
    alone = suite.left_alone
    if alone is None or row.method == IDENTITY:
        return float("nan")
    margin = 1e-6  # failures are left alone themselves, up to rounding
    worse = row.values("aligned", "rpe") > alone.values("aligned", "rpe") + margin
    return float(np.mean(worse))


def median(values: Float[ndarray, " n"]) -> float:
    """Median of the finite values; NaN without any."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else float("nan")


def upper(values: Float[ndarray, " n"]) -> float:
    """90th percentile of the finite values; NaN without any."""
    finite = values[np.isfinite(values)]
    return float(np.percentile(finite, 90)) if len(finite) else float("nan")


def _ordered(tags: Sequence[str] | dict[str, Any]) -> list[str]:
    known = [method.tag for method in EVERY]
    return [tag for tag in known if tag in tags] + sorted(set(tags) - set(known))


def _at(record: dict[str, Any], keys: Sequence[str]) -> Any:
    value: Any = record
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    return value


def _number(value: Any) -> float:
    return float("nan") if value is None else float(value)


def _sum(rows: Sequence[dict[str, Any]], key: str) -> Int[ndarray, " t"]:
    return np.sum([row[key] for row in rows], axis=0)

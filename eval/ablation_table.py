"""The numbers of trained variants beside the paper's, and where their order differs."""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from eval.ablation import Budget, Variant
from eval.published import PublishedRow
from eval.summary import SuiteScores

_KEYS = ("psnr", "ssim", "rpe")


@dataclass(frozen=True)
class Row:
    """A variant on one suite.

    Attributes:
        name: As the paper calls it.
        theirs: The paper's numbers.
        scores: "psnr", "ssim", "rpe" (protocol 1) of each picture, by the seed of the training.
    """

    name: str
    theirs: PublishedRow
    scores: Mapping[int, Mapping[str, Float[ndarray, " n"]]]

    def means(self, key: str) -> Float[ndarray, " s"]:
        """Mean over pictures, one a seed."""
        return np.array([values[key].mean() for values in self.scores.values()])

    def medians(self, key: str) -> Float[ndarray, " s"]:
        """Median over pictures, one a seed."""
        return np.array([np.median(values[key]) for values in self.scores.values()])


@dataclass(frozen=True)
class Swap:
    """Two variants whose mean RPE is in another order than the paper's.

    Attributes:
        worse: The variant that the paper finds worse, and ours better.
        better: The other.
        gap: By how much the mean RPE of `better` is above that of `worse`, px.
        error: Standard error of `gap` over the pictures, px.
        spread: Standard deviation of `gap` over the seeds, px; NaN for one seed.
    """

    worse: Row
    better: Row
    gap: float
    error: float
    spread: float

    def __str__(self) -> str:
        told = f"{self.error:.2f} over the pictures"
        if np.isfinite(self.spread):
            told += f", {self.spread:.2f} over the seeds"
        ours = " and ".join(f"{row.means('rpe').mean():.2f}" for row in (self.worse, self.better))
        theirs = f"{self.worse.theirs.rpe:g} and {self.better.theirs.rpe:g}"
        return (
            f"{self.worse.name} and {self.better.name}: {ours} px, in the paper {theirs} px; "
            f"the gap of {self.gap:.2f} px has a standard error of {told}"
        )


def make_rows(variants: Sequence[Variant], suites: Mapping[int, SuiteScores]) -> list[Row]:
    """The variants that have scores.

    Args:
        variants: In the paper's order.
        suites: The scores of each seed.
    """
    rows = []
    for variant in variants:
        found = {
            seed: {key: row.values("paper", key) for key in _KEYS}
            for seed, suite in suites.items()
            for row in suite.methods
            if row.method.tag == variant.tag
        }
        if found:
            rows.append(Row(variant.name, variant.theirs, found))
    return rows


def swaps(rows: Sequence[Row]) -> list[Swap]:
    """All pairs whose mean RPE, over the seeds that both have, is not in the paper's order."""
    found = []
    for pair in combinations(rows, 2):
        better, worse = sorted(pair, key=lambda row: row.theirs.rpe or 0.0)
        seeds = [seed for seed in better.scores if seed in worse.scores]
        if not seeds:
            continue
        gaps = np.array([better.scores[s]["rpe"] - worse.scores[s]["rpe"] for s in seeds])
        if gaps.mean() <= 0:
            continue
        picture = gaps.mean(0)
        error = picture.std(ddof=1) / np.sqrt(len(picture)) if len(picture) > 1 else float("nan")
        spread = gaps.mean(1).std(ddof=1) if len(seeds) > 1 else float("nan")
        found.append(Swap(worse, better, float(gaps.mean()), float(error), float(spread)))
    return found


def to_markdown(title: str, suite: SuiteScores, rows: Sequence[Row]) -> str:
    """A table of one study on one suite, ours and the paper's apart, and the order of the RPE."""
    seeds = sorted({seed for row in rows for seed in row.scores})
    lines = [
        f"## {title} on {suite.name}",
        "",
        f"{len(suite.names)} pictures, seed {', '.join(map(str, seeds))}"
        + ("; ± is the standard deviation over the seeds." if len(seeds) > 1 else "."),
        "",
        "| | RPE, mean (px) | RPE, median (px) | PSNR (dB) | SSIM "
        "| paper: RPE | paper: PSNR | paper: SSIM |",
        "|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for row in rows:
        ours = (
            _spread(row.means("rpe"), ".2f"),
            _spread(row.medians("rpe"), ".2f"),
            _spread(row.means("psnr"), ".2f"),
            _spread(row.means("ssim"), ".3f"),
        )
        theirs = (f"{row.theirs.rpe:.2f}", f"{row.theirs.psnr:.2f}", f"{row.theirs.ssim:.2f}")
        lines.append(f"| {' | '.join((row.name, *ours, *theirs))} |")
    return "\n".join([*lines, "", *_order(rows), ""])


def _order(rows: Sequence[Row]) -> list[str]:
    pairs = len(rows) * (len(rows) - 1) // 2
    if not pairs:
        return []
    found = swaps(rows)
    if not found:
        return [f"Order by mean RPE: the paper's, in all {pairs} pairs."]
    head = f"Order by mean RPE: {len(found)} of {pairs} pairs differ from the paper's."
    return [head, "", *(f"- {swap}." for swap in found)]


def _spread(values: Float[ndarray, " s"], form: str) -> str:
    mean = format(values.mean(), form)
    return f"{mean} ± {format(values.std(ddof=1), form)}" if len(values) > 1 else mean


def budget_text(budget: Budget) -> str:
    """One paragraph on what all trainings have in common."""
    data = f"{budget.ahead} samples made ahead" if budget.ahead else "samples made on the fly"
    return (
        f"Preset {budget.network('BL6').name.removesuffix('-BL6')}, {budget.steps} steps of "
        f"{budget.batch} samples of {budget.size} px, {data} a training set; the same line "
        f"perception ({budget.init.partition(' ')[0]}) and a random calibration at the start. "
        "The paper's numbers are of its own network, training and test set."
    )


def to_csv(tables: Sequence[tuple[str, SuiteScores, Sequence[Row]]]) -> str:
    """All tables as one CSV, a row for each training on each suite."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    ours = ("rpe_mean", "rpe_median", "psnr", "ssim")
    theirs = ("paper_rpe", "paper_psnr", "paper_ssim")
    writer.writerow(["study", "suite", "pictures", "variant", "seed", *ours, *theirs])
    for study, suite, rows in tables:
        for row in rows:
            paper = (row.theirs.rpe, row.theirs.psnr, row.theirs.ssim)
            for seed, values in row.scores.items():
                rpe = values["rpe"]
                numbers = (rpe.mean(), np.median(rpe), values["psnr"].mean(), values["ssim"].mean())
                shown = [f"{number:.4f}" for number in numbers]
                place = (study, suite.name, len(suite.names), row.name, seed)
                writer.writerow([*place, *shown, *paper])
    return text.getvalue()

"""The commands `straightlens evaluate` and `straightlens report`."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from eval.cases import Suite
from eval.folder import RunFolder, claim_folder
from eval.methods import METHODS, parse_methods
from eval.open_suite import open_suite

_ALL = ",".join(method.tag for method in METHODS)


@click.command()
@click.option(
    "--suite",
    "suites",
    required=True,
    multiple=True,
    type=click.Path(exists=True, path_type=Path),
    help="Test set: a folder with suite.json. May be given several times.",
)
@click.option(
    "--out",
    required=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for answers and scores, one folder a suite in it.",
)
@click.option(
    "--methods", default=_ALL, show_default=True, help="Which methods, separated by commas."
)
@click.option("--workers", default=1, show_default=True, type=click.IntRange(1), help="Processes.")
@click.option("--seed", default=0, show_default=True, help="Of random choices within methods.")
@click.option(
    "--min-bend",
    default=0.0,
    show_default=True,
    help="Leave out pictures whose do-nothing error is under so many px of a 320 px frame.",
)
@click.option(
    "--every", default=1, show_default=True, type=click.IntRange(1), help="Each n-th picture only."
)
@click.option("--restart", is_flag=True, help="Throw away what earlier runs left in --out.")
def evaluate(
    suites: tuple[Path, ...],
    out: Path,
    methods: str,
    workers: int,
    seed: int,
    min_bend: float,
    every: int,
    restart: bool,
) -> None:
    """Run methods over test sets with known lenses, and score what they say.

    Answers go to disk one by one; a run that is stopped goes on where it was. A folder keeps to one
    configuration: other settings need another folder, or --restart.
    """
    try:
        chosen = parse_methods(methods)
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    settings: dict[str, Any] = {"seed": seed}
    for path in suites:
        suite = open_suite(path, min_bend=min_bend, every=every)
        folder = RunFolder(out / suite.name)
        if restart and folder.config.is_file():
            shutil.rmtree(folder.root)
        claim_folder(folder, suite, dict.fromkeys(chosen, settings))
        _run(suite, folder, dict.fromkeys(chosen, settings), workers)


def _run(suite: Suite, folder: RunFolder, methods: dict[Any, dict[str, Any]], workers: int) -> None:
    """Both loops and the pictures for the report, with progress on stderr."""
    from eval.gallery import write_gallery
    from eval.predict import predict_suite
    from eval.score import score_suite

    answers = predict_suite(suite, methods, folder, workers=workers)
    _progress(f"{suite.name}: estimate", answers)
    every_method = [method for method in METHODS if method.tag in folder.read_config()["methods"]]
    scores = score_suite(suite.cases, suite.theta_max, every_method, folder, workers=workers)
    _progress(f"{suite.name}: score", scores)
    write_gallery(suite, folder)


def _progress(title: str, steps: Iterator[tuple[int, int]]) -> None:
    """Show (done, total) pairs as they come."""
    with tqdm(desc=title, unit="picture") as bar:
        for done, total in steps:
            bar.total = total
            bar.update(done - bar.n)


@click.command()
@click.argument(
    "runs", nargs=-1, required=True, type=click.Path(exists=True, file_okay=False, path_type=Path)
)
@click.option(
    "--out",
    required=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for report.html, report.md, summary.csv and scores.csv.",
)
@click.option(
    "--without-pictures",
    multiple=True,
    metavar="SUITE",
    help="Show no photographs of this suite (their terms may forbid it).",
)
def report(runs: tuple[Path, ...], out: Path, without_pictures: tuple[str, ...]) -> None:
    """Write the comparison as one HTML page, Markdown and CSV, from scores alone.

    RUNS are folders that `evaluate` wrote: the folder of one suite, or one that holds several.
    """
    try:
        from eval.report import write_report
    except ImportError as error:
        message = (
            f"a report needs jinja2 and matplotlib (pip install 'straightlens[report]'): {error}"
        )
        raise click.ClickException(message) from error

    folders = [folder for run in runs for folder in _suites_in(run)]
    write_report(folders, out, without_pictures=without_pictures)
    click.echo(str(out / "report.html"))


def _suites_in(path: Path) -> list[RunFolder]:
    """The evaluated suites of a folder, by name."""
    if RunFolder(path).config.is_file():
        return [RunFolder(path)]
    found = [RunFolder(part) for part in sorted(path.iterdir()) if RunFolder(part).config.is_file()]
    if not found:
        raise ValueError(f"expected a folder written by 'evaluate', got {path}")
    return found

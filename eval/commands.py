"""The commands `straightlens evaluate` and `straightlens report`."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from eval.cases import Suite
from eval.folder import RunFolder, claim_folder, origin
from eval.methods import EVERY, FIXED, METHODS, TOGETHER, WIREFRAME, Method, parse_methods
from eval.open_suite import open_suite
from eval.options import every_option, suites_option, workers_option

_ALL = ",".join(method.tag for method in METHODS)


@click.command()
@suites_option
@click.option(
    "--out",
    required=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for answers and scores, one folder a suite in it.",
)
@click.option(
    "--methods",
    default=_ALL,
    show_default=True,
    help="Which methods, separated by commas; also "
    + " and ".join(method.tag for method in TOGETHER)
    + ", which take all pictures of a camera at once, and "
    + " and ".join(method.tag for method in WIREFRAME)
    + ", with weights of D-Wireframe alone, and "
    + FIXED.tag
    + ", a yardstick: the one lens that is best for all pictures, chosen by the true ones.",
)
@workers_option
@click.option(
    "--ray",
    "cluster",
    metavar="ADDRESS",
    help="Work on a Ray cluster instead (auto, local or host:port) with a common file system.",
)
@click.option("--seed", default=0, show_default=True, help="Of random choices within methods.")
@click.option(
    "--min-bend",
    default=0.0,
    show_default=True,
    help="Leave out pictures whose do-nothing error is under so many px of a 320 px frame.",
)
@every_option
@click.option("--restart", is_flag=True, help="Throw away what earlier runs left in --out.")
def evaluate(
    suites: tuple[Path, ...],
    out: Path,
    methods: str,
    workers: int,
    cluster: str | None,
    seed: int,
    min_bend: float,
    every: int,
    restart: bool,
) -> None:
    """Run methods over test sets with known lenses, and score what they say.

    Answers go to disk one by one; a run that is stopped goes on where it was. A folder keeps to one
    configuration: other settings need another folder, or --restart.
    """
    from eval.predict import settings_of

    try:
        chosen = parse_methods(methods)
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    for path in suites:
        suite = open_suite(path.resolve(), min_bend=min_bend, every=every)
        settings = {method: settings_of(method, suite, seed=seed) for method in chosen}
        folder = RunFolder(out.resolve() / suite.name)
        if restart and folder.config.is_file():
            shutil.rmtree(folder.root)
        claim_folder(folder, suite, settings)
        _say_if_older(folder)
        _run(suite, folder, settings, {"workers": workers, "cluster": cluster})


def _say_if_older(folder: RunFolder) -> None:
    """Answers of older code are kept, so that a run can go on; the user should know."""
    origins = folder.read_config()["origins"]
    now = origin()["commit"]
    older = {tag: of["commit"] for tag, of in origins.items() if of["commit"] != now}
    if older:
        listed = ", ".join(f"{tag} of {commit or 'unknown'}" for tag, commit in older.items())
        click.echo(f"note: {folder.root} keeps answers of other commits ({listed})", err=True)


def _run(
    suite: Suite,
    folder: RunFolder,
    methods: dict[Method, dict[str, Any]],
    spread: dict[str, Any],
) -> None:
    """Both loops and the pictures for the report, with progress on stderr."""
    from eval.gallery import network_maps, write_gallery
    from eval.predict import pending, predict_suite
    from eval.score import score_suite

    answers = predict_suite(suite, methods, folder, **spread)
    show_progress(f"{suite.name}: estimate", answers)
    complete = [method for method in EVERY if not pending(suite, {method: {}}, folder)]
    scores = score_suite(suite.cases, suite.theta_max, complete, folder, **spread)
    show_progress(f"{suite.name}: score", scores)
    uses_network = any(method.estimator in ("learned", "hybrid") for method in complete)
    write_gallery(suite, folder, maps=network_maps() if uses_network else ())


def show_progress(title: str, steps: Iterator[tuple[int, int]]) -> None:
    """Show (done, total) pairs as they come, on stderr."""
    with tqdm(desc=title, unit="picture", disable=None) as bar:
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

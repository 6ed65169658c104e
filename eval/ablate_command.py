"""The command `straightlens ablate`. Torch is imported when the study starts, not before."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from classical.files import atomic_path
from eval.options import every_option, suites_option, workers_option

if TYPE_CHECKING:
    from eval.ablation import Variant
    from eval.cases import Suite

_TITLES = {"parts": "Parts of the network and of its loss", "data": "Training sets"}


@click.command()
@click.option(
    "--data",
    "pack",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Training pictures, a pack made by `straightlens synthesize`. Without it nothing is "
    "trained, and the weights in --out are tested.",
)
@suites_option
@click.option(
    "--out",
    required=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder of the study: weights and log of each training, scores, table.md, table.csv.",
)
@click.option(
    "--study",
    "studies",
    multiple=True,
    default=["parts"],
    show_default=True,
    type=click.Choice(["parts", "data"]),
    help="BL1 to BL6 (parts), or the whole network on three training sets (data); may be given "
    "twice. Chooses what is trained and tested.",
)
@click.option("--variants", help="Train these only, separated by commas: BL1,…,BL6,SLF,SLF_sun.")
@click.option(
    "--init",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Weights whose line perception all start from; default: those that ship.",
)
@click.option(
    "--preset", default="compact", show_default=True, type=click.Choice(["compact", "paper"])
)
@click.option("--steps", default=1500, show_default=True, type=click.IntRange(1), help="Of each.")
@click.option(
    "--batch", default=16, show_default=True, type=click.IntRange(1), help="Samples a step."
)
@click.option("--size", default=128, show_default=True, help="Side of the frame in pixels.")
@click.option(
    "--ahead",
    default=8000,
    show_default=True,
    type=click.IntRange(0),
    help="Samples made first and shared by all variants; 0 draws each anew, right for a GPU.",
)
@click.option("--rate", type=float, help="Learning rate, instead of the preset's.")
@click.option(
    "--fall",
    default=0.5,
    show_default=True,
    type=click.FloatRange(0, 1),
    help="Share of the steps with a falling rate.",
)
@click.option(
    "--seed",
    "--seeds",
    "seeds",
    default="1",
    show_default=True,
    help="Of first weights and samples; several, separated by commas, tell the spread.",
)
@every_option
@click.option("--threads", type=click.IntRange(1), help="Of the training; default: all.")
@workers_option
@click.option("--cpu", is_flag=True, help="Stay on the CPU.")
def ablate(
    pack: Path | None,
    suites: tuple[Path, ...],
    out: Path,
    studies: tuple[str, ...],
    variants: str | None,
    init: Path | None,
    preset: str,
    steps: int,
    batch: int,
    size: int,
    ahead: int,
    rate: float | None,
    fall: float,
    seeds: str,
    every: int,
    threads: int | None,
    workers: int,
    cpu: bool,
) -> None:
    """Train the variants of the paper's ablation study and compare them with its table.

    All have one budget and seed and share their samples. What is trained is not trained again, and
    what was stopped goes on; a folder keeps to one budget. The table shows all scores in --out.
    """
    import torch

    from eval.ablation import STUDIES, Budget, claim_study, train_variant, trained
    from eval.open_suite import open_suite

    known = list({v.trained: v for study in studies for v in STUDIES[study]}.values())
    chosen = _variants(known, variants)
    numbers = _numbers(seeds)
    opened = [open_suite(path.resolve(), every=every) for path in suites]
    if threads is not None:
        torch.set_num_threads(threads)
    if pack is not None:
        from learned.weights import packaged

        claim_study(
            out,
            Budget(preset, steps, batch, size, ahead, rate, fall),
            packaged("compact") if init is None else init,
        )
        for seed in numbers:
            for variant in chosen:
                train_variant(variant, seed, pack, out, cpu=cpu)
    for seed, there in trained(out, known).items():
        for suite in opened:
            _test(suite, out, seed, there, workers)
    click.echo(_write(out))


def _variants(known: list[Variant], names: str | None) -> list[Variant]:
    """The variants of some names, by default all."""
    if names is None:
        return known
    by_name = {variant.trained: variant for variant in known}
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    unknown = [name for name in wanted if name not in by_name]
    if unknown or not wanted:
        raise click.UsageError(f"expected variants among {', '.join(by_name)}, got {names!r}")
    return [by_name[name] for name in dict.fromkeys(wanted)]


def _numbers(seeds: str) -> list[int]:
    try:
        return sorted({int(seed) for seed in seeds.split(",")})
    except ValueError as error:
        raise click.UsageError(f"expected seeds such as 1,2,3, got {seeds!r}") from error


def _test(suite: Suite, out: Path, seed: int, variants: list[Variant], workers: int) -> None:
    """Answers and scores of trained variants, by the loops of `evaluate`."""
    from eval.ablation import VariantFactory, claim_scores, settings_of_variants
    from eval.commands import show_progress
    from eval.predict import predict_suite
    from eval.score import score_suite

    folder = claim_scores(suite, variants, seed, out)
    methods = settings_of_variants(variants, seed, out)
    factory = VariantFactory(out, seed)
    answers = predict_suite(suite, methods, folder, workers=workers, factory=factory)
    show_progress(f"{suite.name}, seed {seed}: estimate", answers)
    scores = score_suite(suite.cases, suite.theta_max, list(methods), folder, workers=workers)
    show_progress(f"{suite.name}, seed {seed}: score", scores)


def _write(out: Path) -> Path:
    """Write table.md and table.csv from all scores of the folder."""
    from eval.ablation import STUDIES, read_budget, scored_suites
    from eval.ablation_table import budget_text, make_rows, to_csv, to_markdown

    tables = [
        (study, next(iter(seeds.values())), rows)
        for study, variants in STUDIES.items()
        for seeds in scored_suites(out).values()
        if len(rows := make_rows(variants, seeds)) > 1
    ]
    parts = [to_markdown(_TITLES[study], suite, rows) for study, suite, rows in tables]
    text = "\n".join(["# Ablation", "", budget_text(read_budget(out)), "", *parts])
    for name, content in (("table.md", text), ("table.csv", to_csv(tables))):
        with atomic_path(out / name) as temporary:
            temporary.write_text(content, encoding="utf-8")
    return out / "table.md"

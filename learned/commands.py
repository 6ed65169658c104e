"""The commands `straightlens train` and `assess`. Torch is imported when one starts, not before."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource
from tqdm import tqdm

if TYPE_CHECKING:
    from learned.slf.batch import SlfBatch
    from learned.slf.stream import StreamCfg

_PACK = click.Path(exists=True, dir_okay=False, path_type=Path)
_SCENES = (0.45, 0.35, 0.2, 0.0)
_SHARES = {
    "wild": (0.8, "Share of the prior `wild` in boxes and panoramas."),
    "fisheye": (0.0, "Share of these that have lenses of some 180°, the prior `fisheye`."),
    "straight": (0.0, "Share of pictures taken by lenses that bend next to nothing."),
    "board": (0.0, "Share of boxes and panoramas with a flat board held before the lens."),
    "grey": (0.0, "Share of pictures without colour."),
}
"""Of the training pictures: default and meaning of each `StreamCfg.…_share`."""


def mixture_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """What the pictures of a training are."""
    for name, (default, told) in reversed(_SHARES.items()):
        share = click.FloatRange(0, 1)
        command = click.option(
            f"--{name}", default=default, show_default=True, type=share, help=told
        )(command)
    return click.option(
        "--scenes",
        default=_SCENES,
        show_default=True,
        nargs=4,
        type=click.FloatRange(0, 1),
        help="Shares of photographs as planes (D-Wireframe), boxes of photographs, panoramas, "
        "rendered rooms.",
    )(command)


def _stream(mixture: dict[str, Any]) -> StreamCfg:
    """What `mixture_options` say, as the stream wants it."""
    from learned.slf.stream import StreamCfg

    shares = {f"{name}_share": mixture[name] for name in _SHARES}
    return StreamCfg(scenes=mixture["scenes"], **shares)


@click.command()
@click.argument("target", type=click.Choice(["dlp", "larecnet", "rong"]))
@click.option("--preset", "preset_name", default="compact", type=click.Choice(["paper", "compact"]))
@click.option(
    "--ablation",
    type=click.Choice(["BL1", "BL2", "BL3", "BL4", "BL5", "BL6"]),
    help="A variant of the paper's ablation study (larecnet).",
)
@click.option(
    "--data",
    "pack",
    required=True,
    type=_PACK,
    help="Training pictures, a pack made by `straightlens synthesize`.",
)
@click.option(
    "--validation",
    type=_PACK,
    help="Another pack, for the reports during training.",
)
@click.option("--out", "folder", required=True, type=click.Path(path_type=Path), help="Run folder.")
@click.option("--steps", required=True, type=click.IntRange(1), help="Length of the whole run.")
@click.option(
    "--batch", default=8, show_default=True, type=click.IntRange(1), help="Samples a step."
)
@click.option("--size", default=320, show_default=True, help="Side of the frame in pixels.")
@click.option("--seed", default=1, show_default=True, help="Of the data and the first weights.")
@click.option(
    "--ahead",
    default=0,
    show_default=True,
    type=click.IntRange(0),
    help="Make so many samples first and go over them in epochs; right for a CPU.",
)
@click.option(
    "--samples",
    type=click.Path(file_okay=False, path_type=Path),
    help="Where these samples are kept; default: OUT/samples. Runs may share them.",
)
@click.option(
    "--upright",
    default=0.0,
    show_default=True,
    type=click.FloatRange(0, 1),
    help="Share of batches of samples made ahead that are transposed: higher than wide.",
)
@mixture_options
@click.option("--rate", type=float, help="Learning rate, instead of the preset's.")
@click.option("--fall", type=click.FloatRange(0, 1), help="Share of the run with a falling rate.")
@click.option("--resume/--no-resume", default=True, show_default=True)
@click.option("--init", type=click.Path(exists=True, path_type=Path), help="Weights to start from.")
@click.option("--workers", default=1, show_default=True, help="Processes that make data; GPU: 0.")
@click.option("--threads", type=click.IntRange(1), help="Of the training process; default: all.")
@click.option("--checkpoint-minutes", default=3.0, show_default=True)
@click.option("--report-every", default=1000, show_default=True, help="Steps between reports.")
@click.option("--cpu", is_flag=True, help="Stay on the CPU.")
def train(
    target: str,
    preset_name: str,
    ablation: str | None,
    pack: Path,
    validation: Path | None,
    folder: Path,
    steps: int,
    batch: int,
    size: int,
    seed: int,
    ahead: int,
    samples: Path | None,
    upright: float,
    rate: float | None,
    fall: float | None,
    resume: bool,
    init: Path | None,
    workers: int,
    threads: int | None,
    checkpoint_minutes: float,
    report_every: int,
    cpu: bool,
    **mixture: Any,
) -> None:
    """Train line perception (dlp), then LaRecNet on top of it, or the baseline of Rong et al.

    Writes checkpoints, TensorBoard events, report pictures and, at the end, weights.safetensors
    with a model card into the run folder. Stopped runs go on where they were; with fewer --steps
    the learning rate starts to fall at once, which ends a run early and well.
    """
    import torch

    from learned.jobs import JobCfg, run_job
    from learned.presets import ablation as ablated
    from learned.presets import preset
    from learned.train import RunCfg

    if upright and not ahead:
        raise click.UsageError("--upright is for samples made ahead; give --ahead, too")
    if threads is not None:
        torch.set_num_threads(threads)
    chosen = preset(preset_name).with_schedule(rate=rate, fall=fall)
    job = JobCfg(
        target=target,  # type: ignore[arg-type]
        preset=ablated(chosen, ablation) if ablation else chosen,
        pack=pack,
        validation=validation,
        folder=folder,
        steps=steps,
        seed=seed,
        batch_size=batch,
        size=size,
        ahead=ahead,
        samples=samples,
        upright=upright,
        data=_stream(mixture),
        init=init,
        run=RunCfg(
            steps=steps,
            workers=workers,
            checkpoint_minutes=checkpoint_minutes,
            report_every=report_every,
        ),
    )
    click.echo(run_job(job, resume=resume, cpu=cpu))


@click.command()
@click.argument("weights", metavar="WEIGHTS")
@click.option(
    "--validation",
    required=True,
    type=_PACK,
    help="Pictures that were not trained on, a pack made by `straightlens synthesize`.",
)
@click.option(
    "--data",
    "pack",
    type=_PACK,
    help="The pack of the training: fit the temperature of the predicted spread on it first.",
)
@mixture_options
@click.option(
    "--samples", default=96, show_default=True, help="Of each validation, a multiple of 8."
)
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the weights here with a card that has the new scores; ….safetensors.",
)
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
@click.pass_context
def assess(
    context: click.Context,
    weights: str,
    validation: Path,
    pack: Path | None,
    samples: int,
    out: Path | None,
    overwrite: bool,
    **mixture: Any,
) -> None:
    """Score a LaRecNet as its model card does: a file, or the name of weights that ship.

    The samples are the same for all weights: planes with lenses of the prior `paper`, clean, and
    the default mixture of `train` with camera effects. --scenes and the other shares say what the
    training was made of and matter to --data alone.
    """
    _check_output(weights, out, overwrite)
    given = {context.get_parameter_source(name) for name in mixture}
    if pack is None and ParameterSource.COMMANDLINE in given:
        raise click.UsageError(
            f"{', '.join(f'--{name}' for name in mixture)} need --data, the pack of the training"
        )
    from learned import assess as assessment
    from learned.larecnet import LaRecNet
    from learned.weights import load_weights, located

    if samples < 1 or samples % assessment.BATCH:
        raise click.UsageError(f"expected --samples of {assessment.BATCH} each, got {samples}")
    loaded = load_weights(located(weights, "compact"), LaRecNet)
    network = loaded.network
    if pack is not None and not network.cfg.calibration.covariance:
        raise click.UsageError(f"--data is for weights that predict a spread; {weights} do not")
    if pack is not None:
        batches = assessment.temperature_batches(pack, network.cfg.frame, _stream(mixture))
        total = assessment.TEMPERATURE_BATCHES
        assessment.fit_temperature(network, _shown("temperature", batches, total))
        click.echo(f"temperature {float(network.calibration.temperature):.4f}")
    count = samples // assessment.BATCH
    scores = {}
    for name, pictures in assessment.VALIDATIONS.items():
        batches = assessment.validation_batches(
            validation, count, assessment.VALIDATION_SIZE, pictures
        )
        found = assessment.assess(network, _shown(name, batches, count)).summary()
        scores[name] = {key: round(value, 4) for key, value in found.items()}
    click.echo(assessment.scores_text(scores))
    if out is not None:
        assessment.write_scored(out, network, loaded.card, scores)
        click.echo(out)


def _check_output(weights: str, out: Path | None, overwrite: bool) -> None:
    """Misuse if the new weights cannot or must not be where they shall be."""
    if out is None:
        return
    if out.suffix != ".safetensors":
        raise click.UsageError(f"expected --out to end in .safetensors, got {out.name}")
    if out.resolve() == Path(weights).resolve():
        raise click.UsageError(f"{out} is an input; choose another --out")
    if out.exists() and not overwrite:
        raise click.UsageError(f"{out} exists; use --overwrite to replace")


def _shown(title: str, batches: Iterable[SlfBatch], total: int) -> Iterator[SlfBatch]:
    """The batches, with progress on stderr."""
    yield from tqdm(batches, desc=title.partition(",")[0], total=total, unit="batch", disable=None)

"""The command `straightlens train`. Torch is imported when a training starts, not before."""

from __future__ import annotations

from pathlib import Path

import click


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
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Training pictures, a pack made by `straightlens synthesize`.",
)
@click.option(
    "--validation",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
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
    "--scenes",
    default=(0.45, 0.35, 0.2, 0.0),
    show_default=True,
    nargs=4,
    type=click.FloatRange(0, 1),
    help="Shares of photographs as planes (D-Wireframe), boxes of photographs, panoramas, rendered "
    "rooms.",
)
@click.option(
    "--wild",
    default=0.8,
    show_default=True,
    type=click.FloatRange(0, 1),
    help="Share of the prior `wild` in boxes and panoramas.",
)
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
    scenes: tuple[float, float, float, float],
    wild: float,
    rate: float | None,
    fall: float | None,
    resume: bool,
    init: Path | None,
    workers: int,
    threads: int | None,
    checkpoint_minutes: float,
    report_every: int,
    cpu: bool,
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
    from learned.slf.stream import StreamCfg
    from learned.train import RunCfg

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
        data=StreamCfg(scenes=scenes, wild_share=wild),
        init=init,
        run=RunCfg(
            steps=steps,
            workers=workers,
            checkpoint_minutes=checkpoint_minutes,
            report_every=report_every,
        ),
    )
    click.echo(run_job(job, resume=resume, cpu=cpu))

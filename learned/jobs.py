"""Trainings from start to weights: which network, which data, which phase."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from accelerate import PartialState
from torch import nn

from learned.assess import BATCH, fit_temperature, validation_batches, write_scored
from learned.dlp import LinePerception
from learned.larecnet import LaRecNet
from learned.phases import DivisionPhase, PerceptionPhase, RectificationPhase
from learned.pool import processor_count
from learned.presets import SIZE, Preset
from learned.rong import RongNet
from learned.samples import Epochs, SamplesCfg, make_samples
from learned.schedule import OptimCfg
from learned.slf.atlas import load_atlas
from learned.slf.batch import SlfBatch
from learned.slf.priors import lens_prior
from learned.slf.stream import SlfStream, StreamCfg
from learned.train import Phase, RunCfg, averaged, train
from learned.weights import load_perception, load_weights

Target = Literal["dlp", "larecnet", "rong"]
WEIGHTS = "weights.safetensors"
_PRIOR_SAMPLES = 8000
_OTHER_SEED = 1_000_003
_TEMPERATURE_BATCHES = 32


@dataclass(frozen=True)
class JobCfg:
    """A training.

    Attributes:
        target: What is trained.
        preset: Its sizes, losses and optimisers.
        pack: Training pictures, made by `straightlens synthesize`.
        validation: Pictures of the reports, or None for no reports.
        folder: Run folder.
        steps: Optimiser steps.
        seed: Seed of weights and data.
        batch_size: Samples a step.
        size: Side of the square frame in pixels.
        ahead: Samples made before the training and used in every epoch; 0 makes each sample when
            it is needed, and uses it once.
        samples: Where they are kept, by default in the run folder; runs may share them.
        upright: Share of their batches that are transposed; see `Epochs`.
        data: Mixture of scenes and lenses.
        init: Weights to start from: of the same network, or of line perception for LaRecNet.
        validation_batches: Batches of eight in a report.
        run: Intervals, workers, precision; its `steps` and `optim` are overruled.
    """

    target: Target
    preset: Preset
    pack: Path
    validation: Path | None
    folder: Path
    steps: int
    seed: int = 1
    batch_size: int = 8
    size: int = SIZE
    ahead: int = 0
    samples: Path | None = None
    upright: float = 0.0
    data: StreamCfg = field(default_factory=StreamCfg)
    init: Path | None = None
    validation_batches: int = 4
    run: RunCfg = field(default_factory=lambda: RunCfg(steps=1))


def run_job(job: JobCfg, *, resume: bool, cpu: bool = False, progress: bool = True) -> Path:
    """Train and write the averaged weights with their card.

    Args:
        job: What to train.
        resume: Go on from the folder's checkpoint.
        cpu: Stay on the CPU.
        progress: Draw a progress bar.

    Returns:
        Path of the weights.
    """
    torch.manual_seed(job.seed)
    here = PartialState(cpu=cpu)
    device = str(here.device)
    stream_cfg = replace(job.data, with_rectified=_needs_rectified(job))
    atlas = load_atlas(job.pack).to(device)
    stream = SlfStream(atlas, job.seed, job.batch_size, job.size, stream_cfg)
    validation = _validation(job, stream_cfg, device)
    network, phase, optim = _network(job)
    other = replace(stream, seed=job.seed + _OTHER_SEED, batch_size=BATCH)
    average = train(
        network,
        phase,
        _made_ahead(job) if job.ahead else stream.batch,
        validation,
        replace(job.run, steps=job.steps, optim=optim),
        folder=job.folder,
        resume=resume,
        cpu=cpu,
        progress=progress,
    )
    path = job.folder / WEIGHTS
    if not here.is_main_process:
        return path
    best = averaged(network, average)
    assert isinstance(best, (LaRecNet, LinePerception, RongNet))
    if isinstance(best, LaRecNet) and best.cfg.calibration.covariance:
        fit_temperature(best, (other.batch(i) for i in range(_TEMPERATURE_BATCHES)))
    scores = phase.report(best, validation)[0] if validation else {}
    write_scored(path, best, training_card(job), scores)
    return path


def _made_ahead(job: JobCfg) -> Epochs:
    """Batches of samples that are made, or found, before the training starts."""
    cfg = SamplesCfg(
        count=job.ahead,
        size=job.size,
        seed=job.seed,
        pack=job.pack,
        perception=job.init if job.target == "larecnet" else None,
        data=job.data,
    )
    folder = job.samples or job.folder / "samples"
    samples = make_samples(
        folder, cfg, stride=job.preset.network.pixel_stride, workers=processor_count()
    )
    return Epochs(samples, job.seed, job.batch_size, job.upright)


def _network(job: JobCfg) -> tuple[nn.Module, Phase, OptimCfg]:
    """The network to train, initialised, with its phase and optimiser."""
    preset = job.preset
    if job.target == "dlp":
        perception = LinePerception(preset.network.dlp)
        if job.init is not None:
            perception.load_state_dict(load_perception(job.init).state_dict())
        return perception, PerceptionPhase(preset.network.dlp), preset.optim_dlp
    if job.target == "rong":
        rong = RongNet(replace(preset.rong, frame=job.size))
        if job.init is not None:
            rong.load_state_dict(load_weights(job.init, RongNet).network.state_dict())
        return rong, DivisionPhase(), preset.optim
    network = LaRecNet(replace(preset.network, frame=job.size))
    if preset.whiten:
        network.parameters_of_lens.whiten(prior_samples())
    if job.init is not None:
        _initialise(network, job.init)
    if preset.loss.pix == 0:
        network.uncertainty.requires_grad_(False)  # takes no part
    return network, RectificationPhase(preset), preset.optim


def _initialise(network: LaRecNet, path: Path) -> None:
    """Start LaRecNet from its own weights or from those of line perception."""
    try:
        network.load_state_dict(load_weights(path, LaRecNet).network.state_dict())
    except ValueError:
        network.dlp.load_state_dict(load_weights(path, LinePerception).network.state_dict())


def prior_samples() -> torch.Tensor:
    """Lenses of both priors, half each, the same every time; shape (8000, 9)."""
    rng = np.random.default_rng(0)
    drawn = [lens_prior(n).sample(rng, _PRIOR_SAMPLES // 2).vector for n in ("paper", "wild")]
    return torch.from_numpy(np.concatenate(drawn)).float()


def _needs_rectified(job: JobCfg) -> bool:
    return job.target == "larecnet"


def _validation(job: JobCfg, data: StreamCfg, device: str) -> Sequence[SlfBatch]:
    if job.validation is None:
        return []
    count = job.validation_batches
    return list(validation_batches(job.validation, count, job.size, data, device=device))


def training_card(job: JobCfg) -> dict[str, Any]:
    """What is known of a training before its weights are scored."""
    return {
        "target": job.target,
        "preset": job.preset.name,
        "data": f"synthesised from {job.pack.name}",
        "scenes": str(job.data.scenes),
        "wild share": job.data.wild_share,
        "fisheye share": job.data.fisheye_share,
        "straight share": job.data.straight_share,
        "board share": job.data.board_share,
        "grey share": job.data.grey_share,
        "upright share": job.upright,
        "seed": job.seed,
        "steps": job.steps,
        "batch": job.batch_size,
        "samples made ahead": job.ahead,
        "size": job.size,
        "init": str(job.init.name) if job.init else "none",
        "commit": _commit(),
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
    }


def _commit() -> str:
    """The checkout's commit, or "unknown" outside of one."""
    try:
        done = subprocess.run(
            ["git", "rev-parse", "--short", "HEAD"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return done.stdout.strip()

"""How fast the networks train on this machine: pictures a second, their making not counted."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import nn

from benchmarks.timing import median_seconds
from learned.dlp import LinePerception
from learned.larecnet import LaRecNet
from learned.phases import PerceptionPhase, RectificationPhase
from learned.presets import COMPACT, PAPER, SIZE
from learned.schedule import OptimCfg, build_optimizer
from learned.slf.batch import SlfBatch
from learned.train import Phase

BATCH = 8
SHIPPED = 192  # side of the frame in which the weights that ship were trained


def measure_training(rounds: int) -> dict[str, float]:
    """Pictures a second by preset, phase and frame; random pictures, bf16, two threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        return {
            f"{preset.name}: {phase}, {size}x{size}": BATCH
            / median_seconds(step, rounds if preset is COMPACT else min(rounds, 2))
            for preset, size in ((COMPACT, SIZE), (COMPACT, SHIPPED), (PAPER, SIZE))
            for phase, step in {
                "phase one": _step(
                    LinePerception(preset.network.dlp),
                    PerceptionPhase(preset.network.dlp),
                    preset.optim_dlp,
                    _samples(size),
                ),
                "phase two": _step(
                    LaRecNet(preset.network),
                    RectificationPhase(preset),
                    preset.optim,
                    _samples(size),
                ),
            }.items()
        }
    finally:
        torch.set_num_threads(before)


def _step(
    module: nn.Module, phase: Phase, optim: OptimCfg, samples: SlfBatch
) -> Callable[[], None]:
    module = module.to(memory_format=torch.channels_last).train()  # type: ignore[call-overload]
    optimizer = build_optimizer(module, optim)

    def job() -> None:
        with torch.autocast("cpu", torch.bfloat16):
            loss, _ = phase.loss(module, samples)
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()

    return job


def _samples(size: int) -> SlfBatch:
    k = torch.tensor([1.3, -0.05, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0]).repeat(BATCH, 1)
    pictures = torch.rand(BATCH, 3, size, size)
    lines = (torch.rand(BATCH, 1, size, size) < 0.05).float()
    seen = torch.rand(BATCH, 2, size, size)  # phase two on samples made ahead
    return SlfBatch(pictures, lines, k, pictures, torch.full((BATCH,), 0.8), seen)

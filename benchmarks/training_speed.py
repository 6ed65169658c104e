"""How fast the networks train on this machine.

    python -m benchmarks.training_speed [--threads 2] [--batch 8] [--paper]

Random pictures of 320x320; times are medians over rounds, training without the making of data.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import torch
from torch import nn

from benchmarks.timing import median_seconds
from learned.dlp import LinePerception
from learned.larecnet import LaRecNet
from learned.phases import PerceptionPhase, RectificationPhase
from learned.presets import COMPACT, PAPER, SIZE, Preset
from learned.schedule import build_optimizer
from learned.slf.batch import SlfBatch
from learned.train import Phase

ROUNDS = 7


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description="Speed of the networks.")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--paper", action="store_true", help="the paper's preset too (slow)")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    for preset in [COMPACT] + [PAPER] * options.paper:
        measure(preset, batch=options.batch, threads=options.threads)


def measure(preset: Preset, *, batch: int, threads: int) -> None:
    """Print the figures of one preset."""
    network = LaRecNet(preset.network).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    count = sum(p.numel() for p in network.parameters()) / 1e6
    print(f"{preset.name}: {count:.2f} M parameters, {threads} threads")
    perception = LinePerception(preset.network.dlp).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    samples = _samples(batch)
    for name, module, phase, optim in (
        ("phase one", perception, PerceptionPhase(preset.network.dlp), preset.optim_dlp),
        ("phase two", network, RectificationPhase(preset), preset.optim),
    ):
        step = _step(module, phase, build_optimizer(module, optim), samples)
        rate = batch / median_seconds(step, ROUNDS)
        print(f"  {name}, training, bf16: {rate:.1f} pictures a second")


def _step(
    module: nn.Module, phase: Phase, optimizer: torch.optim.Optimizer, samples: SlfBatch
) -> Callable[[], None]:
    module.train()

    def job() -> None:
        with torch.autocast("cpu", torch.bfloat16):
            loss, _ = phase.loss(module, samples)
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()

    return job


def _samples(batch: int) -> SlfBatch:
    k = torch.tensor([1.3, -0.05, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0]).repeat(batch, 1)
    pictures = torch.rand(batch, 3, SIZE, SIZE)
    lines = (torch.rand(batch, 1, SIZE, SIZE) < 0.05).float()
    return SlfBatch(pictures, lines, k, pictures, torch.full((batch,), 0.8))


if __name__ == "__main__":
    main()

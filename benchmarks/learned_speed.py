"""How fast the networks train and answer on this machine.

    python benchmarks/learned_speed.py [--threads 2] [--batch 8] [--onnx] [--paper]

Random pictures of 320x320; times are medians over rounds, training without the making of data.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import torch
from torch import nn

from learned.dlp import LinePerception
from learned.export import export_onnx
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
    parser.add_argument("--onnx", action="store_true", help="ONNX Runtime too")
    parser.add_argument("--paper", action="store_true", help="the paper's preset too (slow)")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    for preset in [COMPACT] + [PAPER] * options.paper:
        measure(preset, batch=options.batch, threads=options.threads, onnx=options.onnx)


def measure(preset: Preset, *, batch: int, threads: int, onnx: bool) -> None:
    """Print the figures of one preset."""
    network = LaRecNet(preset.network).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    count = sum(p.numel() for p in network.parameters()) / 1e6
    print(f"{preset.name}: {count:.2f} M parameters, {threads} threads")
    image = torch.rand(1, 3, SIZE, SIZE).contiguous(memory_format=torch.channels_last)
    network.eval()
    for name, module in (("line perception", network.dlp), ("both networks", network)):
        print(f"  {name}, one picture, fp32: {1e3 * seconds(_answer(module, image)):.0f} ms")
        with torch.autocast("cpu", torch.bfloat16):
            print(f"  {name}, one picture, bf16: {1e3 * seconds(_answer(module, image)):.0f} ms")
    if onnx:
        _measure_onnx(network, image, threads)
    perception = LinePerception(preset.network.dlp).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    samples = _samples(batch)
    for name, module, phase, optim in (
        ("phase one", perception, PerceptionPhase(preset.network.dlp), preset.optim_dlp),
        ("phase two", network, RectificationPhase(preset), preset.optim),
    ):
        step = _step(module, phase, build_optimizer(module, optim), samples)
        print(f"  {name}, training, bf16: {batch / seconds(step):.1f} pictures a second")


def seconds(job: Callable[[], object]) -> float:
    """Median time of a call, after two that do not count."""
    times = []
    for _ in range(ROUNDS + 2):
        start = time.perf_counter()
        job()
        times.append(time.perf_counter() - start)
    return statistics.median(times[2:])


def _answer(module: nn.Module, image: torch.Tensor) -> Callable[[], object]:
    def job() -> object:
        with torch.inference_mode():
            return module(image)

    return job


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


def _measure_onnx(network: LaRecNet, image: torch.Tensor, threads: int) -> None:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    feed = {"image": image.contiguous().numpy()}
    with tempfile.TemporaryDirectory() as folder:
        for path in export_onnx(network, Path(folder)):
            session = onnxruntime.InferenceSession(
                str(path), options, providers=["CPUExecutionProvider"]
            )
            taken = seconds(lambda session=session: session.run(None, feed))
            print(f"  {path.stem}, one picture, ONNX Runtime: {1e3 * taken:.0f} ms")


if __name__ == "__main__":
    main()

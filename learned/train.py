"""The training loop, the same for every network and every machine.

One visible loop inside Hugging Face Accelerate: `straightlens train …` on a CPU or one GPU,
`accelerate launch -m hybrid.cli train …` on many. Batch i of process p depends on the seed and on
i·processes + p only, so a resumed run sees the same data as one that was never stopped.
"""

from __future__ import annotations

import copy
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import torch
from accelerate import Accelerator
from jaxtyping import UInt8
from numpy import ndarray
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from classical.files import atomic_path
from learned.checkpoint import load_checkpoint, save_checkpoint
from learned.schedule import Average, OptimCfg, build_optimizer, rate_at
from learned.slf.batch import SlfBatch

BatchSource = Callable[[int], SlfBatch]
CHECKPOINT = "checkpoint.safetensors"


@dataclass(frozen=True)
class RunCfg:
    """How long and how a network is trained.

    Attributes:
        steps: Number of optimiser steps of the whole run.
        optim: Optimiser and schedule.
        workers: Processes that make batches ahead (0 = in the loop, right for a GPU).
        checkpoint_minutes: Time between checkpoints.
        report_every: Steps between reports on the validation batches.
        log_every: Steps between logged scalars.
        bf16: Mixed precision by autocast.
    """

    steps: int
    optim: OptimCfg = field(default_factory=OptimCfg)
    workers: int = 1
    checkpoint_minutes: float = 3.0
    report_every: int = 1000
    log_every: int = 20
    bf16: bool = True


@runtime_checkable
class Phase(Protocol):
    """What is trained: a loss on a batch and a report on validation batches."""

    def loss(self, module: nn.Module, batch: SlfBatch) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss to go down and scalars to log."""
        ...

    def report(
        self, module: nn.Module, batches: Sequence[SlfBatch]
    ) -> tuple[dict[str, float], dict[str, UInt8[ndarray, "h w 3"]]]:
        """Scalars and pictures that say how good the network is."""
        ...


class _Batches(Dataset[SlfBatch]):
    """Batches by number, for a loader that makes them ahead in another process."""

    def __init__(self, source: BatchSource, numbers: range) -> None:
        self.source = source
        self.numbers = numbers

    def __len__(self) -> int:
        return len(self.numbers)

    def __getitem__(self, index: int) -> SlfBatch:
        return self.source(self.numbers[index])


def train(
    module: nn.Module,
    phase: Phase,
    source: BatchSource,
    validation: Sequence[SlfBatch],
    cfg: RunCfg,
    *,
    folder: Path,
    resume: bool = False,
    cpu: bool = False,
    progress: bool = True,
) -> Average:
    """Train a network, with checkpoints, reports and a moving average of its weights.

    Args:
        module: Network; parameters that shall stay ask for no gradient.
        phase: Its loss and report.
        source: Makes batch i from its number; see `learned.slf`.
        validation: Batches of the report, small in number.
        cfg: Length, optimiser, intervals.
        folder: Run folder: checkpoint, TensorBoard events, report pictures, configuration.
        resume: Go on from the folder's checkpoint, if there is one.
        cpu: Stay on the CPU even where there is a GPU.
        progress: Draw a progress bar.

    Returns:
        The averaged weights at the end.
    """
    accelerator = Accelerator(mixed_precision="bf16" if cfg.bf16 else "no", cpu=cpu)
    module = module.to(accelerator.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimizer = build_optimizer(module, cfg.optim)
    average = Average(module, cfg.optim.average)
    path = folder / CHECKPOINT
    start = 0
    if resume and path.exists():
        start = load_checkpoint(path, module, optimizer, average)
    folder.mkdir(parents=True, exist_ok=True)
    wrapped, wrapped_optimizer = accelerator.prepare(module, optimizer)
    rank, world = accelerator.process_index, accelerator.num_processes
    batches = _ahead(source, range(start * world + rank, cfg.steps * world, world), cfg.workers)
    log = _Log(folder, cfg, start) if accelerator.is_main_process else None
    bar = tqdm(total=cfg.steps, initial=start, disable=not (progress and log), unit="step")
    saved = time.monotonic()
    module.train()
    for step, batch in zip(range(start, cfg.steps), batches, strict=True):
        rate = rate_at(step, cfg.steps, cfg.optim)
        for group in optimizer.param_groups:
            group["lr"] = rate
        loss, scalars = phase.loss(wrapped, batch.to(accelerator.device))
        accelerator.backward(loss)
        norm = accelerator.clip_grad_norm_(module.parameters(), cfg.optim.clip)
        wrapped_optimizer.step()
        wrapped_optimizer.zero_grad()
        average.update(module, step)
        bar.update()
        if log is None:
            continue
        log.scalars(step, loss, scalars | {"norm": norm}, rate, bar)
        last = step + 1 == cfg.steps
        if last or time.monotonic() - saved > 60 * cfg.checkpoint_minutes:
            save_checkpoint(path, module, optimizer, average, step=step + 1)
            saved = time.monotonic()
        if (last or (step + 1) % cfg.report_every == 0) and validation:
            log.report(step + 1, *phase.report(averaged(module, average), validation))
    bar.close()
    if log is not None:
        log.close()
    return average


def averaged(module: nn.Module, average: Average) -> nn.Module:
    """A copy of the network with the averaged weights, for evaluation."""
    twin = copy.deepcopy(module)
    twin.load_state_dict(average.values)
    return twin.eval()


def _ahead(source: BatchSource, numbers: range, workers: int) -> Iterator[SlfBatch]:
    """Batches in order, made by other processes where asked for."""
    if workers == 0:
        return (source(number) for number in numbers)
    loader = DataLoader(
        _Batches(source, numbers),
        batch_size=None,
        num_workers=workers,
        prefetch_factor=4,
        worker_init_fn=_one_thread,
    )
    return iter(loader)


def _one_thread(_worker: int) -> None:
    torch.set_num_threads(1)


class _Log:
    """Scalars and pictures: TensorBoard, a line of JSON per report, PNG files."""

    def __init__(self, folder: Path, cfg: RunCfg, start: int) -> None:
        self.folder = folder
        self.every = cfg.log_every
        self.writer = SummaryWriter(folder / "tensorboard", purge_step=start)
        self.sums: dict[str, Tensor | float] = {}
        self.since = time.monotonic()
        self.pictures = 0
        with atomic_path(folder / "run.json") as temporary:
            temporary.write_text(json.dumps(asdict(cfg), indent=1))

    def scalars(
        self, step: int, loss: Tensor, scalars: dict[str, Any], rate: float, bar: tqdm
    ) -> None:
        """Gather, and log means every few steps."""
        for name, value in (scalars | {"loss": loss}).items():
            value = value.detach() if isinstance(value, Tensor) else value
            self.sums[name] = self.sums.get(name, 0.0) + value
        if (step + 1) % self.every:
            return
        means = {name: float(value) / self.every for name, value in self.sums.items()}
        means["steps_per_s"] = self.every / max(1e-9, time.monotonic() - self.since)
        for name, value in (means | {"rate": rate}).items():
            self.writer.add_scalar(f"train/{name}", value, step + 1)
        bar.set_postfix({n: f"{v:.3g}" for n, v in means.items()}, refresh=False)
        self._line({"step": step + 1, "rate": rate, **means})
        self.sums, self.since = {}, time.monotonic()

    def report(
        self, step: int, scalars: dict[str, float], pictures: dict[str, UInt8[ndarray, "h w 3"]]
    ) -> None:
        """Write the report on the validation batches."""
        from PIL import Image

        for name, value in scalars.items():
            self.writer.add_scalar(f"validation/{name}", value, step)
        for name, picture in pictures.items():
            self.writer.add_image(f"validation/{name}", picture, step, dataformats="HWC")
            with atomic_path(self.folder / f"{name}.png") as temporary:
                Image.fromarray(picture).save(temporary)
        self._line({"step": step, "validation": scalars})
        self.writer.flush()

    def _line(self, values: dict[str, Any]) -> None:
        with (self.folder / "log.jsonl").open("a") as file:
            file.write(json.dumps(values) + "\n")

    def close(self) -> None:
        """Close the event file."""
        self.writer.close()

"""Training state on disk: safetensors, whole or not at all, never pickles."""

from __future__ import annotations

from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from classical.files import atomic_path
from learned.schedule import Average


def save_checkpoint(
    path: Path,
    module: nn.Module,
    optimizer: torch.optim.Optimizer,
    average: Average,
    *,
    step: int,
) -> None:
    """Write weights, their average and the optimiser's state.

    Args:
        path: File to write; the old one stays until the new one is whole.
        module: Network in training.
        optimizer: Its optimiser.
        average: Its moving average.
        step: Number of steps done.
    """
    tensors = {f"module/{n}": t for n, t in module.state_dict().items()}
    tensors |= {f"average/{n}": t for n, t in average.values.items()}
    for index, state in optimizer.state_dict()["state"].items():
        tensors |= {f"optimizer/{index}/{n}": t for n, t in state.items() if isinstance(t, Tensor)}
    whole = {n: t.detach().contiguous().cpu() for n, t in tensors.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        save_file(whole, temporary, metadata={"step": str(step)})


def load_checkpoint(
    path: Path, module: nn.Module, optimizer: torch.optim.Optimizer, average: Average
) -> int:
    """Restore what `save_checkpoint` wrote, in place.

    Args:
        path: File to read.
        module: Network of the same configuration.
        optimizer: Its optimiser.
        average: Its moving average.

    Returns:
        Number of steps done.
    """
    parts: dict[str, dict[str, Tensor]] = {"module": {}, "average": {}, "optimizer": {}}
    with safe_open(path, framework="pt") as file:
        for name in file.keys():  # noqa: SIM118 (not a dict)
            part, rest = name.split("/", 1)
            parts[part][rest] = file.get_tensor(name)
        step = int(file.metadata()["step"])
    module.load_state_dict(parts["module"])
    for name, value in parts["average"].items():
        average.values[name].copy_(value)
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in parts["optimizer"].items():
        index, key = name.split("/", 1)
        state.setdefault(int(index), {})[key] = value
    whole = optimizer.state_dict() | {"state": state}
    optimizer.load_state_dict(whole)
    return step

"""Learning rate as a function of the step, and the two optimisers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import nn


@dataclass(frozen=True)
class OptimCfg:
    """Optimiser and schedule.

    Attributes:
        kind: "sgd" with momentum (the paper) or "adamw".
        rate: Learning rate at its highest.
        schedule: "step" (divided by ten after half of the steps: 50 of the paper's 100 epochs) or
            "trapezoid" (rise, hold, fall to zero: a run can be ended any time by resuming it with
            fewer steps, which starts the fall).
        warmup: Steps of the rise.
        fall: Share of all steps that the fall takes.
        weight_decay: Decoupled for AdamW, plain for SGD.
        clip: Largest norm of the gradient.
        average: Decay of the exponential moving average of the weights.
    """

    kind: Literal["sgd", "adamw"] = "sgd"
    rate: float = 1e-3
    schedule: Literal["step", "trapezoid"] = "step"
    warmup: int = 0
    fall: float = 0.3
    weight_decay: float = 1e-4
    clip: float = 1.0
    average: float = 0.999


def rate_at(step: int, steps: int, cfg: OptimCfg) -> float:
    """Learning rate of step `step` (from 0) of `steps`."""
    if cfg.schedule == "step":
        return cfg.rate if step < steps // 2 else cfg.rate / 10.0
    rise = min(1.0, (step + 1) / max(1, cfg.warmup))
    fall = (steps - step) / max(1.0, cfg.fall * steps)
    return cfg.rate * min(rise, max(0.0, min(1.0, fall)))


def build_optimizer(module: nn.Module, cfg: OptimCfg) -> torch.optim.Optimizer:
    """The optimiser over the parameters that ask for gradients; no decay of norms and biases."""
    wanted = [p for p in module.parameters() if p.requires_grad]
    groups = [
        {"params": [p for p in wanted if p.ndim > 1], "weight_decay": cfg.weight_decay},
        {"params": [p for p in wanted if p.ndim <= 1], "weight_decay": 0.0},
    ]
    if cfg.kind == "sgd":
        return torch.optim.SGD(groups, lr=cfg.rate, momentum=0.9)
    return torch.optim.AdamW(groups, lr=cfg.rate, betas=(0.9, 0.99))


class Average:
    """Exponential moving average of a module's parameters and buffers.

    Starts as a plain mean, so that early averages do not remember the random start.
    """

    def __init__(self, module: nn.Module, decay: float) -> None:
        self.decay = decay
        self.values = {n: t.detach().clone() for n, t in module.state_dict().items()}

    @torch.no_grad()
    def update(self, module: nn.Module, step: int) -> None:
        """Move towards the module's present values."""
        decay = min(self.decay, (1.0 + step) / (10.0 + step))
        for name, value in module.state_dict().items():
            mean = self.values[name]
            if value.is_floating_point():
                mean.lerp_(value.detach(), 1.0 - decay)
            else:
                mean.copy_(value)

"""What a user can choose, in one place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from hybrid.methods import DEFAULT_METHOD, check_method

_INTERPOLATIONS = ("linear", "cubic", "lanczos")


@dataclass(frozen=True)
class RectifyConfig:
    """How a lens is estimated and what the straight picture shows.

    At most one of `focal`, `fov` and `balance` may be given; without any, balance is 0.

    Attributes:
        method: Which estimator finds the lens; see `hybrid.methods`.
        focal: Focal length of the straight picture in pixels.
        fov: Horizontal field of view of the straight picture in degrees.
        balance: 0 leaves no empty pixel, 1 loses nothing within 75° of the axis.
        size: (width, height) of the straight picture; None keeps the size of the input.
        interpolation: "linear", "cubic" or "lanczos".
        antialias: Smooth where the picture shrinks.
        variant: "2014" or "2016", of the method aleman-flores.
        weights: Weights of the networks, a safetensors file; None means those that ship.
        seed: Of every random choice, so that the same picture gives the same answer.
        threads: CPU threads to use; None leaves it to the libraries.
    """

    method: str = DEFAULT_METHOD
    focal: float | None = None
    fov: float | None = None
    balance: float | None = None
    size: tuple[int, int] | None = None
    interpolation: str = "linear"
    antialias: bool = True
    variant: Literal["2014", "2016"] = "2014"
    weights: str | None = None
    seed: int = 0
    threads: int | None = None

    def __post_init__(self) -> None:
        check_method(self.method)
        given = [name for name in ("focal", "fov", "balance") if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(
                f"Expected at most one of focal, fov and balance, got {' and '.join(given)}."
            )
        if self.focal is not None and not self.focal > 0:
            raise ValueError(f"Expected focal > 0 pixels, got {self.focal}.")
        if self.fov is not None and not 0 < self.fov <= 175:
            raise ValueError(f"Expected fov in (0, 175] degrees, got {self.fov}.")
        if self.balance is not None and not 0 <= self.balance <= 1:
            raise ValueError(f"Expected balance in [0, 1], got {self.balance}.")
        if self.size is not None and not (len(self.size) == 2 and min(self.size) >= 1):
            raise ValueError(f"Expected size (width, height) of at least 1x1, got {self.size}.")
        if self.interpolation not in _INTERPOLATIONS:
            raise ValueError(
                f"Expected interpolation in {_INTERPOLATIONS}, got {self.interpolation!r}."
            )
        if self.variant not in ("2014", "2016"):
            raise ValueError(f"Expected variant 2014 or 2016, got {self.variant!r}.")
        if self.threads is not None and self.threads < 1:
            raise ValueError(f"Expected threads >= 1, got {self.threads}.")

"""What a user can choose, in one place."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid.methods import DEFAULT_METHOD, check_method

METHOD_VARIANTS = {
    "aleman-flores": ("2014", "2016"),
    "hybrid": ("start", "prior", "snapped", "edges", "followed", "parallels", "full"),
}
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
        camera_focal: Focal length of the photograph in pixels, if it is known.
        camera_fov: Horizontal field of view of the photograph in degrees, if it is known.
        circle_fov: Field of view of the image circle in degrees (often 180), if it is known.
        variant: Of the method: "2014" (default) or "2016" of aleman-flores; one of the steps of
            `hybrid.fusion.VARIANTS` of hybrid. None is the whole method.
        weights: Weights of the networks: a safetensors file, or the name of some that ship
            ("compact", the default; "compact-wf", which knows the paper's lenses alone).
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
    camera_focal: float | None = None
    camera_fov: float | None = None
    circle_fov: float | None = None
    variant: str | None = None
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
        variants = METHOD_VARIANTS.get(self.method, ())
        if self.variant is not None and self.variant not in variants:
            known = ", ".join(variants) or "none"
            raise ValueError(
                f"Expected a variant of {self.method} ({known}), got {self.variant!r}."
            )
        if self.threads is not None and self.threads < 1:
            raise ValueError(f"Expected threads >= 1, got {self.threads}.")
        self._check_camera()

    def _check_camera(self) -> None:
        """What the user says of the photograph."""
        if self.camera_focal is not None and not self.camera_focal > 0:
            raise ValueError(f"Expected camera_focal > 0 pixels, got {self.camera_focal}.")
        for name in ("camera_fov", "circle_fov"):
            value = getattr(self, name)
            if value is not None and not 10 <= value <= 300:
                raise ValueError(f"Expected {name} in [10, 300] degrees, got {value}.")

"""The table of methods: every way to find a lens, the best first.

A method is an estimator: it takes pictures of one lens (RGB of 8 bits, one size) and gives a
`Calibration`. Each is named by where its factory is, which is imported when it is first asked for,
so that a method with heavy dependencies costs nothing until then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

if TYPE_CHECKING:
    from hybrid.config import RectifyConfig
    from hybrid.result import Calibration


@runtime_checkable
class Estimator(Protocol):
    """Finds the lens of pictures; keeps what it has loaded between calls."""

    def __call__(self, pictures: Sequence[np.ndarray]) -> Calibration:
        """The lens of pictures of one size, each (h, w, 3) uint8 RGB."""
        ...


@dataclass(frozen=True)
class Method:
    """A row of the table.

    Attributes:
        name: What the user writes.
        title: What it does, in a few words.
        factory: "module:name" of a function from a RectifyConfig to an Estimator.
        is_oriented: Whether all turned and mirrored copies of a picture look the same to it; what
            others published, and a network alone, see pictures as they come.
    """

    name: str
    title: str
    factory: str
    is_oriented: bool = False


METHODS = (
    Method(
        "hybrid",
        "networks and line fit",
        "hybrid.fusion:HybridEstimator",
        is_oriented=True,
    ),
    Method(
        "classical",
        "line fit alone",
        "hybrid.estimators:ClassicalEstimator",
        is_oriented=True,
    ),
    Method("learned", "LaRecNet alone", "hybrid.networks:LearnedEstimator"),
    Method(
        "aleman-flores",
        "division model",
        "hybrid.baselines:AlemanFloresEstimator",
    ),
    Method(
        "bukhari",
        "division model from arcs",
        "hybrid.baselines:BukhariEstimator",
    ),
    Method("rong", "division model, a network", "hybrid.networks:RongEstimator"),
    Method("identity", "the picture as it is", "hybrid.estimators:IdentityEstimator"),
)
DEFAULT_METHOD = "hybrid"


def method_names() -> tuple[str, ...]:
    """The names of all methods, the best first."""
    return tuple(method.name for method in METHODS)


def check_method(name: str) -> None:
    """Raise ValueError unless there is such a method."""
    if name not in method_names():
        raise ValueError(f"Expected a method in {', '.join(method_names())}, got {name!r}.")


def make_estimator(config: RectifyConfig) -> Estimator:
    """The estimator of `config.method`."""
    check_method(config.method)
    row = next(method for method in METHODS if method.name == config.method)
    module, name = row.factory.split(":")
    estimator: Estimator = getattr(import_module(module), name)(config)
    if not row.is_oriented:
        return estimator
    from hybrid.orientation import OrientedEstimator

    # a field of view is given for the width, so that must stay the width
    return OrientedEstimator(estimator, keeps_width=config.camera_fov is not None)

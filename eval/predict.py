"""Loop one: every method on every photograph, to disk."""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from classical.camera import Division, KannalaBrandt
from eval.cases import Suite, read_picture
from eval.folder import RunFolder
from eval.methods import IDENTITY, Method
from eval.pool import ordered_map
from eval.prediction import Prediction

Predictor = Callable[[UInt8[ndarray, "h w 3"]], Prediction]
Settings = tuple[tuple[str, Any], ...]
Factory = Callable[[str, Settings], Predictor]
"""Makes the predictor of a method from its tag and settings; called once a process and method."""

_MAP_SIDE = 160  # longest side of a heatmap kept for the report


@dataclass(frozen=True)
class _Task:
    """One photograph for one method."""

    tag: str
    settings: Settings
    picture: Path
    target: Path


def predict_suite(
    suite: Suite,
    methods: Mapping[Method, Mapping[str, Any]],
    folder: RunFolder,
    *,
    workers: int = 1,
    factory: Factory | None = None,
) -> Iterator[tuple[int, int]]:
    """Run methods over a suite; photographs that have their file are not done again.

    Each answer is a file of its own, written whole, so a run that is killed loses the pictures in
    hand: one a worker. The order of the work is the suite's within each method.

    Args:
        suite: The test set.
        methods: The settings of each method, see `project_method`.
        folder: Where the answers go; `claim_folder` has prepared it.
        workers: Processes.
        factory: Makes predictors; `project_method` by default.

    Yields:
        (done, total) after each photograph, counting those that were there before.
    """
    total = len(suite.cases) * len(methods)
    tasks = pending(suite, methods, folder)
    done = total - len(tasks)
    yield done, total
    for _ in ordered_map(partial(_predict_one, factory or project_method), tasks, workers=workers):
        done += 1
        yield done, total


def pending(
    suite: Suite, methods: Mapping[Method, Mapping[str, Any]], folder: RunFolder
) -> list[_Task]:
    """What is left to do, method by method."""
    return [
        _Task(method.tag, tuple(sorted(settings.items())), case.picture, target)
        for method, settings in methods.items()
        for case in suite.cases
        if not (target := folder.prediction(method.tag, case.name)).is_file()
    ]


def _predict_one(factory: Factory, task: _Task) -> None:
    """Answer one photograph and save the answer; an exception is a failure with its reason."""
    predictor = _predictor(factory, task.tag, task.settings)
    picture = read_picture(task.picture)
    start = time.perf_counter()
    try:
        prediction = predictor(picture)
    except Exception as error:  # a broken method must not stop the comparison; it is shown
        prediction = Prediction(None, "failed", f"{type(error).__name__}: {error}")
    prediction = replace(prediction, seconds=time.perf_counter() - start)
    prediction.save(task.target)


@lru_cache(maxsize=2)
def _predictor(factory: Factory, tag: str, settings: Settings) -> Predictor:
    return factory(tag, settings)


def project_method(tag: str, settings: Settings) -> Predictor:
    """The predictor of one of the project's methods, through the public `Rectifier`.

    Args:
        tag: `method` of `RectifyConfig`.
        settings: Further fields of `RectifyConfig`.
    """
    if tag == IDENTITY.tag:
        return _leave_alone
    from hybrid import Rectifier, RectifyConfig

    return partial(_ask, Rectifier(RectifyConfig(method=tag, **dict(settings))))


def _leave_alone(picture: UInt8[ndarray, "h w 3"]) -> Prediction:
    return Prediction(None, "ok")


def _ask(rectifier: Any, picture: UInt8[ndarray, "h w 3"]) -> Prediction:
    """Translate the calibration of one photograph into a prediction."""
    found = rectifier.calibrate([picture])
    camera = found.camera if isinstance(found.camera, KannalaBrandt | Division) else None
    curves = found.curves[0]
    return Prediction(
        camera=camera,
        status="failed" if camera is None else found.status,
        reason=found.reason,
        predicted_error_px=found.quality.predicted_error_px,
        curves=tuple(np.asarray(curve.points, dtype=np.float32) for curve in curves),
        inlier=np.array([curve.inlier for curve in curves], dtype=bool),
        heatmap=_small_map(getattr(found, "heatmap", None)),
        uncertainty=_small_map(getattr(found, "uncertainty", None)),
    )


def _small_map(values: Any) -> UInt8[ndarray, "h w"] | None:
    """A map as 8 bits of at most 160 px a side; values in [0, 1], others by their range."""
    if values is None:
        return None
    array = np.asarray(values, dtype=np.float64).squeeze()
    step = max(1, -(-max(array.shape) // _MAP_SIDE))
    rows, columns = (side // step * step for side in array.shape)
    blocks = array[:rows, :columns].reshape(rows // step, step, columns // step, step)
    small = blocks.max(axis=(1, 3))
    low, high = min(0.0, float(small.min())), max(1.0, float(small.max()))
    return np.round(255 * (small - low) / (high - low)).astype(np.uint8)

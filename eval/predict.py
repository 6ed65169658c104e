"""Loop one: every method on every photograph, to disk."""

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt8
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

_WEIGHTS = {"rong": "rong-compact", "learned": "compact", "hybrid": "compact"}


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


def settings_of(method: Method, *, seed: int) -> dict[str, Any]:
    """The settings of one of the project's methods, with a checksum of the weights it uses.

    Raises:
        ValueError: If there is no such method.
        FileNotFoundError: If its weights are not there.
    """
    settings: dict[str, Any] = {"seed": seed}
    if method == IDENTITY:
        return settings
    from hybrid import RectifyConfig

    RectifyConfig(method=method.tag, seed=seed)  # refuses what it does not know
    if name := _WEIGHTS.get(method.tag):
        from learned.weights import packaged

        settings["weights"] = hashlib.sha256(packaged(name).read_bytes()).hexdigest()[:16]
    return settings


def project_method(tag: str, settings: Settings) -> Predictor:
    """The predictor of one of the project's methods, through the public `Rectifier`.

    Args:
        tag: `method` of `RectifyConfig`.
        settings: Further fields of `RectifyConfig`; the checksum of the weights is for the record.
    """
    if tag == IDENTITY.tag:
        return _leave_alone
    from hybrid import Rectifier, RectifyConfig

    options = {name: value for name, value in settings if name != "weights"}
    return partial(_ask, Rectifier(RectifyConfig(method=tag, **options)))


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
        covariance=_known(found.quality.covariance),
    )


def _known(covariance: Float64[ndarray, "9 9"]) -> Float64[ndarray, "9 9"] | None:
    """A covariance, or `None` for the zeros that stand for an unknown one."""
    return covariance if np.any(covariance) else None

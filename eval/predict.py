"""Loop one: every method on every photograph, to disk."""

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt8
from numpy import ndarray

from eval.cases import Case, Suite, read_picture
from eval.folder import RunFolder
from eval.methods import FIXED, IDENTITY, Method
from eval.prediction import Prediction
from learned.pool import ordered_map

Predictor = Callable[[Sequence[UInt8[ndarray, "h w 3"]]], list[Prediction]]
"""Takes photographs of one lens and answers each."""

Settings = tuple[tuple[str, Any], ...]
Factory = Callable[[str, Settings], Predictor]
"""Makes the predictor of an estimator from its name and settings, once a process."""

_WEIGHTS = {"rong": "rong-compact", "learned": "compact", "hybrid": "compact"}


@dataclass(frozen=True)
class _Task:
    """The photographs that one method sees at once: one, or all of a camera."""

    estimator: str
    settings: Settings
    pictures: tuple[Path, ...]
    targets: tuple[Path, ...]


def predict_suite(
    suite: Suite,
    methods: Mapping[Method, Mapping[str, Any]],
    folder: RunFolder,
    *,
    workers: int = 1,
    cluster: str | None = None,
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
        cluster: Address of a Ray cluster to use instead, see `ordered_map`.
        factory: Makes predictors; `project_method` by default.

    Yields:
        (done, total) after each photograph, counting those that were there before.
    """
    total = len(suite.cases) * len(methods)
    tasks = pending(suite, methods, folder)
    done = total - sum(len(task.targets) for task in tasks)
    yield done, total
    results = ordered_map(
        partial(_predict, factory or project_method), tasks, workers=workers, cluster=cluster
    )
    for answered in results:
        done += answered
        yield done, total


def pending(
    suite: Suite, methods: Mapping[Method, Mapping[str, Any]], folder: RunFolder
) -> list[_Task]:
    """What is left to do, method by method."""
    tasks = []
    for method, settings in methods.items():
        for cases in _batches(suite, method):
            targets = tuple(folder.prediction(method.tag, case.name) for case in cases)
            if not all(target.is_file() for target in targets):
                pictures = tuple(case.picture for case in cases)
                options = tuple(sorted(settings.items()))
                tasks.append(_Task(method.estimator, options, pictures, targets))
    return tasks


def _batches(suite: Suite, method: Method) -> list[list[Case]]:
    """The cases that a method sees at once; pictures of one size where it takes a camera's."""
    if not method.together:
        return [[case] for case in suite.cases]
    batches: dict[tuple[str, int, int], list[Case]] = {}
    for case in suite.cases:
        key = (case.group, case.camera.width, case.camera.height)
        batches.setdefault(key, []).append(case)
    return list(batches.values())


def _predict(factory: Factory, task: _Task) -> int:
    """Answer the photographs of a task, save the answers, and say how many.

    An exception is a failure with its reason. The time of a photograph is its share.
    """
    predictor = _predictor(factory, task.estimator, task.settings)
    pictures = [read_picture(path) for path in task.pictures]
    start = time.perf_counter()
    try:
        predictions = predictor(pictures)
    except Exception as error:  # a broken method must not stop the comparison; it is shown
        reason = f"{type(error).__name__}: {error}"
        predictions = [Prediction(None, "failed", reason)] * len(pictures)
    seconds = (time.perf_counter() - start) / len(pictures)
    for prediction, target in zip(predictions, task.targets, strict=True):
        replace(prediction, seconds=seconds).save(target)
    return len(pictures)


@lru_cache(maxsize=2)
def _predictor(factory: Factory, estimator: str, settings: Settings) -> Predictor:
    return factory(estimator, settings)


def settings_of(method: Method, suite: Suite, *, seed: int) -> dict[str, Any]:
    """The settings of one of the project's methods, with a checksum of the weights it uses.

    Args:
        method: One of `EVERY`.
        suite: The test set; what a yardstick knows of it is in its settings.
        seed: Of random choices.

    Raises:
        ValueError: If there is no such method.
        FileNotFoundError: If its weights are not there.
    """
    settings: dict[str, Any] = {"seed": seed}
    if method == IDENTITY:
        return settings
    if method == FIXED:
        from eval.fixed import best_fixed_lens

        return asdict(best_fixed_lens(suite.cases, suite.theta_max))
    from hybrid import RectifyConfig

    # refuses what it does not know
    RectifyConfig(method=method.estimator, seed=seed, variant=method.variant)
    if method.variant is not None:
        settings["variant"] = method.variant
    if method.weights is not None:
        settings["weights_name"] = method.weights
    if name := method.weights or _WEIGHTS.get(method.estimator):
        from learned.weights import packaged

        settings["weights"] = hashlib.sha256(packaged(name).read_bytes()).hexdigest()[:16]
    return settings


def project_method(estimator: str, settings: Settings) -> Predictor:
    """The predictor of one of the project's methods, through the public `Rectifier`.

    Args:
        estimator: `method` of `RectifyConfig`.
        settings: Further fields of `RectifyConfig`; the checksum of the weights is for the record.
    """
    if estimator == IDENTITY.tag:
        return _leave_alone
    if estimator == FIXED.tag:
        from eval.fixed import FixedLens

        return partial(_give, FixedLens(**dict(settings)))
    from hybrid import Rectifier, RectifyConfig

    options = dict(settings)
    options.pop("weights", None)
    if name := options.pop("weights_name", None):
        options["weights"] = name
    return partial(_ask, Rectifier(RectifyConfig(method=estimator, **options)))


def _leave_alone(pictures: Sequence[UInt8[ndarray, "h w 3"]]) -> list[Prediction]:
    return [Prediction(None, "ok") for _ in pictures]


def _give(lens: Any, pictures: Sequence[UInt8[ndarray, "h w 3"]]) -> list[Prediction]:
    """A fixed lens for each picture."""
    return [Prediction(lens.camera(p.shape[1], p.shape[0]), "ok") for p in pictures]


def _ask(rectifier: Any, pictures: Sequence[UInt8[ndarray, "h w 3"]]) -> list[Prediction]:
    """Translate the calibration of photographs into a prediction for each."""
    found = rectifier.calibrate(pictures)
    return [
        Prediction(
            camera=found.camera,
            status="failed" if found.camera is None else found.status,
            reason=found.reason,
            predicted_error_px=found.quality.predicted_error_px,
            curves=tuple(np.asarray(curve.points, dtype=np.float32) for curve in curves),
            inlier=np.array([curve.inlier for curve in curves], dtype=bool),
            covariance=_known(found.quality.covariance),
        )
        for curves in found.curves
    ]


def _known(covariance: Float64[ndarray, "9 9"]) -> Float64[ndarray, "9 9"] | None:
    """A covariance, or `None` for the zeros that stand for an unknown one."""
    return covariance if np.any(covariance) else None

"""One function over many tasks: in this process, or in several, with results in order."""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import cv2

Task = TypeVar("Task")
Result = TypeVar("Result")

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def ordered_map(
    function: Callable[[Task], Result], tasks: Sequence[Task], *, workers: int
) -> Iterator[Result]:
    """Yield `function(task)` for each task in order.

    Args:
        function: A module-level function or a partial of one; it must not depend on this process.
        tasks: What to work on.
        workers: Processes; 1 works in this process. Each of several keeps to one core, so that
            times are comparable.

    Raises:
        ValueError: If `workers` is not positive.
    """
    if workers < 1:
        raise ValueError(f"expected at least one worker, got {workers}")
    if workers == 1 or len(tasks) < 2:
        yield from map(function, tasks)
        return
    # Started afresh, not forked: the parent may hold threads of torch or OpenCV.
    context = multiprocessing.get_context("spawn")
    with _one_thread_each(), context.Pool(min(workers, len(tasks)), _calm) as pool:
        yield from pool.imap(function, tasks)


def _calm() -> None:
    cv2.setNumThreads(1)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Let processes started meanwhile run their arithmetic on one thread."""
    before: dict[str, Any] = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value

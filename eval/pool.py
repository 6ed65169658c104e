"""One function over many tasks: in this process, in several, or on a cluster; results in order."""

import multiprocessing
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any, TypeVar

import cv2

Task = TypeVar("Task")
Result = TypeVar("Result")

_AHEAD = 4
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def ordered_map(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    *,
    workers: int,
    cluster: str | None = None,
) -> Iterator[Result]:
    """Yield `function(task)` for each task in order.

    Args:
        function: A module-level function or a partial of one; it must not depend on this process.
        tasks: What to work on.
        workers: Processes; 1 works in this process. Each of several keeps to one core, so that
            times are comparable.
        cluster: Address of a Ray cluster ("auto", "local", "host:port") that works instead; all
            its hosts must see the same files under the same names.

    Raises:
        ValueError: If `workers` is not positive.
        ImportError: If a cluster is asked for and Ray is not installed.
    """
    if workers < 1:
        raise ValueError(f"expected at least one worker, got {workers}")
    if cluster is not None:
        yield from _on_cluster(function, tasks, cluster)
        return
    if workers == 1 or len(tasks) < 2:
        yield from map(function, tasks)
        return
    # Started afresh, not forked: the parent may hold threads of torch or OpenCV.
    context = multiprocessing.get_context("spawn")
    with _one_thread_each(), context.Pool(min(workers, len(tasks)), _calm) as pool:
        yield from pool.imap(function, tasks)


def _on_cluster(
    function: Callable[[Task], Result], tasks: Sequence[Task], address: str
) -> Iterator[Result]:
    """Work on all cores of a Ray cluster; a few tasks a core are under way at any time."""
    ray = import_module("ray")  # an optional extra
    started_here = not ray.is_initialized()
    if started_here:
        ray.init(address=None if address == "local" else address, log_to_driver=False)
    try:
        work = ray.remote(num_cpus=1)(_call)
        shared = ray.put(function)
        most = _AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)))
        waiting: deque[Any] = deque()
        for task in tasks:
            if len(waiting) >= most:
                yield ray.get(waiting.popleft())
            waiting.append(work.remote(shared, task))
        while waiting:
            yield ray.get(waiting.popleft())
    finally:
        if started_here:
            ray.shutdown()


def _call(function: Callable[[Task], Result], task: Task) -> Result:
    return function(task)


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

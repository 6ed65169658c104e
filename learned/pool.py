"""One function over many tasks: in this process, in several, or on a cluster; results in order."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType, TracebackType
from typing import Any, TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")

_AHEAD = 4  # tasks that wait for each process, so that memory stays flat
_MOST_BLOCKS = 1000  # of a cluster's task list
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def processor_count() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class WorkPool:
    """Workers that are kept between maps; a context manager.

    Args:
        workers: Processes; 1 works in this process. Each of several keeps to one core, so that
            times are comparable.
        cluster: Address of a Ray cluster ("auto", "local", "host:port") that works instead, by Ray
            Data; all its hosts must see the same files under the same names.

    Raises:
        ValueError: If `workers` is not positive.
        ImportError: If a cluster is asked for and Ray is not installed.
    """

    def __init__(self, *, workers: int, cluster: str | None = None) -> None:
        if workers < 1:
            raise ValueError(f"expected at least one worker, got {workers}")
        self._workers, self._cluster = workers, cluster
        self._executor: ProcessPoolExecutor | None = None
        self._data: ModuleType | None = None
        self._open = ExitStack()

    def __enter__(self) -> WorkPool:
        if self._cluster is not None:
            self._data = self._open.enter_context(_ray_data(self._cluster))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._executor is not None:
            self._executor.shutdown(cancel_futures=True)
        self._open.close()

    def ordered(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[Result]:
        """Yield `function(task)` for each task in order.

        Args:
            function: A module-level function or a partial of one; it must not depend on this
                process.
            tasks: What to work on.

        Raises:
            OSError: If a process died; what the function raises is raised here, too.
        """
        if self._data is not None:
            yield from _on_cluster(self._data, function, tasks)
        elif self._workers == 1 or (len(tasks) < 2 and self._executor is None):
            yield from map(function, tasks)
        else:
            yield from self._in_processes(function, tasks)

    def _in_processes(
        self, function: Callable[[Task], Result], tasks: Sequence[Task]
    ) -> Iterator[Result]:
        if self._executor is None:
            self._open.enter_context(_one_thread_each())
            # Started afresh, not forked: the parent may hold threads of torch or OpenCV.
            context = multiprocessing.get_context("spawn")
            self._executor = ProcessPoolExecutor(self._workers, context, _begin)
        waiting: deque[Future[Result]] = deque()
        try:
            for task in tasks:
                if len(waiting) >= _AHEAD * self._workers:
                    yield waiting.popleft().result()
                waiting.append(self._executor.submit(function, task))
            while waiting:
                yield waiting.popleft().result()
        except BrokenProcessPool as error:
            message = "a worker process died, perhaps for want of memory; try fewer workers"
            raise OSError(message) from error
        finally:
            for future in waiting:
                future.cancel()


def ordered_map(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    *,
    workers: int,
    cluster: str | None = None,
) -> Iterator[Result]:
    """Yield `function(task)` for each task in order, by workers of their own; see `WorkPool`."""
    with WorkPool(workers=min(workers, max(1, len(tasks))), cluster=cluster) as pool:
        yield from pool.ordered(function, tasks)


# ---- processes -----------------------------------------------------------------------------------


def _begin() -> None:
    """Make a worker calm: one thread, no say in Ctrl-C, and no life after its parent's death."""
    if find_spec("cv2") is not None:
        import_module("cv2").setNumThreads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_die_with_parent, daemon=True).start()


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)  # the queues would never end


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


# ---- a cluster -----------------------------------------------------------------------------------


@contextmanager
def _ray_data(address: str) -> Iterator[ModuleType]:
    """Ray Data on a cluster, which is left as it was found."""
    ray = import_module("ray")  # an optional extra
    started_here = not ray.is_initialized()
    if started_here:
        ray.init(address=None if address == "local" else address, log_to_driver=False)
    try:
        yield import_module("ray.data")
    finally:
        if started_here:
            ray.shutdown()


def _on_cluster(
    data: ModuleType, function: Callable[[Task], Result], tasks: Sequence[Task]
) -> Iterator[Result]:
    """Stream the tasks through all cores of the cluster."""
    if not tasks:
        return
    context = data.DataContext.get_current()
    context.execution_options.preserve_order = True
    context.enable_progress_bars = False
    rows = [{"task": pickle.dumps(task)} for task in tasks]
    source = data.from_items(rows, override_num_blocks=min(len(rows), _MOST_BLOCKS))
    for row in source.map(partial(_on_row, function), num_cpus=1).iter_rows():
        result, error = pickle.loads(row["outcome"])
        if error is not None:
            raise error
        yield result


def _on_row(function: Callable[[Task], Result], row: dict[str, bytes]) -> dict[str, bytes]:
    """One task; an error is a result, so that it arrives as what it is."""
    try:
        outcome = function(pickle.loads(row["task"])), None
    except Exception as error:
        outcome = None, error
    return {"outcome": pickle.dumps(outcome)}

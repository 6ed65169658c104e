"""Tasks spread over processes or a cluster give the results of one process, in order."""

import os

import pytest

from learned.pool import ordered_map


def tasks() -> list[str]:
    return ["pear", "fig", "apple", "date"]


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_in_the_order_of_the_tasks(workers):
    assert list(ordered_map(len, tasks(), workers=workers)) == [4, 3, 5, 4]


def test_no_task_is_no_result():
    assert list(ordered_map(len, [], workers=3)) == []


def test_no_worker_is_misuse():
    with pytest.raises(ValueError, match="got 0"):
        list(ordered_map(len, tasks(), workers=0))


def test_an_error_in_a_worker_reaches_the_caller():
    with pytest.raises(TypeError):
        list(ordered_map(len, ["a", 3], workers=2))  # pyright: ignore[reportArgumentType]


def test_workers_keep_to_one_thread_and_the_caller_keeps_its_own(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    names = ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"]
    assert list(ordered_map(os.getenv, names, workers=2)) == ["1", "1"]
    assert os.environ["OMP_NUM_THREADS"] == "7"


def test_a_worker_that_dies_is_told():
    with pytest.raises(OSError, match="worker process died"):
        list(ordered_map(os._exit, [1, 1], workers=2))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_cluster_gives_the_same():
    pytest.importorskip("ray")
    found = list(ordered_map(len, tasks() * 5, workers=1, cluster="local"))
    assert found == [4, 3, 5, 4] * 5

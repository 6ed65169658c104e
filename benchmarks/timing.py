"""Medians of wall-clock time, and peak memory of a process."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping

ENOUGH_S = 3.0  # a measurement stops after so long, but has one round at least


def seconds(call: Callable[[], object]) -> float:
    """Wall-clock time of one call."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def median_seconds(call: Callable[[], object], rounds: int) -> float:
    """Median time of some calls after one that warms up; that one counts if it takes long."""
    times = [seconds(call)]
    if times[0] < ENOUGH_S:
        times = []
    while len(times) < rounds and (not times or sum(times) < ENOUGH_S):
        times.append(seconds(call))
    return statistics.median(times)


def in_turn(calls: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Median times of calls made in turn, so that a busy machine slows all alike."""
    for call in calls.values():
        call()
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            times[name].append(seconds(call))
    return {name: statistics.median(values) for name, values in times.items()}


def process(*words: object, python: bool = True) -> str:
    """Run a process and give its stderr and stdout together."""
    line = [str(word) for word in words]
    done = subprocess.run(
        [sys.executable, *line] if python else line,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=True,
    )
    return done.stdout

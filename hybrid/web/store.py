"""What the page keeps: in memory only, behind names that cannot be guessed."""

from __future__ import annotations

import secrets
import time
from collections import OrderedDict
from threading import Lock
from typing import Generic, TypeVar

T = TypeVar("T")


class Store(Generic[T]):
    """Keeps the things used last.

    Args:
        max_kept: How many; the one used longest ago goes first.
        max_age: Seconds without use after which a thing is forgotten.
    """

    def __init__(self, max_kept: int, max_age: float) -> None:
        self._max_kept, self._max_age = max_kept, max_age
        self._things: OrderedDict[str, tuple[float, T]] = OrderedDict()
        self._lock = Lock()

    def put(self, thing: T) -> str:
        """Keep a thing; returns its name of 128 random bits."""
        name = secrets.token_urlsafe(16)
        self._keep(name, thing)
        return name

    def replace(self, name: str, thing: T) -> None:
        """Keep another thing under a name, unless that has been forgotten."""
        if self.get(name) is not None:
            self._keep(name, thing)

    def get(self, name: str) -> T | None:
        """The thing of a name; None if there is none, or no longer."""
        with self._lock:
            self._forget_old()
            if name not in self._things:
                return None
            _, thing = self._things[name]
            self._things[name] = (time.monotonic(), thing)
            self._things.move_to_end(name)
            return thing

    def _keep(self, name: str, thing: T) -> None:
        with self._lock:
            self._things[name] = (time.monotonic(), thing)
            self._things.move_to_end(name)
            self._forget_old()

    def _forget_old(self) -> None:
        oldest = time.monotonic() - self._max_age
        while self._things:
            name, (used, _) = next(iter(self._things.items()))
            if used >= oldest and len(self._things) <= self._max_kept:
                break
            del self._things[name]

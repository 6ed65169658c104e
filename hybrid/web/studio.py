"""What the page can do, without a word of HTTP: take pictures in, find their lens."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from threading import Lock

from hybrid.config import RectifyConfig
from hybrid.methods import check_method
from hybrid.pipeline import Rectifier
from hybrid.web.exhibit import Exhibit
from hybrid.web.store import Store
from hybrid.web.upload import Limits, picture_from_bytes


class Studio:
    """Keeps uploaded pictures and finds lenses, one at a time.

    Args:
        limits: What is taken in and kept.
        threads: CPU threads to use; None leaves it to the libraries.
    """

    def __init__(self, limits: Limits, threads: int | None = None) -> None:
        self.limits = limits
        self._store: Store[Exhibit] = Store(limits.max_kept, limits.max_age)
        self._busy = Lock()
        self._rectifier = lru_cache(maxsize=2)(
            lambda method: Rectifier(RectifyConfig(method=method, threads=threads))
        )

    def take(self, data: bytes) -> str:
        """Keep an uploaded picture; returns the name that it is known by.

        Raises:
            ValueError: If it is no picture within the limits.
        """
        return self._store.put(Exhibit(picture_from_bytes(data, self.limits)))

    def exhibit(self, name: str) -> Exhibit:
        """The picture of a name.

        Raises:
            LookupError: If there is none, or it has been forgotten.
        """
        exhibit = self._store.get(name)
        if exhibit is None:
            raise LookupError("This picture has been forgotten: drop it once more.")
        return exhibit

    def find_lens(self, name: str, method: str) -> Exhibit:
        """Look for the lens of a kept picture.

        Args:
            name: As `take` gave it.
            method: A name of `hybrid.methods`.

        Raises:
            LookupError: If the picture has been forgotten.
            ValueError: If there is no such method.
        """
        check_method(method)
        exhibit = self.exhibit(name)
        with self._busy:
            found = self._rectifier(method).calibrate([exhibit.picture.pixels])
        exhibit = replace(exhibit, found=found)
        self._store.replace(name, exhibit)
        return exhibit

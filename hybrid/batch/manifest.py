"""The manifest of a batch: one JSON object a line, written as things get done.

The first line holds the settings; then come lenses and pictures. A line that was cut off by the end
of a process is dropped when the file is opened again; of several lines on a thing the last counts.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

Fields = dict[str, Any]
NAME = "manifest.jsonl"
_KIND = "kind"
_BEGINNING = b'{"kind": "settings", '


class Manifest:
    """The manifest of a folder, opened for going on.

    Args:
        folder: The folder of the results, which exists.
        settings: What the results depend on.
        restart: Begin a new manifest.

    Attributes:
        lenses: What is known of each group.
        pictures: What is known of each picture, by its path below the folder.

    Raises:
        ValueError: If the folder's manifest is of other settings, or no manifest.
    """

    def __init__(self, folder: Path, settings: Fields, *, restart: bool = False) -> None:
        self._path = folder / NAME
        self.lenses: dict[str, Fields] = {}
        self.pictures: dict[str, Fields] = {}
        self._file = self._path.open("a+b")
        try:
            self._lock()
            size = 0 if restart else self._read(settings)
        except BaseException:
            self._file.close()
            raise
        self._file.truncate(size)
        if not size:
            self._write({_KIND: "settings", **settings})

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def add_lens(self, fields: Fields) -> None:
        """Note what is known of a group; `fields` names it as "group"."""
        self.lenses[fields["group"]] = fields
        self._write({_KIND: "lens", **fields})

    def add_picture(self, fields: Fields) -> None:
        """Note what came of a picture; `fields` names it as "input"."""
        self._write({_KIND: "picture", **fields})

    def _write(self, fields: Fields) -> None:
        # in one call, and past Python's buffer, so that the end of this process loses no line
        self._file.write(json.dumps(fields, allow_nan=False).encode() + b"\n")
        self._file.flush()

    def _lock(self) -> None:
        """Keep others out as long as the file is open; the end of the process unlocks it."""
        if fcntl is None:
            return
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(f"another batch is at work in {self._path.parent}") from None
        except OSError:
            return  # a file system without locks

    def _read(self, settings: Fields) -> int:
        """Take in the lines; returns where the last whole one ends."""
        self._file.seek(0)
        data = self._file.read()
        whole = data[: data.rfind(b"\n") + 1]
        if not whole and not _BEGINNING.startswith(data[: len(_BEGINNING)]):
            raise ValueError(f"{self._path} is no manifest; use another folder")
        for number, line in enumerate(whole.splitlines()):
            fields = self._parsed(line)
            kind = fields.pop(_KIND, None)
            if number == 0:
                self._check(kind, fields, settings)
            elif kind == "lens":
                self.lenses[fields["group"]] = fields
            elif kind == "picture":
                self.pictures[fields["input"]] = fields
        return len(whole)

    def _parsed(self, line: bytes) -> Fields:
        try:
            fields = json.loads(line)
        except ValueError:
            fields = None
        if not isinstance(fields, dict):
            raise ValueError(f"{self._path} is no manifest; use another folder")
        return fields

    def _check(self, kind: object, found: Fields, settings: Fields) -> None:
        if kind != "settings":
            raise ValueError(f"{self._path} is no manifest; use another folder")
        wanted = json.loads(json.dumps(settings))
        names = [name for name in {**wanted, **found} if wanted.get(name) != found.get(name)]
        if names:
            listed = ", ".join(
                f"{name} {found.get(name)!r} instead of {wanted.get(name)!r}" for name in names
            )
            raise ValueError(
                f"the results in {self._path.parent} were made with {listed}; "
                "use another folder or --overwrite"
            )

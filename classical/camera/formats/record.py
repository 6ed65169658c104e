"""The content of a camera file, parsed once and taken apart with checks.

What is wrong with a file is a ValueError that names the field; nothing else comes out, whatever the
file holds.
"""

from __future__ import annotations

import json
import math
import os
import stat
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

MAX_BYTES = 32 << 20  # a transforms.json of a long film
MAX_YAML_BYTES = 256 << 10  # PyYAML is slow, and cameras are short
MAX_SIDE = 1_000_000  # pixels
_MAX_NUMBERS, _MAX_DEPTH = 1000, 4  # of one field: aliases in YAML can stand for endless lists
_SHOWN = 40  # characters of a bad value


class Record:
    """A mapping from a file whose values are checked as they are taken."""

    def __init__(self, fields: Mapping[Any, Any]) -> None:
        self._fields = fields

    def __contains__(self, name: str) -> bool:
        return name in self._fields

    def value(self, *names: str) -> Any:
        """The first of these fields that is there.

        Raises:
            ValueError: If none is.
        """
        for name in names:
            if name in self._fields:
                return self._fields[name]
        listed = " or ".join(repr(name) for name in names)
        raise ValueError(f"the field {listed} is missing")

    def part(self, name: str) -> Record:
        """A field that is itself a mapping."""
        value = self.value(name)
        if not isinstance(value, dict):
            raise ValueError(f"expected {name!r} to hold fields, got {shown(value)}")
        return Record(value)

    def parts(self) -> dict[str, Record]:
        """All fields that are mappings themselves."""
        return {
            str(name): Record(value)
            for name, value in self._fields.items()
            if isinstance(value, dict)
        }

    def numbers(self, *names: str, count: int | None = None) -> Float[np.ndarray, " n"]:
        """Finite numbers, flattened; also of OpenCV's {rows, cols, data}.

        Args:
            names: The first of these fields that is there is taken.
            count: How many there have to be.
        """
        value = self.value(*names)
        name = next(name for name in names if name in self._fields)
        if isinstance(value, dict):
            value = value.get("data")
        try:
            numbers = [float(leaf) for leaf in _leaves(value, _MAX_DEPTH)]
        except (TypeError, ValueError, OverflowError):
            raise ValueError(f"expected numbers in {name!r}, got {shown(value)}") from None
        if len(numbers) > _MAX_NUMBERS or count not in (None, len(numbers)):
            raise ValueError(f"expected {count or 'fewer'} numbers in {name!r}, got {len(numbers)}")
        if not np.isfinite(numbers).all():
            raise ValueError(f"expected finite numbers in {name!r}")
        return np.array(numbers, dtype=np.float64)

    def number(self, *names: str) -> float:
        """One finite number."""
        return float(self.numbers(*names, count=1)[0])

    def optional_number(self, name: str) -> float:
        """A number; NaN where the field is missing or null."""
        return math.nan if self._fields.get(name) is None else self.number(name)

    def size(self, width: str, height: str) -> tuple[int, int]:
        """Width and height of a picture in pixels."""
        return picture_size(self.number(width), self.number(height))

    def text(self, *names: str, default: str) -> str:
        """The first of these fields that is a string."""
        values = (self._fields.get(name) for name in names)
        return next((value for value in values if isinstance(value, str)), default)


class Content:
    """A camera file as words a line, and as a record where it is JSON or YAML.

    Args:
        text: All of the file.
    """

    def __init__(self, text: str) -> None:
        self._text = text
        self._is_json = text.lstrip().startswith("{")

    @cached_property
    def lines(self) -> list[list[str]]:
        """Words of each line that is neither empty nor a comment (#); none of JSON."""
        rows = [] if self._is_json else [line.split() for line in self._text.splitlines()]
        return [row for row in rows if row and not row[0].startswith("#")]

    @cached_property
    def record(self) -> Record:
        """The fields of JSON or YAML; without any where the file is no mapping.

        Raises:
            ValueError: If it is neither.
        """
        try:
            fields = json.loads(self._text) if self._is_json else _yaml(self._text)
        except RecursionError:
            raise ValueError("not a camera file: nested too deeply") from None
        except (ValueError, OverflowError) as error:
            raise ValueError(f"not a camera file: {' '.join(str(error).split())}") from None
        return Record(fields if isinstance(fields, dict) else {})


def read_content(path: str | os.PathLike[str]) -> Content:
    """Read a camera file.

    Raises:
        FileNotFoundError: If there is none.
        ValueError: If it is too large, no text or no regular file.
    """
    path = Path(path)
    told = path.stat()
    if not stat.S_ISREG(told.st_mode):  # a pipe would be waited for
        raise ValueError("not a camera file: not a regular file")
    if told.st_size > MAX_BYTES:
        raise ValueError(f"not a camera file: {told.st_size} bytes")
    try:
        return Content(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        raise ValueError("not a camera file: no text in UTF-8") from None


def shown(value: object) -> str:
    """The beginning of a value, for a message."""
    plain = isinstance(value, str | float | bool | None)  # an int may be too long to print
    return repr(value)[:_SHOWN] if plain else type(value).__name__


def picture_size(width: float, height: float) -> tuple[int, int]:
    """Width and height as whole numbers.

    Raises:
        ValueError: If they are not, or out of range.
    """
    for side in (width, height):
        if not (1 <= side <= MAX_SIDE and side == round(side)):
            raise ValueError(
                f"expected a picture of at least 1x1 whole pixels, got {width:g}x{height:g}"
            )
    return int(width), int(height)


def _leaves(value: Any, depth: int) -> Iterator[Any]:
    """What nested lists hold, at most a little more than the limit; none of them may be empty."""
    if not isinstance(value, list):
        yield value
        return
    if depth == 0 or not value:
        raise ValueError
    n_given = 0
    for part in value:
        for leaf in _leaves(part, depth - 1):
            yield leaf
            n_given += 1
            if n_given > _MAX_NUMBERS:
                return


def _yaml(text: str) -> Any:
    """YAML with every scalar as a string, whatever its tag: numbers are read by `Record`."""
    if len(text) > MAX_YAML_BYTES:
        raise ValueError(f"{len(text)} characters")
    # OpenCV writes "%YAML:1.0", which is no directive of YAML
    rows = [line for line in text.splitlines() if not line.startswith("%")]
    import yaml  # not needed for JSON

    try:
        return yaml.load("\n".join(rows), Loader=yaml.BaseLoader)
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from None

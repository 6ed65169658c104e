"""Nested frozen dataclasses to JSON and back, so that weights carry the network's description."""

from __future__ import annotations

import json
import typing
from dataclasses import asdict, fields, is_dataclass
from typing import Any, TypeVar

T = TypeVar("T")


def to_json(config: Any) -> str:
    """A dataclass as JSON."""
    return json.dumps(asdict(config), sort_keys=True)


def from_json(kind: type[T], text: str) -> T:
    """The dataclass of a type from its JSON; the inverse of `to_json`.

    Raises:
        ValueError: If a field is unknown.
    """
    return _build(kind, json.loads(text))


def _build(kind: Any, value: Any) -> Any:
    if not is_dataclass(kind):
        return tuple(value) if isinstance(value, list) else value
    hints = typing.get_type_hints(kind)
    known = {field.name for field in fields(kind)}
    if unknown := set(value) - known:
        raise ValueError(f"expected fields of {kind} among {sorted(known)}, got {sorted(unknown)}")
    return kind(**{name: _build(hints[name], part) for name, part in value.items()})  # type: ignore[operator]

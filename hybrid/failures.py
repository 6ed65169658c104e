"""What may go wrong with one item of many, and how it is told on one line."""

from __future__ import annotations

from pathlib import Path

ITEM_ERRORS = (OSError, ValueError, MemoryError)  # they end one item, not the command


def reason_of(error: Exception, path: Path) -> str:
    """An item's error in words, without the path that the report names anyway.

    Args:
        error: One of `ITEM_ERRORS`.
        path: The file that it is about.
    """
    if isinstance(error, MemoryError):
        return "not enough memory"
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(text.split()).removeprefix(f"{path}: ")

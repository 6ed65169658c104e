"""What may go wrong with one item of many, and how it is told on one line."""

from __future__ import annotations

import errno
from pathlib import Path

ITEM_ERRORS = (OSError, ValueError, MemoryError)  # they end one item, not the command
_HITS_ALL = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)  # a full disk


def reason_of(error: Exception, path: Path) -> str:
    """An item's error in words, without the path that the report names anyway.

    Args:
        error: One of `ITEM_ERRORS`.
        path: The file that it is about.

    Raises:
        OSError: The error itself if every other item would meet it, too: the disk is full.
    """
    if isinstance(error, OSError) and error.errno in _HITS_ALL:
        raise error
    if isinstance(error, MemoryError):
        return "not enough memory"
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(text.split()).removeprefix(f"{path}: ")

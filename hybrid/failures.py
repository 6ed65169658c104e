"""What may go wrong with one item of many, and how it is told on one line."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from classical.files import is_temporary

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
    text = words_of(error) if isinstance(error, OSError) else str(error)
    return " ".join(text.split()).removeprefix(f"{path}: ")


def words_of(error: OSError) -> str:
    """File and reason, without the number and without the temporary folder that a file began in."""
    if not error.strerror:
        return str(error)
    if error.filename is None:
        return error.strerror
    parts = Path(os.fsdecode(error.filename)).parts
    return f"{Path(*(part for part in parts if not is_temporary(part)))}: {error.strerror}"

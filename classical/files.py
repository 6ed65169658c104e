"""Files that are written whole or not at all."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path beside `path`, and move it there when the block succeeds.

    The temporary name keeps the suffix of `path`, since writers choose their format by it. The
    move is atomic (same folder, `os.replace`); if the block raises, nothing is left behind and an
    older file at `path` is untouched. Permissions are those of an ordinarily created file.

    Args:
        path: Where the file shall be. Its folder must exist.

    Yields:
        The path to write to; nothing exists there yet.

    Raises:
        FileNotFoundError: If the block succeeded without having written the file.
        OSError: If the folder does not exist or cannot be written to.
    """
    target = Path(path)
    folder = Path(tempfile.mkdtemp(prefix=".writing-", dir=target.parent))
    temporary = folder / target.name
    try:
        yield temporary
        temporary.replace(target)
    finally:
        shutil.rmtree(folder, ignore_errors=True)

"""Files that are written whole or not at all."""

import os
import platform
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_PREFIX = ".writing-"


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
    prefix = f"{_PREFIX}{_host()}-{os.getpid()}-"
    folder = Path(tempfile.mkdtemp(prefix=prefix, dir=target.parent))
    temporary = folder / target.name
    try:
        yield temporary
        temporary.replace(target)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def remove_leftovers(folder: Path) -> None:
    """Remove what `atomic_path` could not, as its process was killed; for this host's processes.

    Args:
        folder: Where files were written. Others' temporary files there stay.
    """
    pattern = re.compile(re.escape(f"{_PREFIX}{_host()}-") + r"(\d+)-")
    for entry in folder.glob(f"{_PREFIX}*"):
        owner = pattern.match(entry.name)
        if owner and not _is_running(int(owner[1])):
            shutil.rmtree(entry, ignore_errors=True)


def is_temporary(name: str) -> bool:
    """True for the name of a folder in which a file is being written."""
    return name.startswith(_PREFIX)


def _host() -> str:
    return re.sub(r"[^A-Za-z0-9]", "", platform.node())[:20]


def _is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # it is there, and somebody else's
        return True
    return True

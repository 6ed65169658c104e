"""What a command looks at before it does anything, so that misuse costs nothing."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import click

from classical.files import remove_leftovers
from classical.warp import is_stmap_name
from hybrid.camera_files import format_suffix
from hybrid.images import is_picture_name


@contextmanager
def misuse() -> Iterator[None]:
    """Turn what the library refuses inside the block into misuse of the command line."""
    try:
        yield
    except ValueError as error:
        raise usage_error(str(error)) from error


def usage_error(message: str) -> click.UsageError:
    """Misuse of the command that is running; to be raised."""
    return click.UsageError(message, click.get_current_context())


def pictures(paths: Iterable[Path]) -> list[Path]:
    """Files as they are, folders as the pictures in them."""
    sources: list[Path] = []
    for path in paths:
        if not path.is_dir():
            sources.append(path)
            continue
        inside = sorted(entry for entry in path.iterdir() if is_picture_name(entry))
        if not inside:
            raise usage_error(f"no pictures in the folder {path}")
        sources += inside
    return list(dict.fromkeys(sources))


def refuse_inputs(outputs: Sequence[Path], inputs: Sequence[Path]) -> None:
    """Misuse if a file to be written is one that is read."""
    read = {os.path.realpath(path) for path in inputs}  # unlike resolve, it bears loops of links
    for path in outputs:
        if os.path.realpath(path) in read:
            raise usage_error(f"{path} is an input; choose another --out")


def refuse_existing(outputs: Sequence[Path], *, overwrite: bool) -> None:
    """Misuse if files would be lost."""
    existing = [] if overwrite else [path for path in outputs if path.exists()]
    if existing:
        more = f" and {len(existing) - 1} more" if len(existing) > 1 else ""
        raise usage_error(f"{existing[0]}{more} exists; use --overwrite to replace")


def check_camera_name(path: Path, kind: str) -> None:
    """Misuse if a file of that name cannot be of that format: ST-maps go by their suffix."""
    is_map = format_suffix(kind) == ".tif"
    if is_map != is_stmap_name(path):
        ending = (
            "ends in .tif or .exr" if is_map else f"is text, such as camera{format_suffix(kind)}"
        )
        raise usage_error(f"a file of the format {kind} {ending}, got {path.name}")


def make_folder(folder: Path) -> None:
    """Make a folder and those above it; clear away what killed commands left half-written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        remove_leftovers(folder)
    except OSError as error:
        raise click.ClickException(f"cannot make the folder {folder}: {error.strerror}") from error

"""Which pictures of a folder have one lens."""

from __future__ import annotations

import hashlib
import os
import re
import struct
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import ExifTags, Image

from hybrid.images import is_picture_name

GROUPINGS = ("exif", "folder", "none")
_BROKEN = (OSError, ValueError, SyntaxError, KeyError, TypeError, struct.error)
_TURNED = (5, 6, 7, 8)  # EXIF orientations that swap width and height
_NAME = 60  # characters of a group's file name


@dataclass(frozen=True)
class Job:
    """A picture and the lens that it belongs to.

    Attributes:
        name: Path below the folder.
        group: What its group has in common, or "" if it is taken alone.
    """

    name: Path
    group: str


def find_pictures(folder: Path, without: Path) -> list[Path]:
    """All pictures in a folder and those below it, as paths below it, in order.

    Links to folders are not followed.

    Args:
        folder: Where to look.
        without: A folder that is left out, such as the one for the results.
    """
    found: list[Path] = []
    left_out = without.resolve()
    for root, folders, names in os.walk(folder):
        here = Path(root)
        folders[:] = sorted(
            name for name in folders if name[0] != "." and (here / name).resolve() != left_out
        )
        found += [(here / name).relative_to(folder) for name in names if is_picture_name(name)]
    return sorted(found)


def group_key(path: Path, name: Path, group_by: str) -> str:
    """What a picture has in common with those of the same lens; "" if nothing is known.

    Args:
        path: The picture.
        name: Its path below the folder.
        group_by: "exif": camera, lens and focal length of the EXIF data; "folder": the folder that
            it is in; "none": nothing. Pictures of one group have one size.
    """
    if group_by == "none":
        return ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of Pillow, about size and odd metadata
            with Image.open(path) as image:
                exif = image.getexif()
                size = image.size
                details = dict(exif.get_ifd(ExifTags.IFD.Exif))
    except (*_BROKEN, Image.DecompressionBombError):
        return ""  # what is wrong with it shows when it is read
    turned = exif.get(ExifTags.Base.Orientation) in _TURNED
    shape = "x".join(map(str, reversed(size) if turned else size))
    if group_by == "folder":
        return f"{name.parent.as_posix()} {shape}"
    lens = list(_lens(exif, details))
    return " ".join([*lens, shape]) if lens else ""


def group_file(group: str) -> str:
    """A file name for the lens of a group, without its ending."""
    readable = re.sub(r"[^A-Za-z0-9]+", "-", group).strip("-")[:_NAME]
    return f"{readable}-{hashlib.sha256(group.encode(errors='replace')).hexdigest()[:8]}"


def sampled(jobs: Iterable[Job], count: int) -> dict[str, list[Job]]:
    """For each group at most so many of its pictures, spread evenly; groups in order of name."""
    members: dict[str, list[Job]] = {}
    for job in jobs:
        if job.group:
            members.setdefault(job.group, []).append(job)
    spread = {}
    for group, all_jobs in sorted(members.items()):
        n_taken = min(count, len(all_jobs))
        step = len(all_jobs) / n_taken
        spread[group] = [all_jobs[int((i + 0.5) * step)] for i in range(n_taken)]
    return spread


def _lens(exif: Any, details: dict[int, Any]) -> Iterator[str]:
    """The words of EXIF that tell a lens; none if the camera is not named."""
    base = ExifTags.Base
    camera = [str(exif.get(tag, "")).strip("\0 ") for tag in (base.Make, base.Model)]
    if not any(camera):
        return
    yield from (word for word in camera if word)
    if lens := str(details.get(base.LensModel, "")).strip("\0 "):
        yield lens
    try:
        yield f"{float(details[base.FocalLength]):.2f}mm"
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return

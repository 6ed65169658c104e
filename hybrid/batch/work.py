"""What the workers of a batch do: find the lens of a group, straighten one picture.

Functions of a module and plain data only, as they run in other processes and on other hosts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from classical.camera import KannalaBrandt
from hybrid.arrays import unit_range
from hybrid.batch.groups import Job, group_file, group_key
from hybrid.camera_files import CameraFile, write_camera
from hybrid.config import RectifyConfig
from hybrid.exif import straight_exif
from hybrid.failures import ITEM_ERRORS, reason_of
from hybrid.images import Picture, read_picture, write_picture
from hybrid.pipeline import calibrate, rectify

Fields = dict[str, Any]
LENSES = "lenses"  # folder of the groups' camera files
_SAMPLE_PIXELS = 150_000_000  # of all pictures that a lens is found from, so that memory is bounded


@dataclass(frozen=True)
class Workplace:
    """What all tasks of a batch share.

    Attributes:
        folder: Where the pictures are.
        out: Where the results go.
        config: Method and frame.
    """

    folder: Path
    out: Path
    config: RectifyConfig


@dataclass(frozen=True)
class Task:
    """A picture to straighten.

    Attributes:
        job: The picture and its group.
        camera: The lens of the group; None lets the picture tell its own.
    """

    job: Job
    camera: KannalaBrandt | None


def classified(place: Workplace, group_by: str, name: Path) -> Job:
    """The job of a picture."""
    return Job(name, group_key(place.folder / name, name, group_by))


def find_lens(place: Workplace, sample: Sequence[Job]) -> Fields:
    """Find the lens of a group from a sample of its pictures and write its camera file."""
    group = sample[0].group
    pictures, names = _readable(place, sample)
    fields: Fields = {"group": group, "sample": names, "camera_file": None}
    if not pictures:
        return fields | {"status": "failed", "reason": "no picture of its sample can be read"}
    try:
        found = calibrate(pictures, place.config)
        fields |= {"status": found.status, "reason": found.reason}
        if found.camera is None:
            return fields
        content = CameraFile(found.camera, found.status, found.reason, found.quality)
        name = f"{LENSES}/{group_file(group)}.camera.json"
        (place.out / LENSES).mkdir(parents=True, exist_ok=True)
        write_camera(place.out / name, content)
    except ITEM_ERRORS as error:
        return fields | {"status": "failed", "reason": reason_of(error, place.out)}
    return fields | {"camera_file": name}


def straighten(place: Workplace, task: Task) -> Fields:
    """Straighten a picture and write it, whole or not at all; what goes wrong is in the result."""
    source, out = place.folder / task.job.name, place.out / task.job.name
    fields: Fields = {"input": task.job.name.as_posix(), "group": task.job.group}
    try:
        stat = source.stat()
        fields |= {"bytes": stat.st_size, "mtime_ns": stat.st_mtime_ns}
        picture = read_picture(source)
        pixels = unit_range(picture.pixels)
        result = rectify(pixels, place.config, camera=task.camera, throw=False)
        fields |= {"status": result.status, "reason": result.reason}
        if result.status == "failed":
            return fields
        out.parent.mkdir(parents=True, exist_ok=True)
        exif = picture.exif
        if result.camera is not None and result.target is not None:
            exif = straight_exif(exif, result.camera, result.target)
        write_picture(out, Picture(result.image, picture.icc, exif))
        fields["output"] = task.job.name.as_posix()
        if task.camera is None and result.camera is not None:
            content = CameraFile(result.camera, result.status, result.reason, result.quality)
            beside = out.with_name(f"{out.name}.camera.json")
            write_camera(beside, content)
            fields["camera_file"] = beside.relative_to(place.out).as_posix()
    except ITEM_ERRORS as error:
        return fields | {"status": "failed", "reason": reason_of(error, source)}
    return fields


def _readable(place: Workplace, sample: Sequence[Job]) -> tuple[list[np.ndarray], list[str]]:
    """The pictures of a sample that can be read, up to a bound, and their names."""
    pictures: list[np.ndarray] = []
    names: list[str] = []
    for job in sample:
        try:
            pixels = unit_range(read_picture(place.folder / job.name).pixels)
        except ITEM_ERRORS:
            continue  # told when its turn comes
        total = sum(picture.shape[0] * picture.shape[1] for picture in pictures)
        if pictures and total + pixels.shape[0] * pixels.shape[1] > _SAMPLE_PIXELS:
            break
        if not pictures or pictures[0].shape[:2] == pixels.shape[:2]:
            pictures.append(pixels)
            names.append(job.name.as_posix())
    return pictures, names

"""The files that the page hands out, made in memory under names of ours."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from classical.camera.formats import CAMERA_FORMATS
from hybrid.arrays import to_rgb8
from hybrid.camera_files import (
    OWN_FORMAT,
    CameraFile,
    format_names,
    format_suffix,
    write_camera,
)
from hybrid.config import RectifyConfig
from hybrid.images import write_picture
from hybrid.web.exhibit import Exhibit, View

_ALL_DEPTHS = ("uint8", "uint16", "float32")
_PICTURES = {
    "straight.jpg": ("JPEG", "image/jpeg", _ALL_DEPTHS),
    "straight.png": ("PNG", "image/png", ("uint8", "uint16")),
    "straight.tif": ("TIFF", "image/tiff", _ALL_DEPTHS),
}
_TYPES = {".json": "application/json", ".tif": "image/tiff"}
_TITLES = {row.name: row.title for row in CAMERA_FORMATS} | {
    OWN_FORMAT: "Straightlens, with how far to trust it",
    "stmap": "ST-map to straighten, this view",
    "stmap-redistort": "ST-map to bend again, this view",
}


@dataclass(frozen=True)
class Offer:
    """A file that can be had.

    Attributes:
        name: As it is asked for.
        title: What it is, in a few words.
        media_type: Of the file.
        kind: The camera format, or None for a picture.
    """

    name: str
    title: str
    media_type: str
    kind: str | None = None


def offered(exhibit: Exhibit) -> dict[str, Offer]:
    """The files that can be made of a picture, by name; none without a lens."""
    if exhibit.camera is None:
        return {}
    depth = exhibit.picture.pixels.dtype.name
    pictures = [
        Offer(name, title, media_type)
        for name, (title, media_type, depths) in _PICTURES.items()
        if depth in depths
    ]
    return {offer.name: offer for offer in [*pictures, *_cameras()]}


def make_file(exhibit: Exhibit, offer: Offer, view: View) -> bytes:
    """One of the files that are offered.

    Args:
        exhibit: A picture with its lens.
        offer: One of `offered`.
        view: What a straight picture or an ST-map shows.

    Raises:
        ValueError: If the lens cannot be shown or written so.
    """
    if offer.kind is None:
        picture = exhibit.straight_picture(view)
        if offer.name.endswith(".jpg") and picture.pixels.dtype != np.uint8:
            picture = replace(picture, pixels=to_rgb8(picture.pixels))
        return _written(offer.name, lambda path: write_picture(path, picture))
    found, kind = exhibit.found, offer.kind
    assert found is not None  # as it is offered
    assert found.camera is not None
    content = CameraFile(found.camera, found.status, found.reason, found.quality)
    frame = RectifyConfig(fov=view.fov, balance=view.balance)
    return _written(offer.name, lambda path: write_camera(path, content, kind, frame=frame))


def _cameras() -> list[Offer]:
    return [
        Offer(
            f"camera{'' if kind == OWN_FORMAT else f'.{kind}'}{format_suffix(kind)}",
            _TITLES.get(kind, kind),
            _TYPES.get(format_suffix(kind), "text/plain"),
            kind,
        )
        for kind in format_names()
    ]


def _written(name: str, write: Callable[[Path], object]) -> bytes:
    """What a writer of files writes."""
    with tempfile.TemporaryDirectory(prefix="straightlens-") as folder:
        path = Path(folder) / name
        write(path)
        return path.read_bytes()

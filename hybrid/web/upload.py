"""How uploaded bytes become a picture, within limits."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from hybrid.arrays import check_image, unit_range
from hybrid.images import Picture, read_picture

_SIGNATURES = {
    "JPEG": (b"\xff\xd8\xff",),
    "PNG": (b"\x89PNG\r\n\x1a\n",),
    "TIFF": (b"II*\0", b"MM\0*"),
    "BMP": (b"BM",),
}


@dataclass(frozen=True)
class Limits:
    """What the page takes in and keeps.

    Attributes:
        max_bytes: Of one uploaded file.
        max_pixels: Of one picture; larger ones are refused before they are decoded.
        max_kept: Pictures in memory; the one that was looked at longest ago goes first.
        max_age: Seconds after which a picture that nobody looks at is forgotten.
    """

    max_bytes: int = 64 * 2**20
    max_pixels: int = 50_000_000
    max_kept: int = 6
    max_age: float = 3600.0

    def __post_init__(self) -> None:
        for name in ("max_bytes", "max_pixels", "max_kept", "max_age"):
            if not getattr(self, name) > 0:
                raise ValueError(f"Expected {name} > 0, got {getattr(self, name)}.")


def picture_from_bytes(data: bytes, limits: Limits) -> Picture:
    """Decode an uploaded file.

    The client's name for it plays no part: the type is told by the first bytes.

    Args:
        data: The file.
        limits: Of size and pixels.

    Raises:
        ValueError: If it is too large, of another type, or broken; the message is one line.
    """
    if len(data) > limits.max_bytes:
        raise ValueError(f"Expected a file of at most {limits.max_bytes / 2**20:g} MiB.")
    if not _is_known(data):
        raise ValueError("Expected a JPEG, PNG, WebP, TIFF or BMP picture, got something else.")
    with tempfile.TemporaryDirectory(prefix="straightlens-") as folder:
        path = Path(folder) / "upload"
        path.write_bytes(data)
        try:
            picture = read_picture(path, max_pixels=limits.max_pixels)
        except ValueError as error:
            raise ValueError(str(error).replace(f"{path}: ", "")) from None
    pixels = unit_range(picture.pixels)
    check_image(pixels)
    return Picture(pixels, picture.icc, picture.exif)


def _is_known(data: bytes) -> bool:
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return True
    return any(data.startswith(mark) for marks in _SIGNATURES.values() for mark in marks)

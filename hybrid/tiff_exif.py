"""EXIF of TIFF files, which has no block of its own there: tags of the picture and two directories.

What describes the photograph is kept; what describes the file (size, strips, compression) is not.
"""

from __future__ import annotations

import struct
from pathlib import Path

from PIL import ExifTags, Image, TiffImagePlugin

_ASCII = 2
_LONG = 4
# tags of the first directory that tell of the photograph: EXIF 2.32, 4.6.4, and what cameras add
_DESCRIPTIVE = (
    ExifTags.Base.ImageDescription,
    ExifTags.Base.Make,
    ExifTags.Base.Model,
    ExifTags.Base.Software,
    ExifTags.Base.DateTime,
    ExifTags.Base.Artist,
    ExifTags.Base.HostComputer,
    ExifTags.Base.Rating,
    ExifTags.Base.Copyright,
)
_DIRECTORIES = (ExifTags.IFD.Exif, ExifTags.IFD.GPSInfo)


def described(exif: Image.Exif) -> bytes | None:
    """EXIF of what a TIFF's first page tells of the photograph, or None if that is nothing."""
    kept = Image.Exif()
    for tag in _DESCRIPTIVE:
        if tag in exif:
            kept[tag] = exif[tag]
    for directory in _DIRECTORIES:
        values = exif.get_ifd(directory)
        if values:
            kept.get_ifd(directory).update(values)
            kept[directory] = 0  # a place for its offset
    return kept.tobytes() if len(kept) else None


def append_exif(path: Path, data: bytes) -> None:
    """Put EXIF into a TIFF file that `extra_tags` made room in.

    Args:
        path: A little-endian TIFF of less than 4 GiB.
        data: EXIF as in a JPEG.
    """
    import tifffile  # here, as most pictures need none

    exif = Image.Exif()
    exif.load(data)
    with tifffile.TiffFile(path) as tiff:
        places = {tag.code + 1: tag.offset for tag in tiff.pages.first.tags}
    with path.open("r+b") as file:
        for directory in _DIRECTORIES:
            values = exif.get_ifd(directory)
            if not values:
                continue
            entries = TiffImagePlugin.ImageFileDirectory_v2(prefix=b"II")
            for tag, value in values.items():
                entries[tag] = value
            offset = file.seek(0, 2)
            offset += offset % 2
            file.seek(offset)
            file.write(entries.tobytes(offset))
            file.seek(places[int(directory)])
            file.write(struct.pack("<HHII", directory, _LONG, 1, offset))


def extra_tags(data: bytes) -> list[tuple[int, int, int, str | int, bool]]:
    """Tags for `tifffile.imwrite`: texts of the first directory, and room for the others."""
    exif = Image.Exif()
    exif.load(data)
    tags: list[tuple[int, int, int, str | int, bool]] = []
    for tag in _DESCRIPTIVE:
        value = exif.get(tag)
        if isinstance(value, str):
            tags.append((int(tag), _ASCII, 0, value, True))
    # tifffile refuses to write the directories' own numbers; the ones before them hold the place
    tags.extend((int(d) - 1, _LONG, 1, 0, True) for d in _DIRECTORIES if exif.get_ifd(d))
    return tags

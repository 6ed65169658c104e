"""EXIF of a straightened picture: what the straightening changed is said, the rest is kept."""

from __future__ import annotations

import math
import struct
from typing import Any

from PIL import ExifTags, Image

from classical.camera import KannalaBrandt, Pinhole

_FULL_FRAME_DIAGONAL = math.hypot(36.0, 24.0)  # millimetres
_RECTILINEAR = "rectilinear by Straightlens"
_BROKEN = (OSError, ValueError, SyntaxError, KeyError, TypeError, struct.error)


def straight_exif(exif: bytes | None, camera: KannalaBrandt, target: Pinhole) -> bytes | None:
    """EXIF data for the straight picture.

    The lens model says that the picture is rectilinear, the focal lengths are those of the straight
    frame (also as equivalent of 35 mm film, by the diagonal), the size is the new one; the
    thumbnail, which shows the bent picture, goes. Programs for structure from motion start from
    these tags.

    Args:
        exif: EXIF data of the input as bytes, or None.
        camera: Its lens.
        target: The camera of the straight picture.

    Returns:
        The data as bytes; None where there was none, and what cannot be parsed as it was.
    """
    if exif is None:
        return None
    data = Image.Exif()
    try:
        data.load(exif)
        _update(data, camera, target)
        return data.tobytes()
    except _BROKEN:
        return exif


def _update(data: Image.Exif, camera: KannalaBrandt, target: Pinhole) -> None:
    details: dict[int, Any] = data.get_ifd(ExifTags.IFD.Exif)
    base = ExifTags.Base
    name = str(details.get(base.LensModel, "")).strip("\0 ")
    if _RECTILINEAR not in name:
        details[base.LensModel] = f"{name} ({_RECTILINEAR})" if name else _RECTILINEAR
    diagonal = math.hypot(target.width, target.height)
    details[base.FocalLengthIn35mmFilm] = round(target.focal_u * _FULL_FRAME_DIAGONAL / diagonal)
    if base.FocalLength in details:
        # the same width of sensor; the lens's own focal length is that on its axis
        zoom = (target.focal_u / target.width) / (camera.k[0] * camera.m_u / camera.width)
        details[base.FocalLength] = float(details[base.FocalLength]) * float(zoom)
    details[base.ExifImageWidth], details[base.ExifImageHeight] = target.width, target.height
    data.get_ifd(ExifTags.IFD.IFD1).clear()

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
        return _updated(data, camera, target).tobytes()
    except _BROKEN:
        return exif


def _updated(data: Image.Exif, camera: KannalaBrandt, target: Pinhole) -> Image.Exif:
    """A copy without the thumbnail, for it is no part of what is iterated over."""
    out = Image.Exif()
    for tag, value in data.items():
        out[tag] = value
    if ExifTags.IFD.GPSInfo in data:
        out[ExifTags.IFD.GPSInfo] = dict(data.get_ifd(ExifTags.IFD.GPSInfo))
    details: dict[int, Any] = dict(data.get_ifd(ExifTags.IFD.Exif))
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
    out[ExifTags.IFD.Exif] = details
    return out

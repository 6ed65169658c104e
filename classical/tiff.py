"""The first page of a TIFF file in its own depth, within bounds, or a ValueError.

Files are hostile until they are read: a page is refused by its size before it is decoded, and what
is compressed goes through libtiff, which never unpacks more than the page holds.
"""

from __future__ import annotations

import os

import cv2
import numpy as np
from jaxtyping import Shaped

MAX_PIXELS = 178_956_970  # half a gigabyte of RGB; Pillow's own limit against bombs
_MAX_CHANNELS = 4
_RGB, _RGBA = [2, 1, 0], [2, 1, 0, 3]  # of OpenCV's order


def read_tiff(
    path: str | os.PathLike[str], *, max_pixels: int
) -> tuple[Shaped[np.ndarray, "..."], bytes | None]:
    """Read the first page.

    Args:
        path: The file.
        max_pixels: Refuse larger pages, and more than four channels of so many.

    Returns:
        Pixels, (h, w) or (h, w, c) in any depth, and the colour profile.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If it is no TIFF, broken or too large.
    """
    import tifffile  # here, as most pictures need none

    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages.first
            flat = page.imagewidth * page.imagelength
            if flat > max_pixels or page.size > _MAX_CHANNELS * max_pixels:
                raise ValueError(f"more than {max_pixels} pixels")
            icc = page.iccprofile
            if page.compression == tifffile.COMPRESSION.NONE:
                return _interleaved(page.asarray()), icc
            if page.planarconfig == tifffile.PLANARCONFIG.SEPARATE and page.samplesperpixel > 1:
                raise ValueError("planes that are apart and compressed")
            return _by_libtiff(path, page.imagewidth, page.imagelength), icc
    except (OSError, MemoryError):
        raise
    except Exception as error:  # whatever a broken file makes the parsers raise
        words = str(error) if isinstance(error, ValueError) else ""
        reason = " ".join(words.split()) or "it is broken"
        raise ValueError(f"not a TIFF that can be read: {reason}") from error


def _interleaved(pixels: np.ndarray) -> np.ndarray:
    """Planes that are apart, put together."""
    apart = pixels.ndim == 3 and pixels.shape[2] not in (1, 3, 4) and pixels.shape[0] in (3, 4)
    return np.moveaxis(pixels, 0, -1) if apart else pixels


def _by_libtiff(path: str | os.PathLike[str], width: int, height: int) -> np.ndarray:
    pixels = cv2.imread(os.fspath(path), cv2.IMREAD_UNCHANGED)
    if pixels is None or pixels.shape[:2] != (height, width):
        raise ValueError("libtiff cannot decode it")
    if pixels.ndim == 3 and pixels.shape[2] in (3, 4):
        return np.ascontiguousarray(pixels[..., _RGB if pixels.shape[2] == 3 else _RGBA])
    return pixels

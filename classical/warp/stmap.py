"""ST-maps: warps as 32-bit pictures that compositing programs (Nuke, DaVinci Resolve) read.

Red is the column and green the row in the source, divided by its size, with pixel centres at
(i + 0.5) / n and the origin in the bottom-left corner; blue is 1 where the source has a pixel.
A note in the header (ImageDescription of TIFF, `straightlens` of EXR) can name the camera.
"""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from classical.files import atomic_path
from classical.tiff import MAX_PIXELS, read_tiff
from classical.warp.maps import OUTSIDE, WarpMaps

_SUFFIXES = (".tif", ".tiff", ".exr")
_CHANNELS = ("R", "G", "B")
_NOTE = "straightlens"  # attribute of EXR


def write_stmap(path: str | os.PathLike[str], maps: WarpMaps, note: str = "") -> None:
    """Write a map as a 32-bit float RGB file, TIFF or EXR by its suffix.

    Args:
        path: Ends in .tif, .tiff or .exr; the last needs the package OpenEXR.
        maps: The map; `undistort_maps` for straightening, `distort_maps` for the way back.
        note: Text in ASCII for the header.

    Raises:
        ValueError: If the suffix is another, or OpenEXR is not installed.
    """
    import tifffile  # here, as most pictures need none

    suffix = _suffix(path)
    red = (maps.u + np.float32(0.5)) / maps.source_width
    green = 1 - (maps.v + np.float32(0.5)) / maps.source_height
    pixels = np.stack([red, green, np.ones_like(red)], axis=-1).astype(np.float32)
    pixels[~maps.valid] = 0
    with atomic_path(path) as temporary:
        if suffix == ".exr":
            _write_exr(temporary, pixels, note)
        else:
            options = {"photometric": "rgb", "compression": "zlib", "metadata": None}
            tifffile.imwrite(temporary, pixels, description=note or None, **options)


def read_stmap(path: str | os.PathLike[str], source_width: int, source_height: int) -> WarpMaps:
    """Read a map back.

    Args:
        path: A file as `write_stmap` makes it.
        source_width: Width in pixels of the picture that the map is for.
        source_height: Height in pixels of the picture that the map is for.

    Raises:
        ValueError: If the file is no 32-bit RGB picture.
    """
    suffix = _suffix(path)
    try:
        if suffix == ".exr":
            pixels = _read_exr(Path(path))
        else:
            pixels, _ = read_tiff(path, max_pixels=MAX_PIXELS)
    except (RuntimeError, KeyError, ValueError) as error:
        raise ValueError(f"Expected a 32-bit RGB file, got {path}: {error}") from error
    if pixels.ndim != 3 or pixels.shape[2] < 3 or pixels.dtype != np.float32:
        raise ValueError(
            f"Expected 32-bit float RGB in {path}, got {pixels.dtype} of shape {pixels.shape}."
        )
    valid = pixels[..., 2] > 0.5
    u = pixels[..., 0] * np.float32(source_width) - np.float32(0.5)
    v = (1 - pixels[..., 1]) * np.float32(source_height) - np.float32(0.5)
    outside = np.float32(OUTSIDE)
    u, v = np.where(valid, u, outside), np.where(valid, v, outside)
    return WarpMaps(u, v, valid, source_width, source_height)


def read_stmap_note(path: str | os.PathLike[str]) -> str:
    """The note in the header of an ST-map; empty where there is none.

    Args:
        path: A file as `write_stmap` makes it.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no EXR or TIFF.
    """
    import tifffile  # here, as most pictures need none

    try:
        if _suffix(path) == ".exr":
            with _opened_exr(Path(path), header_only=True) as file:
                return str(file.header().get(_NOTE, ""))
        with tifffile.TiffFile(path) as file:
            return file.pages.first.description
    except OSError:
        raise
    except Exception as error:  # whatever a broken file makes the parsers raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"Expected an ST-map, got {path}: {reason}") from error


def is_stmap_name(path: str | os.PathLike[str]) -> bool:
    """True where the suffix is one of an ST-map."""
    return Path(path).suffix.lower() in _SUFFIXES


def _suffix(path: str | os.PathLike[str]) -> str:
    suffix = Path(path).suffix.lower()
    if suffix not in _SUFFIXES:
        raise ValueError(f"Expected a file name ending in {', '.join(_SUFFIXES)}, got {path}.")
    return suffix


def _write_exr(path: Path, pixels: np.ndarray, note: str) -> None:
    OpenEXR = _open_exr()
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    if note:
        header[_NOTE] = note
    planes = {name: np.ascontiguousarray(pixels[..., i]) for i, name in enumerate(_CHANNELS)}
    with OpenEXR.File(header, planes) as file:
        file.write(str(path))


def _read_exr(path: Path) -> np.ndarray:
    with _opened_exr(path, header_only=True) as file:
        low, high = file.header()["dataWindow"]
    if (int(high[0]) - int(low[0]) + 1) * (int(high[1]) - int(low[1]) + 1) > MAX_PIXELS:
        raise ValueError(f"more than {MAX_PIXELS} pixels")
    with _opened_exr(path, header_only=False) as file:
        channels = file.channels()
        return np.stack([channels[name].pixels for name in _CHANNELS], axis=-1)


def _opened_exr(path: Path, *, header_only: bool) -> Any:
    OpenEXR = _open_exr()
    if not path.is_file():
        raise FileNotFoundError(f"No such file: {path}")
    return OpenEXR.File(str(path), separate_channels=True, header_only=header_only)


def _open_exr() -> ModuleType:
    """The package that reads and writes EXR, an optional extra."""
    try:
        import OpenEXR
    except ImportError as error:
        raise ValueError(
            "Expected the package OpenEXR for .exr files: pip install 'straightlens[exr]', "
            "or use .tif."
        ) from error
    return OpenEXR

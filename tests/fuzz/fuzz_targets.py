"""Readers of files that come from elsewhere: seeds to start from, and what must hold of any input.

A reader gives a value that can be used, or a ValueError of one line. Anything else is a finding.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from PIL import ExifTags, Image

from classical.camera import KannalaBrandt
from classical.warp import pinhole_target, undistort_maps, write_stmap
from hybrid.arrays import check_image, unit_range
from hybrid.camera_files import (
    CameraFile,
    Quality,
    format_names,
    format_suffix,
    read_camera,
    write_camera,
)
from hybrid.images import read_picture, write_picture

MAX_PIXELS = 1 << 18
LENS = KannalaBrandt.centred(np.array([0.9, -0.05, 0.004, 0.0, 0.0]), 64, 48)
RAYS = np.array([[0.0, 0.0, 1.0], [0.3, -0.2, 1.0], [1.0, 1.0, 0.0]])
Target = Callable[[bytes, Path], bool]


def picture(data: bytes, folder: Path) -> bool:
    """Any bytes as a picture; True where they are one."""
    path = folder / "picture"
    path.write_bytes(data)
    try:
        read = read_picture(path, max_pixels=MAX_PIXELS)
        pixels = unit_range(read.pixels)
        check_image(pixels)
    except ValueError as error:
        _one_line(error)
        return False
    assert pixels.shape[0] * pixels.shape[1] <= MAX_PIXELS
    again = folder / ("again.tif" if pixels.dtype == np.float32 else "again.png")
    write_picture(again, read)
    expected = read.pixels[..., 0] if read.pixels.shape[2:] == (1,) else read.pixels
    np.testing.assert_array_equal(read_picture(again).pixels, expected)
    return True


def camera(data: bytes, folder: Path) -> bool:
    """Any bytes as a camera file in text; True where they are one."""
    return _camera(data, folder / "lens.json")


def stmap_tif(data: bytes, folder: Path) -> bool:
    """Any bytes as an ST-map in TIFF with the lens in its header."""
    return _camera(data, folder / "lens.tif")


def stmap_exr(data: bytes, folder: Path) -> bool:
    """Any bytes as an ST-map in EXR with the lens in its header."""
    return _camera(data, folder / "lens.exr")


TARGETS: dict[str, Target] = {
    "picture": picture,
    "camera": camera,
    "stmap_tif": stmap_tif,
    "stmap_exr": stmap_exr,
}


def _camera(data: bytes, path: Path) -> bool:
    path.write_bytes(data)
    read = None
    for name in (None, "cam0", "1"):
        try:
            read = read_camera(path, name)
        except ValueError as error:
            _one_line(error)
    if read is None:
        return False
    points, valid = read.camera.project(RAYS)
    assert np.isfinite(points[valid]).all() or not np.isfinite(read.camera.to_vector()).all()
    again = path.with_name("again.json")
    write_camera(again, read)
    assert read_camera(again).camera == read.camera
    return True


def _one_line(error: ValueError) -> None:
    assert str(error)
    assert "\n" not in str(error), error


# ---- seeds ------------------------------------------------------------------------------------


def seeds(target: str, folder: Path) -> list[bytes]:
    """Small good files to start from."""
    makers = {
        "picture": _pictures,
        "camera": _cameras,
        "stmap_tif": lambda folder: _maps(folder, ".tif"),
        "stmap_exr": lambda folder: _maps(folder, ".exr"),
    }
    return makers[target](folder)


def _pictures(folder: Path) -> list[bytes]:
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6
    exif[ExifTags.Base.Make] = "Maker"
    found = []
    kinds = ["PNG", "JPEG", "WEBP", "TIFF", "BMP", "GIF", "PPM", "JPEG2000"]
    for mode in ("L", "RGB", "RGBA", "P", "1", "I;16", "CMYK", "LA"):
        for kind in kinds:
            stream = io.BytesIO()
            options = {"exif": exif} if kind in ("PNG", "JPEG", "WEBP") else {}
            try:
                Image.new(mode, (9, 7)).save(stream, kind, **options)
            except (OSError, KeyError, ValueError):
                continue  # this format knows no such mode
            found.append(stream.getvalue())
    rng = np.random.default_rng(0)
    for scale, dtype in ((60000, "uint16"), (1, "float32")):
        pixels = (rng.random((7, 9, 3)) * scale).astype(dtype)
        planes = np.moveaxis(pixels, -1, 0).copy()
        found += [
            _tiff(pixels),
            _tiff(pixels, compression="zlib"),
            _tiff(planes, planarconfig="separate"),
        ]
    return found


def _tiff(pixels: np.ndarray, **options: Any) -> bytes:
    stream = io.BytesIO()
    tifffile.imwrite(stream, pixels, photometric="rgb", **options)
    return stream.getvalue()


def _cameras(folder: Path) -> list[bytes]:
    found = []
    for kind in format_names():
        if kind.startswith("stmap"):
            continue
        path = folder / f"seed{format_suffix(kind)}"
        write_camera(path, CameraFile(LENS, "ok", "seed", Quality()), kind)
        found.append(path.read_bytes())
    return found


def _maps(folder: Path, suffix: str) -> list[bytes]:
    small = LENS.resized(8, 6)
    noted, bare = folder / f"noted{suffix}", folder / f"bare{suffix}"
    write_camera(noted, CameraFile(small, "ok", "seed", Quality()), "stmap")
    write_stmap(bare, undistort_maps(small, pinhole_target(small)))
    return [noted.read_bytes(), bare.read_bytes()]

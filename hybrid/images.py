"""Picture files: read upright, written whole, with their colour profile and EXIF kept."""

from __future__ import annotations

import os
import stat
import struct
import warnings
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Shaped
from PIL import ExifTags, Image, TiffImagePlugin, UnidentifiedImageError

from classical.files import atomic_path
from classical.tiff import MAX_PIXELS, read_tiff
from hybrid.tiff_exif import append_exif, described, extra_tags

_TIFF = (".tif", ".tiff")
_FORMATS = {
    ".png": "PNG",
    ".jpg": "JPEG",
    ".jpeg": "JPEG",
    ".webp": "WEBP",
    ".bmp": "BMP",
    ".tif": "TIFF",
    ".tiff": "TIFF",
}
SUFFIXES = tuple(_FORMATS)
# read by their content; not what Pillow hands to other programs (EPS) or parses by trial
_READABLE = [*_FORMATS.values(), "GIF", "PPM", "JPEG2000", "AVIF"]
_SAVE_OPTIONS = {
    "JPEG": {"quality": 95, "subsampling": 0},
    "WEBP": {"quality": 95},
    "PNG": {"compress_level": 4},
}
# EXIF orientation → whether to swap the axes first, then which axes to reverse
_ORIENTATIONS = {
    2: (False, (1,)),
    3: (False, (0, 1)),
    4: (False, (0,)),
    5: (True, ()),
    6: (True, (1,)),
    7: (True, (0, 1)),
    8: (True, (0,)),
}


@dataclass(frozen=True, eq=False)
class Picture:
    """The pixels of a picture file and what has to stay with them.

    Attributes:
        pixels: Grey (h, w), RGB (h, w, 3) or RGBA (h, w, 4); uint8, uint16 or float32; upright.
        icc: The colour profile, or None.
        exif: EXIF data without the orientation, which is in the pixels already, or None.
    """

    pixels: Shaped[np.ndarray, "..."]
    icc: bytes | None = None
    exif: bytes | None = None


def is_picture_name(path: str | os.PathLike[str]) -> bool:
    """True where the suffix is one that can be read and written."""
    return Path(path).suffix.lower() in _FORMATS


def read_picture(path: str | os.PathLike[str], *, max_pixels: int = MAX_PIXELS) -> Picture:
    """Read a picture file and turn it upright.

    Args:
        path: PNG, JPEG, WebP, TIFF, BMP, or another of the usual pictures; told by its content.
        max_pixels: Refuse larger pictures before decoding them.

    Raises:
        FileNotFoundError: If there is no such file.
        PermissionError: If it must not be read.
        ValueError: If it is no picture, is cut off, or is too large; the message is one line.
    """
    path = Path(path)
    kind = path.stat().st_mode
    if not stat.S_ISREG(kind) and not stat.S_ISDIR(kind):  # a pipe would be waited for
        raise ValueError(f"{path}: not a regular file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of Pillow, about size and odd metadata
            try:
                with Image.open(path, formats=_READABLE) as image:
                    _check_size(image.width, image.height, max_pixels)
                    return _read_open(path, image, max_pixels)
            except UnidentifiedImageError:
                if not _begins_as_tiff(path):
                    raise ValueError("not a picture that can be read") from None
                return _read_tiff_alone(path, max_pixels)
    except (FileNotFoundError, PermissionError, IsADirectoryError, MemoryError):
        raise
    except Image.DecompressionBombError:
        raise ValueError(f"{path}: more than {max_pixels} pixels") from None
    except Exception as error:  # whatever a broken file makes a decoder raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{path}: {reason.replace(str(path), 'the file')}") from error


def write_picture(path: str | os.PathLike[str], picture: Picture) -> None:
    """Write a picture file, whole or not at all; the format is that of the suffix.

    Args:
        path: Ends in one of `SUFFIXES`; uint16 needs PNG or TIFF, float32 needs TIFF.
        picture: Pixels and metadata.

    Raises:
        ValueError: If the format cannot hold such pixels.
        OSError: If the file cannot be written.
    """
    path = Path(path)
    suffix, pixels = path.suffix.lower(), picture.pixels
    if suffix not in _FORMATS:
        raise ValueError(f"Expected a file name ending in {', '.join(SUFFIXES)}, got {path.name}.")
    if pixels.ndim == 3 and pixels.shape[2] == 1:
        pixels = pixels[..., 0]
    allowed = {"uint8": SUFFIXES, "uint16": (".png", *_TIFF), "float32": _TIFF}
    if suffix not in allowed.get(pixels.dtype.name, ()):
        raise ValueError(f"Expected another format for {pixels.dtype} pixels, got {path.name}.")
    if suffix in (".jpg", ".jpeg", ".bmp") and pixels.ndim == 3:
        pixels = pixels[..., :3]  # no alpha there
    picture = Picture(np.ascontiguousarray(pixels), picture.icc, picture.exif)
    with atomic_path(path) as temporary:
        if pixels.dtype == np.uint8 or (suffix == ".png" and pixels.ndim == 2):
            _write_by_pillow(temporary, picture, _FORMATS[suffix])
        elif suffix == ".png":
            _write_deep_png(temporary, picture)
        else:
            _write_deep_tiff(temporary, picture)


def _begins_as_tiff(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(4) in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def _check_size(width: int, height: int, max_pixels: int) -> None:
    if width * height > max_pixels:
        raise Image.DecompressionBombError
    if min(width, height) < 1:
        raise ValueError("the picture is empty")


def _read_tiff_alone(path: Path, max_pixels: int) -> Picture:
    """A file that Pillow does not know: RGB of 32 bits a channel, or no picture."""
    pixels, icc = _deep_tiff(path, max_pixels)
    with path.open("rb") as stream:
        exif = Image.Exif()
        exif.load_from_fp(stream)
        return Picture(pixels, icc, _kept(exif, is_tiff=True))


def _read_open(path: Path, image: Image.Image, max_pixels: int) -> Picture:
    """Decode an opened file."""
    image.load()  # complains where the file is cut off
    exif = image.getexif()
    orientation = exif.pop(ExifTags.Base.Orientation, 1)
    pixels, icc = _pixels(path, image, max_pixels), image.info.get("icc_profile")
    if image.mode == "CMYK":
        icc = None  # of the inks, not of the RGB that they became
    swap, flips = _ORIENTATIONS.get(orientation, (False, ()))
    pixels = np.flip(pixels.swapaxes(0, 1) if swap else pixels, flips)
    kept = _kept(exif, is_tiff=image.format == "TIFF")
    return Picture(np.ascontiguousarray(pixels), icc, kept)


def _kept(exif: Image.Exif, *, is_tiff: bool) -> bytes | None:
    """EXIF as it can be written again; a picture is not refused because its EXIF is broken."""
    try:
        kept = described(exif) if is_tiff else exif.tobytes() if len(exif) else None
        if kept is not None:
            Image.Exif().load(kept)
    except Exception:  # whatever broken tags make Pillow raise
        return None
    return kept


def _pixels(path: Path, image: Image.Image, max_pixels: int) -> np.ndarray:
    """Pixels in their own depth, which Pillow knows for grey pictures only."""
    if image.format == "PNG" and image.mode in ("RGB", "RGBA") and _png_depth(path) == 16:
        deep = cv2.imread(str(path), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
        if deep is None:
            raise ValueError("a PNG of 16 bits that cannot be decoded")
        return cv2.cvtColor(deep, cv2.COLOR_BGR2RGB if deep.shape[2] == 3 else cv2.COLOR_BGRA2RGBA)
    if isinstance(image, TiffImagePlugin.TiffImageFile) and _tiff_depth(image) > 8:
        return _deep_tiff(path, max_pixels)[0]
    return _plain_pixels(image)


def _plain_pixels(image: Image.Image) -> np.ndarray:
    """Pixels by Pillow's mode."""
    mode = image.mode
    if mode.startswith("I;16"):
        return np.asarray(image).astype(np.uint16)
    if mode == "I":
        values = np.asarray(image)
        if values.min() < 0 or values.max() > 65535:
            raise ValueError("more than 16 bits a pixel")
        return values.astype(np.uint16)
    if mode == "F":
        return np.asarray(image, dtype=np.float32)
    if mode in ("1", "L"):
        return np.asarray(image.convert("L"))
    return np.asarray(image.convert("RGBA" if image.has_transparency_data else "RGB"))


def _png_depth(path: Path) -> int:
    """Bits a channel, from the header."""
    with path.open("rb") as file:
        return file.read(25)[24]


def _tiff_depth(image: TiffImagePlugin.TiffImageFile) -> int:
    bits = image.tag_v2.get(ExifTags.Base.BitsPerSample, 8)
    return max(bits) if isinstance(bits, tuple) else int(bits)


def _deep_tiff(path: Path, max_pixels: int) -> tuple[np.ndarray, bytes | None]:
    """The first page with its profile."""
    pixels, icc = read_tiff(path, max_pixels=max_pixels)
    if pixels.dtype == np.float64:
        pixels = pixels.astype(np.float32)
    if pixels.dtype not in (np.uint8, np.uint16, np.float32):
        raise ValueError(f"a TIFF of {pixels.dtype} pixels")
    return pixels, icc


def _write_by_pillow(path: Path, picture: Picture, kind: str) -> None:
    options: dict[str, Any] = dict(_SAVE_OPTIONS.get(kind, {}))
    if picture.icc is not None:
        options["icc_profile"] = picture.icc
    if picture.exif is not None and kind != "BMP":
        options["exif"] = picture.exif
    Image.fromarray(picture.pixels).save(path, format=kind, **options)


def _write_deep_png(path: Path, picture: Picture) -> None:
    """RGB of 16 bits, which Pillow cannot write; the profile is put in as a chunk of its own."""
    code = cv2.COLOR_RGB2BGR if picture.pixels.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
    done, encoded = cv2.imencode(".png", cv2.cvtColor(picture.pixels, code))
    if not done:
        raise ValueError(f"Expected pixels that PNG holds, got shape {picture.pixels.shape}.")
    data = encoded.tobytes()
    header = 8 + 25  # the signature and the chunk IHDR; the profile must come right after
    chunks = b""
    if picture.icc is not None:
        chunks += _png_chunk(b"iCCP", b"ICC profile\0\0" + zlib.compress(picture.icc))
    if picture.exif is not None:
        chunks += _png_chunk(b"eXIf", picture.exif.removeprefix(b"Exif\0\0"))
    path.write_bytes(data[:header] + chunks + data[header:])


def _write_deep_tiff(path: Path, picture: Picture) -> None:
    """More than 8 bits a channel, which Pillow cannot write in colour."""
    import tifffile  # here, as most pictures need none

    pixels = picture.pixels
    tifffile.imwrite(
        path,
        pixels,
        photometric="rgb" if pixels.ndim == 3 else "minisblack",
        compression="zlib",
        iccprofile=picture.icc,
        extrasamples=["unassalpha"] if pixels.shape[2:] == (4,) else None,
        software=False,
        metadata=None,  # its own description would take the photograph's place
        byteorder="<",
        extratags=extra_tags(picture.exif) if picture.exif is not None else (),
    )
    if picture.exif is not None:
        append_exif(path, picture.exif)


def _png_chunk(name: bytes, body: bytes) -> bytes:
    checksum = zlib.crc32(name + body)
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", checksum)

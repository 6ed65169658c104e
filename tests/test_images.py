"""Laws of picture files: what is written is read back, upright, with profile and EXIF."""

import io
import re
import struct
import zlib

import numpy as np
import pytest
import tifffile
from PIL import ExifTags, Image, ImageCms

from hybrid.arrays import check_image, to_rgb8
from hybrid.images import Picture, read_picture, write_picture

RNG = np.random.default_rng(0)
ICC = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()


def exif_bytes(orientation: int = 1) -> bytes:
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    exif[ExifTags.Base.Make] = "Maker"
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLength] = 2.75
    exif.get_ifd(ExifTags.IFD.GPSInfo)[ExifTags.GPS.GPSLatitudeRef] = "N"
    return exif.tobytes()


def noise(shape: tuple[int, ...], dtype: str) -> np.ndarray:
    if dtype == "float32":
        return RNG.random(shape, dtype=np.float32)
    return RNG.integers(0, np.iinfo(dtype).max + 1, shape).astype(dtype)


LOSSLESS = [
    *((suffix, "uint8", shape) for suffix in (".png", ".tif") for shape in ("grey", 3, 4)),
    *((suffix, "uint16", shape) for suffix in (".png", ".tiff") for shape in ("grey", 3, 4)),
    (".bmp", "uint8", 3),
    (".tif", "float32", "grey"),
    (".tif", "float32", 3),
]


@pytest.mark.parametrize(("suffix", "dtype", "channels"), LOSSLESS)
def test_lossless_formats_give_the_pixels_back(tmp_path, suffix, dtype, channels):
    pixels = noise((13, 17) if channels == "grey" else (13, 17, channels), dtype)
    path = tmp_path / f"picture{suffix}"
    write_picture(path, Picture(pixels))
    read = read_picture(path)
    assert read.pixels.dtype == dtype
    np.testing.assert_array_equal(read.pixels, pixels)


@pytest.mark.parametrize("suffix", [".jpg", ".JPEG", ".webp"])
def test_lossy_formats_come_close(tmp_path, suffix):
    u, v = np.meshgrid(np.linspace(40, 200, 64), np.linspace(60, 220, 48))
    pixels = np.stack([u, v, (u + v) / 2], axis=-1).astype(np.uint8)
    path = tmp_path / f"picture{suffix}"
    write_picture(path, Picture(pixels))
    assert np.abs(read_picture(path).pixels.astype(int) - pixels).max() < 12


@pytest.mark.parametrize(
    ("suffix", "dtype"),
    [(".jpg", "uint8"), (".png", "uint8"), (".webp", "uint8"), (".tif", "uint8"),
     (".png", "uint16"), (".tif", "uint16")],
)  # fmt: skip
def test_colour_profile_is_kept(tmp_path, suffix, dtype):
    path = tmp_path / f"picture{suffix}"
    write_picture(path, Picture(noise((8, 9, 3), dtype), icc=ICC))
    assert read_picture(path).icc == ICC


@pytest.mark.parametrize(
    ("suffix", "dtype"),
    [(".jpg", "uint8"), (".png", "uint8"), (".webp", "uint8"), (".tif", "uint8"),
     (".png", "uint16"), (".tif", "uint16"), (".tiff", "float32")],
)  # fmt: skip
def test_exif_is_kept_without_its_orientation(tmp_path, suffix, dtype):
    Image.fromarray(noise((8, 9, 3), "uint8")).save(tmp_path / "in.jpg", exif=exif_bytes(6))
    picture = read_picture(tmp_path / "in.jpg")
    path = tmp_path / f"out{suffix}"
    write_picture(path, Picture(noise((8, 9, 3), dtype), exif=picture.exif))
    kept = read_picture(path).exif
    assert kept is not None
    exif = Image.Exif()
    exif.load(kept)
    assert exif[ExifTags.Base.Make] == "Maker"
    assert exif.get(ExifTags.Base.Orientation, 1) == 1
    assert float(exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLength]) == 2.75
    assert exif.get_ifd(ExifTags.IFD.GPSInfo)[ExifTags.GPS.GPSLatitudeRef] == "N"


def test_exif_of_a_tiff_goes_into_a_jpeg(tmp_path):
    """Tags that describe the TIFF itself, such as its strips, do not come along."""
    pixels = noise((8, 9, 3), "uint8")
    Image.fromarray(pixels).save(tmp_path / "in.tif", exif=exif_bytes())
    picture = read_picture(tmp_path / "in.tif")
    write_picture(tmp_path / "out.jpg", picture)
    with Image.open(tmp_path / "out.jpg") as image:
        exif = image.getexif()
    assert exif[ExifTags.Base.Make] == "Maker"
    assert float(exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLength]) == 2.75
    assert ExifTags.Base.StripOffsets not in exif


def test_a_tiff_without_exif_has_none(tmp_path):
    write_picture(tmp_path / "a.tif", Picture(noise((8, 9, 3), "uint16")))
    assert read_picture(tmp_path / "a.tif").exif is None


@pytest.mark.parametrize("orientation", range(1, 9))
def test_every_orientation_is_turned_upright(tmp_path, orientation):
    from PIL import ImageOps

    path = tmp_path / "picture.png"
    image = Image.fromarray(noise((5, 7, 3), "uint8"))
    image.save(path, exif=exif_bytes(orientation))
    with Image.open(path) as stored:
        expected = np.asarray(ImageOps.exif_transpose(stored))
    np.testing.assert_array_equal(read_picture(path).pixels, expected)


@pytest.mark.parametrize(
    ("mode", "shape", "dtype"),
    [
        ("1", (6, 5), "uint8"),
        ("L", (6, 5), "uint8"),
        ("LA", (6, 5, 4), "uint8"),
        ("P", (6, 5, 3), "uint8"),
        ("RGB", (6, 5, 3), "uint8"),
        ("RGBA", (6, 5, 4), "uint8"),
        ("CMYK", (6, 5, 3), "uint8"),
        ("I;16", (6, 5), "uint16"),
        ("F", (6, 5), "float32"),
    ],
)
def test_every_mode_becomes_a_plain_array(tmp_path, mode, shape, dtype):
    path = tmp_path / ("picture.tif" if mode in ("CMYK", "F", "I;16") else "picture.png")
    Image.new(mode, (5, 6)).save(path)
    pixels = read_picture(path).pixels
    assert pixels.shape == shape
    assert pixels.dtype == dtype


def test_alpha_is_dropped_for_jpeg(tmp_path):
    write_picture(tmp_path / "a.jpg", Picture(np.full((8, 8, 4), 90, np.uint8)))
    assert read_picture(tmp_path / "a.jpg").pixels.shape == (8, 8, 3)


@pytest.mark.parametrize(
    ("name", "dtype"),
    [("a.jpg", "uint16"), ("a.webp", "uint16"), ("a.png", "float32"), ("a.gif", "uint8")],
)
def test_pixels_that_a_format_cannot_hold_are_refused(tmp_path, name, dtype):
    with pytest.raises(ValueError, match="Expected"):
        write_picture(tmp_path / name, Picture(np.zeros((4, 4, 3), dtype)))
    assert list(tmp_path.iterdir()) == []


def jpeg_bytes() -> bytes:
    stream = io.BytesIO()
    Image.fromarray(noise((80, 90, 3), "uint8")).save(stream, "JPEG")
    return stream.getvalue()


def png_bytes(bits: int) -> bytes:
    if bits == 8:
        stream = io.BytesIO()
        Image.fromarray(noise((80, 90, 3), "uint8")).save(stream, "PNG")
        return stream.getvalue()
    import cv2

    return cv2.imencode(".png", noise((80, 90, 3), "uint16"))[1].tobytes()


def bomb_bytes() -> bytes:
    """A PNG that says it has 60000 x 60000 pixels."""
    body = b"IHDR" + struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0)
    data = b"IDAT" + zlib.compress(b"\0" * 1000)
    chunks = [
        struct.pack(">I", len(part) - 4) + part + struct.pack(">I", zlib.crc32(part))
        for part in (body, data, b"IEND")
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


BROKEN = {
    "truncated.jpg": jpeg_bytes()[:2000],
    "header only.jpg": jpeg_bytes()[:30],
    "truncated.png": png_bytes(8)[:5000],
    "truncated16.png": png_bytes(16)[:5000],
    "text.jpg": b"this is a text file",
    "empty.png": b"",
    "bomb.png": bomb_bytes(),
    "text.tif": b"II*\0 and then nonsense",
    "zeros.webp": bytes(500),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_are_one_line_errors(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(BROKEN[name])
    with pytest.raises(ValueError, match=name.replace(".", r"\.")) as caught:
        read_picture(path)
    assert "\n" not in str(caught.value)
    assert re.search(r": \D{10,}", str(caught.value))  # in words, not the number of some index


def test_too_large_a_picture_is_refused_before_decoding(tmp_path):
    path = tmp_path / "large.png"
    Image.new("L", (200, 100)).save(path)
    with pytest.raises(ValueError, match="more than 19999 pixels"):
        read_picture(path, max_pixels=19999)


def test_missing_files_are_told_apart(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_picture(tmp_path / "none.jpg")


def test_first_page_of_a_deep_tiff_is_read(tmp_path):
    pages = noise((3, 12, 14), "uint16")
    tifffile.imwrite(tmp_path / "pages.tif", pages, photometric="minisblack")
    np.testing.assert_array_equal(read_picture(tmp_path / "pages.tif").pixels, pages[0])


def test_writing_leaves_no_other_file(tmp_path):
    write_picture(tmp_path / "a.png", Picture(np.zeros((4, 4), np.uint8)))
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


# ---- arrays -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("image", "error", "message"),
    [
        (np.zeros((4, 4, 2), np.uint8), ValueError, "shape"),
        (np.zeros((4, 4, 5), np.uint8), ValueError, "shape"),
        (np.zeros(16, np.uint8), ValueError, "shape"),
        (np.zeros((2, 4, 4, 3), np.uint8), ValueError, "shape"),
        (np.zeros((0, 4, 3), np.uint8), ValueError, "with pixels"),
        (np.zeros((4, 4), np.int64), ValueError, "type"),
        (np.zeros((4, 4), bool), ValueError, "type"),
        (np.full((4, 4), np.nan), ValueError, "NaN"),
        (np.full((4, 4), 255.0), ValueError, r"\[0, 1\]"),
        ([[0, 1], [2, 3]], TypeError, "NumPy"),
        (None, TypeError, "NumPy"),
    ],
)
def test_what_is_no_picture_is_refused(image, error, message):
    with pytest.raises(error, match=message):
        check_image(image)


def test_all_types_show_the_same_picture():
    pixels = noise((6, 7, 3), "uint8")
    np.testing.assert_array_equal(to_rgb8(pixels), pixels)
    np.testing.assert_array_equal(to_rgb8(pixels.astype(np.uint16) * 257), pixels)
    np.testing.assert_array_equal(to_rgb8(pixels / 255), pixels)
    np.testing.assert_array_equal(to_rgb8((pixels / 255).astype(np.float32)), pixels)
    np.testing.assert_array_equal(to_rgb8(np.dstack([pixels, pixels[..., 0]])), pixels)


@pytest.mark.parametrize("shape", [(6, 7), (6, 7, 1)])
def test_grey_becomes_three_equal_channels(shape):
    pixels = noise(shape, "uint8")
    shown = to_rgb8(pixels)
    assert shown.shape == (6, 7, 3)
    for channel in range(3):
        np.testing.assert_array_equal(shown[..., channel], pixels.reshape(6, 7))

"""Laws of hostile input: whatever a file holds, it is read or refused in one line."""

import io
import json
import math
import os
import pickle
import struct
import subprocess
import sys
import tracemalloc
import zlib
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import tifffile
from fuzz_targets import LENS, TARGETS, picture, seeds
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image, PngImagePlugin

from classical.tiff import read_tiff
from classical.warp import read_stmap
from hybrid import CameraFile, Quality, read_camera, read_picture, write_camera
from hybrid.cli import run
from learned.larecnet import LaRecNet
from learned.rong import RongNet
from learned.weights import load_weights, packaged

FAST = settings(
    max_examples=120,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)

# ---- any bytes --------------------------------------------------------------------------------


@cache
def seeds_of(target: str) -> tuple[bytes, ...]:
    with TemporaryDirectory() as folder:
        return tuple(seeds(target, Path(folder)))


@st.composite
def spoiled(draw, target: str) -> bytes:
    """A good file with bytes changed, cut, doubled or put in."""
    data = bytearray(draw(st.sampled_from(seeds_of(target))))
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(0, len(data) - 1)))
        how = draw(st.sampled_from(["change", "cut", "remove", "insert", "double"]))
        if how == "change":
            data[at : at + 1] = draw(st.binary(min_size=1, max_size=1))
        elif how == "cut":
            del data[at:]
        elif how == "remove":
            del data[at : at + draw(st.integers(1, 16))]
        elif how == "insert":
            data[at:at] = draw(st.binary(min_size=1, max_size=8))
        else:
            data[at:at] = data[at : at + draw(st.integers(1, 64))]
    return bytes(data)


@pytest.mark.parametrize("target", TARGETS)
def test_good_files_are_read(target, tmp_path):
    if target.endswith("exr"):
        pytest.importorskip("OpenEXR")
    read = [TARGETS[target](seed, tmp_path) for seed in seeds_of(target)]
    assert sum(read) >= len(read) / 2  # the seeds include some that must be refused


@pytest.mark.parametrize("target", TARGETS)
@given(data=st.data())
@FAST
def test_a_spoiled_file_is_read_or_refused_in_one_line(target, tmp_path, data):
    TARGETS[target](data.draw(spoiled(target)), tmp_path)


@pytest.mark.parametrize("target", TARGETS)
@given(content=st.binary(max_size=400))
@FAST
def test_any_bytes_are_read_or_refused_in_one_line(target, tmp_path, content):
    TARGETS[target](content, tmp_path)


# ---- bombs ------------------------------------------------------------------------------------


def png(width: int, height: int, *chunks: bytes) -> bytes:
    """A PNG that claims a size, of chunks each beginning with its name."""
    header = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = [header, *chunks, b"IDAT" + zlib.compress(bytes(1000)), b"IEND"]
    framed = [struct.pack(">I", len(p) - 4) + p + struct.pack(">I", zlib.crc32(p)) for p in parts]
    return b"\x89PNG\r\n\x1a\n" + b"".join(framed)


def tiff(pixels: np.ndarray, **options) -> bytes:
    stream = io.BytesIO()
    tifffile.imwrite(stream, pixels, metadata=None, **options)
    return stream.getvalue()


def retagged(data: bytes, tag: int, value: int) -> bytes:
    """A little-endian TIFF with the value of one tag of its first page replaced."""
    found = bytearray(data)
    (offset,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, offset)
    for entry in range(offset + 2, offset + 2 + 12 * count, 12):
        if struct.unpack_from("<H", data, entry)[0] == tag:
            struct.pack_into("<HII", found, entry + 2, 4, 1, value)
            return bytes(found)
    raise AssertionError(f"no tag {tag}")


def inflating_tiff() -> bytes:
    """A TIFF of 8x8 pixels of 16 bits whose only strip unpacks to 400 MB."""
    small = tiff(np.zeros((8, 8, 3), np.uint16), photometric="rgb", compression="zlib")
    bomb = zlib.compress(bytes(400_000_000), 9)
    return retagged(retagged(small, 273, len(small)), 279, len(bomb)) + bomb


def bombs() -> dict[str, bytes]:
    deep = tiff(np.zeros((8, 8, 3), np.uint16), photometric="rgb", compression="zlib")
    plain = tiff(np.zeros((8, 8), np.uint8))
    text = b"zTXt" + b"comment\0\0" + zlib.compress(bytes(300_000_000), 9)
    profile = b"iCCP" + b"profile\0\0" + zlib.compress(bytes(300_000_000), 9)
    jpeg = io.BytesIO()
    Image.new("L", (8, 8)).save(jpeg, "JPEG")
    at = jpeg.getvalue().index(b"\xff\xc0") + 5
    huge_jpeg = bytearray(jpeg.getvalue())
    struct.pack_into(">HH", huge_jpeg, at, 65000, 65000)
    return {
        "png of 60000x60000": png(60000, 60000),
        "png of 2^31-1 pixels a side": png(2**31 - 1, 2**31 - 1),
        "png with a text that inflates": png(8, 8, text),
        "png with a profile that inflates": png(8, 8, profile),
        "jpeg of 65000x65000": bytes(huge_jpeg),
        "tiff of 4 billion columns": retagged(plain, 256, 2**32 - 1),
        "deep tiff of a million rows": retagged(retagged(deep, 257, 10**6), 256, 10**6),
        "deep tiff of 60000 channels": retagged(retagged(deep, 277, 60000), 256, 60000),
        "deep tiff that inflates": inflating_tiff(),
        "bmp of 2 billion rows": _huge_bmp(),
        "gif of 65535x65535": b"GIF89a\xff\xff\xff\xff\x00\x00\x00" + b",\0\0\0\0" + b"\xff" * 4,
    }


def _huge_bmp() -> bytes:
    stream = io.BytesIO()
    Image.new("RGB", (4, 4)).save(stream, "BMP")
    data = bytearray(stream.getvalue())
    struct.pack_into("<ii", data, 18, 2**31 - 1, 2**31 - 1)
    return bytes(data)


READ_BOMBS = """
import json, resource, sys
from pathlib import Path
from hybrid import read_picture
resource.setrlimit(resource.RLIMIT_CPU, (120, 120))
told = {}
for path in sorted(Path(sys.argv[1]).iterdir()):
    before = resource.getrusage(resource.RUSAGE_SELF)
    try:
        result = f"read {read_picture(path, max_pixels=10_000_000).pixels.shape}"
    except ValueError as error:
        result = f"refused: {error}"
    after = resource.getrusage(resource.RUSAGE_SELF)
    told[path.name] = (
        result, (after.ru_maxrss - before.ru_maxrss) // 1024, after.ru_utime - before.ru_utime
    )
print(json.dumps(told))
"""


def test_bombs_take_neither_memory_nor_time(tmp_path):
    for name, data in bombs().items():
        (tmp_path / name).write_bytes(data)
    done = subprocess.run(
        [sys.executable, "-c", READ_BOMBS, tmp_path], capture_output=True, text=True, check=True
    )
    told = json.loads(done.stdout)
    assert set(told) == set(bombs())
    for name, (result, mebibytes, seconds) in told.items():
        assert result.startswith("refused") or result == "read (8, 8, 3)", (name, result)
        assert mebibytes < 100, name
        assert seconds < 5, name


def test_an_stmap_that_claims_too_much_is_refused(tmp_path):
    small = tiff(np.zeros((8, 8, 3), np.float32), photometric="rgb", compression="zlib")
    (tmp_path / "map.tif").write_bytes(retagged(retagged(small, 256, 10**6), 257, 10**6))
    with pytest.raises(ValueError, match="pixels"):
        read_stmap(tmp_path / "map.tif", 100, 100)


@pytest.mark.parametrize("shape", [(8, 8), (8, 8, 3), (3, 8, 8)])
def test_a_tiff_is_refused_by_its_pixels_whatever_its_channels(shape, tmp_path):
    options = {"photometric": "rgb"} if len(shape) == 3 else {}
    if shape[0] == 3:
        options["planarconfig"] = "separate"
    (tmp_path / "page.tif").write_bytes(tiff(np.zeros(shape, np.uint16), **options))
    assert read_tiff(tmp_path / "page.tif", max_pixels=64)[0].size == math.prod(shape)
    with pytest.raises(ValueError, match="more than 63 pixels"):
        read_tiff(tmp_path / "page.tif", max_pixels=63)


def test_a_camera_file_that_unfolds_is_refused_quickly(tmp_path):
    levels = ["a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    for last, name in zip("abcdefgh", "bcdefghi", strict=True):
        levels.append(f"{name}: &{name} [{', '.join([f'*{last}'] * 9)}]")
    laughs = "\n".join([*levels, "camera_matrix: *i", "distortion_coefficients: *i"])
    (tmp_path / "lens.yaml").write_text(laughs)
    tracemalloc.start()
    with pytest.raises(ValueError, match="camera_matrix"):
        read_camera(tmp_path / "lens.yaml")
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 50_000_000


def test_compressed_text_in_a_good_png_does_no_harm(tmp_path):
    notes = PngImagePlugin.PngInfo()
    notes.add_text("comment", "x" * 10_000, zip=True)
    Image.new("RGB", (9, 7)).save(tmp_path / "a.png", pnginfo=notes)
    assert read_picture(tmp_path / "a.png").pixels.shape == (7, 9, 3)


# ---- programs and pickles in disguise ---------------------------------------------------------


@pytest.mark.parametrize("name", ["a.eps", "a.jpg"])
def test_postscript_is_never_run(tmp_path, name):
    stream = io.BytesIO()
    Image.new("RGB", (9, 7)).save(stream, "EPS")
    (tmp_path / name).write_bytes(stream.getvalue())
    with pytest.raises(ValueError, match="not a "):
        read_picture(tmp_path / name)


class Trap:
    """Makes a folder when it is unpickled."""

    def __init__(self, folder: str) -> None:
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (self.folder,)


@pytest.mark.parametrize("kind", [LaRecNet, RongNet])
def test_weights_that_are_a_pickle_are_refused_unopened(tmp_path, kind):
    import torch

    trap = tmp_path / "sprung"
    (tmp_path / "plain.safetensors").write_bytes(pickle.dumps(Trap(str(trap))))
    torch.save(Trap(str(trap)), tmp_path / "torch.safetensors")
    for name in ("plain", "torch"):
        with pytest.raises(ValueError, match="safetensors"):
            load_weights(tmp_path / f"{name}.safetensors", kind)
    assert not trap.exists()


def header_of(path: Path) -> tuple[dict, bytes]:
    """A safetensors file as its header and the rest."""
    data = path.read_bytes()
    (length,) = struct.unpack_from("<Q", data)
    return json.loads(data[8 : 8 + length]), data[8 + length :]


def weights_file(path: Path, header: dict, rest: bytes) -> Path:
    text = json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + rest)
    return path


@pytest.mark.parametrize(
    "change",
    [
        lambda header: header.pop("__metadata__"),
        lambda header: header["__metadata__"].pop("config"),
        lambda header: header["__metadata__"].pop("card"),
        lambda header: header["__metadata__"].update(config="{"),
        lambda header: header["__metadata__"].update(config="[]"),
        lambda header: header["__metadata__"].update(config='{"nonsense": 1}'),
        lambda header: header["__metadata__"].update(card="{"),
        lambda header: header["__metadata__"].update(kind="larecnet"),
        lambda header: header.pop(sorted(set(header) - {"__metadata__"})[0]),
        lambda header: next(v for v in header.values() if len(v.get("shape", [])) > 1).update(
            shape=[1]
        ),
    ],
)
def test_weights_with_a_spoiled_header_are_refused(tmp_path, change):
    header, rest = header_of(packaged("rong-compact"))
    change(header)
    path = weights_file(tmp_path / "w.safetensors", header, rest)
    with pytest.raises(ValueError, match="expected") as caught:
        load_weights(path, RongNet)
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("text", ["", "nonsense"])
def test_a_checksum_that_is_none_is_refused(tmp_path, text):
    path = tmp_path / "w.safetensors"
    path.write_bytes(packaged("rong-compact").read_bytes())
    path.with_suffix(".sha256").write_text(text)
    with pytest.raises(ValueError, match="checksum"):
        load_weights(path, RongNet)


# ---- names ------------------------------------------------------------------------------------


def room(folder: Path, name: str | bytes) -> Path:
    """A small picture under a name."""
    stream = io.BytesIO()
    Image.new("RGB", (64, 48), (90, 80, 70)).save(stream, "PNG")
    path = Path(os.fsdecode(os.path.join(os.fsencode(folder), os.fsencode(name))))  # noqa: PTH118
    path.write_bytes(stream.getvalue())
    return path


@pytest.fixture
def lens(tmp_path) -> Path:
    path = tmp_path / "lens.json"
    write_camera(path, CameraFile(LENS, "ok", "", Quality()))
    return path


HOSTILE = [
    "-rf.png",
    "--out.png",
    "a b.png",
    "a\nb.png",
    "a\x1b[31mred.png",
    "a;rm -rf $HOME `id`.png",
    "%s%n{0}.png",
    "..png",
    "....png",
    "ä\u202egnp.png",
    "a" * 250 + ".png",
    b"\xff\xfe.png",
    "CON.png",
    "~.png",
]


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_names_are_names(tmp_path, capfd, lens, name):
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    source = room(folder, name)
    options = ["--out", str(out), "--camera", str(lens)]
    code = run(["rectify", str(folder), *options])
    said = capfd.readouterr()
    assert "Traceback" not in said.err
    assert "\x1b" not in said.out + said.err
    if code == 0:
        assert (out / source.name).is_file()
        assert len(said.out.splitlines()) == 1
    else:  # a name that leaves no room for the endings of what is written
        assert len(source.name) > 240
        assert len(said.err.splitlines()) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in", "lens.json", "out"]


def test_a_link_as_output_is_replaced_and_what_it_points_to_is_safe(tmp_path, lens):
    source, out, precious = room(tmp_path, "a.png"), tmp_path / "out", tmp_path / "precious"
    out.mkdir()
    precious.write_text("precious")
    (out / "a.png").symlink_to(precious)
    arguments = ["rectify", str(source), "--out", str(out), "--camera", str(lens)]
    assert run(arguments) == 2
    assert run([*arguments, "--overwrite"]) == 0
    assert precious.read_text() == "precious"
    assert not (out / "a.png").is_symlink()


def test_a_link_to_an_input_is_still_an_input(tmp_path, capsys, lens):
    source, out = room(tmp_path, "a.png"), tmp_path / "out"
    out.mkdir()
    (out / "a.png").symlink_to(source)
    before = source.read_bytes()
    options = ["--out", str(out), "--camera", str(lens), "--overwrite"]
    assert run(["rectify", str(source), *options]) == 2
    assert "is an input" in capsys.readouterr().err
    assert source.read_bytes() == before


def test_dangling_links_and_loops_are_reported(tmp_path, capsys, lens):
    folder = tmp_path / "in"
    folder.mkdir()
    room(folder, "good.png")
    (folder / "dangling.png").symlink_to(tmp_path / "nowhere")
    (folder / "loop.png").symlink_to(folder / "loop.png")
    (folder / "again").symlink_to(folder)
    out = tmp_path / "out"
    assert run(["rectify", str(folder), "--out", str(out), "--camera", str(lens)]) == 1
    said = capsys.readouterr().err
    assert "dangling.png" in said
    assert "loop.png" in said
    assert len(said.splitlines()) == 2
    assert (out / "good.png").is_file()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
def test_a_pipe_is_not_waited_for(tmp_path, lens):
    os.mkfifo(tmp_path / "pipe.png")
    with pytest.raises(ValueError, match="regular file"):
        read_picture(tmp_path / "pipe.png")
    with pytest.raises(ValueError, match="regular file"):
        read_camera(tmp_path / "pipe.png")


def test_a_picture_within_the_limit_is_read_and_one_pixel_more_is_not(tmp_path):
    path = room(tmp_path, "a.png")
    assert read_picture(path, max_pixels=64 * 48).pixels.shape == (48, 64, 3)
    with pytest.raises(ValueError, match="more than 3071 pixels"):
        read_picture(path, max_pixels=64 * 48 - 1)


@pytest.mark.parametrize("dtype", ["uint16", "float32"])
def test_lzw_is_read_at_any_depth(tmp_path, dtype):
    values = np.random.default_rng(0).random((20, 30)) * 60000
    Image.fromarray(values.astype(dtype)).save(tmp_path / "a.tif", compression="tiff_lzw")
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif").pixels, values.astype(dtype))


def test_the_targets_notice_what_breaks_the_law(tmp_path, monkeypatch):
    def broken(*_args, **_options):
        raise KeyError("no law")

    monkeypatch.setattr("fuzz_targets.read_picture", broken)
    with pytest.raises(KeyError):
        picture(b"anything", tmp_path)

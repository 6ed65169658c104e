"""Killed in the middle, or out of disk: whole files or none, and the same command goes on.

Slow: every command of the program is started, killed and started again as a process of its own.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from classical.camera import KannalaBrandt
from hybrid import CameraFile, Quality, read_camera, read_picture, write_camera

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL"),
]

ROOMS = Path(__file__).parent / "data" / "rooms"
PROGRAM = [sys.executable, "-c", "from hybrid.cli import main; main()"]
SIZE = (1200, 900)
LENS = KannalaBrandt.centred(np.array([0.95, -0.06, 0.004, 0.0, 0.0]), *SIZE)


@dataclass(frozen=True)
class Command:
    """A command line that writes, and what makes it go on after it was stopped."""

    words: list[str]
    resume: list[str]

    def line(self, out: Path, *, again: bool = False) -> list[str]:
        words = [word.replace("OUT", str(out)) for word in self.words]
        return [*PROGRAM, *words, *(self.resume if again else [])]


# ---- what the commands work on -------------------------------------------------------------------


def bars(seed: int, camera: KannalaBrandt = LENS) -> np.ndarray:
    """Dark bars with a little noise, so that files are large."""
    u, v = np.meshgrid(np.arange(camera.width) * 1.0, np.arange(camera.height) * 1.0)
    rays, _ = camera.unproject(np.stack([u.ravel(), v.ravel()], axis=1))
    x, y = (rays[:, :2] / np.maximum(rays[:, 2:], 1e-2)).T
    dark = ((x + 0.2 * y + seed / 7) / 0.5 % 1 < 0.25) | ((y / 0.4 + seed / 5) % 1 < 0.2)
    grey = np.where(dark, 60.0, 190.0).reshape(u.shape)[..., None]
    noise = np.random.default_rng(seed).normal(0, 3, (*u.shape, 3))
    return np.clip(cv2.GaussianBlur(np.repeat(grey, 3, 2), (0, 0), 0.7) + noise, 0, 255).astype(
        np.uint8
    )


def film(path: Path) -> None:
    av = pytest.importorskip("av")
    camera = LENS.resized(640, 480)
    with av.open(str(path), "w") as out:
        video = out.add_stream("libx264", rate=25, options={"preset": "ultrafast"})
        video.width, video.height, video.pix_fmt = 640, 480, "yuv420p"
        for i in range(100):
            frame = av.VideoFrame.from_ndarray(bars(i % 5, camera), format="rgb24")
            out.mux(video.encode(frame))
        out.mux(video.encode(None))


@pytest.fixture(scope="module")
def inputs(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    (folder / "pictures").mkdir()
    for seed in range(6):
        cv2.imwrite(str(folder / "pictures" / f"{seed}.png"), bars(seed))
    write_camera(folder / "lens.json", CameraFile(LENS, "ok", "made up", Quality()))
    film(folder / "film.mp4")
    return folder


@pytest.fixture(scope="module")
def evaluated(inputs) -> Path:
    """A run that a report can be made of."""
    pytest.importorskip("jinja2")
    out = inputs / "evaluated"
    words = ["evaluate", "--suite", str(ROOMS), "--out", str(out), "--methods", "identity"]
    subprocess.run([*PROGRAM, *words], check=True, capture_output=True)
    return out


COMMANDS = ("rectify", "calibrate", "batch", "video", "synthesize", "evaluate", "report")


@pytest.fixture
def command(request, inputs) -> Command:
    pictures, lens = str(inputs / "pictures"), str(inputs / "lens.json")
    classical = ["--method", "classical"]
    again = ["--overwrite"]
    made = {
        "rectify": (["rectify", pictures, "--out", "OUT", "--camera", lens, "--overlay"], again),
        "calibrate": (["calibrate", pictures, "--out", "OUT/map.tif", *classical], again),
        "batch": (["batch", pictures, "--out", "OUT", "--workers", "2", "--camera", lens], []),
        "video": (["video", str(inputs / "film.mp4"), "OUT/film.mp4", "--camera", lens], again),
        "synthesize": (
            ["synthesize", "dwireframe", "--photos", pictures, "--out", "OUT", "--count", "8"],
            [],
        ),
        "evaluate": (
            ["evaluate", "--suite", str(ROOMS), "--out", "OUT", "--methods", "identity,classical"],
            [],
        ),
        "report": (["report", "EVALUATED", "--out", "OUT"], []),
    }
    words, resume = made[request.param]
    if request.param == "calibrate":
        words = [*words, "--format", "stmap"]
    if request.param == "synthesize":
        words = [*words, "--size", "320", "--photometry"]
    if request.param == "report":
        words[1] = str(request.getfixturevalue("evaluated"))
    return Command(words, resume)


each_command = pytest.mark.parametrize("command", COMMANDS, indirect=True, ids=COMMANDS)


# ---- what is left --------------------------------------------------------------------------------


def visible(out: Path) -> list[str]:
    """Files that a user sees."""
    paths = [path.relative_to(out) for path in out.rglob("*") if path.is_file()]
    return sorted(p.as_posix() for p in paths if not any(part[0] == "." for part in p.parts))


def check_whole(path: Path) -> None:
    """Fail unless a file is complete, by what its kind ends with."""
    kind = path.suffix
    if path.name == "map.tif":
        assert read_camera(path).camera.width == SIZE[0]
    if kind in (".png", ".jpg", ".tif"):
        assert read_picture(path).pixels.size
    elif kind == ".json":
        json.loads(path.read_text())
    elif kind == ".jsonl":
        *lines, _ = path.read_text().split("\n")  # the last line may be cut off
        assert all(json.loads(line) for line in lines)
    elif kind == ".mp4":
        from hybrid.video import Film

        with Film(path) as film:
            assert sum(1 for _ in film.frames()) == 100
    elif kind == ".npz":
        with np.load(path) as arrays:
            assert all(arrays[name] is not None for name in arrays.files)
    elif kind == ".html":
        assert path.read_text().rstrip().endswith("</html>")
    else:
        assert kind in (".csv", ".md")
        assert path.read_text().endswith("\n")


def check_all(out: Path) -> None:
    for name in visible(out):
        check_whole(out / name)


def leftovers(out: Path) -> list[Path]:
    return list(out.rglob(".*"))


# ---- killing -------------------------------------------------------------------------------------


def being_written(out: Path) -> Iterator[Path]:
    """Folders in which files are being written now; unlike rglob, this may lose the race."""
    for root, folders, _ in os.walk(out):
        yield from (Path(root, name) for name in folders if name.startswith(".writing-"))


def kill_while_writing(line: list[str], out: Path, nth: int, delay: float) -> bool:
    """Start a command and kill it when it has begun its n-th file; False if it was too quick."""
    process = subprocess.Popen(
        line, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    begun: set[Path] = set()
    while process.poll() is None:
        begun.update(being_written(out))
        if len(begun) >= nth:
            time.sleep(delay)
            process.send_signal(signal.SIGKILL)
            break
    process.wait()
    wait_for_orphans(process.pid)
    return process.returncode == -signal.SIGKILL


def wait_for_orphans(group: int) -> None:
    """Fail if processes that a killed command had started live on."""
    for _ in range(300):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    os.killpg(group, signal.SIGKILL)
    pytest.fail("processes outlived the command")


@each_command
def test_a_killed_command_leaves_whole_files_and_goes_on(command: Command, tmp_path):
    expected, out = tmp_path / "expected", tmp_path / "out"
    subprocess.run(command.line(expected), check=True, capture_output=True)
    check_all(expected)
    assert visible(expected)
    assert not leftovers(expected)
    killed = 0
    for nth, delay in ((1, 0.0), (1, 0.02), (2, 0.0), (3, 0.1), (4, 0.3)):
        out.mkdir(exist_ok=True)
        killed += kill_while_writing(command.line(out, again=out.exists()), out, nth, delay)
        check_all(out)
        assert set(visible(out)) <= set(visible(expected))
    assert killed >= 1
    done = subprocess.run(command.line(out, again=True), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    check_all(out)
    assert visible(out) == visible(expected)
    assert not leftovers(out)


def test_a_killed_batch_does_not_do_its_work_again(inputs, tmp_path):
    out = tmp_path / "out"
    words = ["batch", str(inputs / "pictures"), "--out", str(out), "--workers", "1"]
    line = [*PROGRAM, *words, "--camera", str(inputs / "lens.json")]
    out.mkdir()
    assert kill_while_writing(line, out, 4, 0.0)
    before = {name: (out / name).stat().st_mtime_ns for name in visible(out) if name[0].isdigit()}
    assert 0 < len(before) < 6
    done = subprocess.run(line, capture_output=True, text=True, check=True)
    n_before = int(done.stdout.split(" done before")[0].split(", ")[-1])
    assert len(before) - 1 <= n_before <= len(before)  # the last may have missed the manifest
    for name in list(before)[:n_before]:
        assert (out / name).stat().st_mtime_ns == before[name]


# ---- a full disk ---------------------------------------------------------------------------------


@contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path]:
    """A file system with so much room; skips where it cannot be had."""
    mount = shutil.which("mount")
    folder.mkdir()
    done = mount and subprocess.run(
        [mount, "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)], capture_output=True
    )
    if not done or done.returncode:
        pytest.skip("no file system can be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True, capture_output=True)


def limited(size: int) -> Callable[[], None]:
    """Before a command starts: no file of more than so many bytes."""

    def limit() -> None:
        import resource

        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    return limit


ROOM = {"report": "30k", "evaluate": "30k", "synthesize": "300k", "video": "200k"}


@each_command
def test_a_full_disk_is_one_line_and_leaves_whole_files(command: Command, tmp_path, request):
    name = request.node.callspec.params["command"]
    with small_disk(tmp_path / "disk", ROOM.get(name, "3m")) as disk:
        out = disk / "out"
        done = subprocess.run(command.line(out), capture_output=True, text=True, check=False)
        assert done.returncode == 1, done.stdout
        said = [line for line in done.stderr.splitlines() if "%|" not in line]
        assert len(said) == 1, done.stderr
        assert "No space left on device" in said[0]
        assert ".writing-" not in said[0]
        check_all(out)
        assert not leftovers(out)


def test_a_file_that_grows_too_large_is_told_and_the_others_are_done(inputs, tmp_path):
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    cv2.imwrite(str(pictures / "a.png"), np.zeros((90, 120, 3), np.uint8))
    shutil.copy(inputs / "pictures" / "0.png", pictures / "b.png")
    out = tmp_path / "out"
    words = ["rectify", str(pictures), "--out", str(out), "--camera", str(inputs / "lens.json")]
    done = subprocess.run(
        [*PROGRAM, *words], capture_output=True, text=True, check=False, preexec_fn=limited(50_000)
    )
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "b.png: File too large" in done.stderr
    assert visible(out) == ["a.camera.json", "a.png"]
    assert not leftovers(out)

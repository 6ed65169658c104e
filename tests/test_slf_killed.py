"""Sets of the data engine killed in the middle: the same command goes on to the same bytes.

Slow: the command is started, killed and started again as a process of its own.
"""

import hashlib
import os
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import cv2
import numpy as np
import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL"),
]

PROGRAM = [sys.executable, "-c", "from hybrid.cli import main; main()"]
BLENDER_PYTHON = os.environ.get("STRAIGHTLENS_BLENDER_PYTHON", "")
COUNT = 6
_LONGEST_S = 1800
KINDS = ("dwireframe", "panoramas", "rooms", "rooms by Blender")

# stands in for Blender: pictures that depend on the job alone, after a while
RENDERER = """#!{python}
import hashlib, json, sys, time
import cv2, numpy as np

for line in sys.stdin:
    job = json.loads(line)
    time.sleep({pause})
    words = [job["seed"], job["lens"], job["scene"]["rotation"], job["scene"]["centre"]]
    digest = hashlib.sha256(json.dumps(words).encode()).digest()
    noise = np.random.default_rng(list(digest)).integers(0, 255, (job["size"], job["size"], 3))
    for name in ("fisheye", "straight"):
        cv2.imwrite(job[name], noise.astype(np.uint8))
    sys.stdout.write("@result " + json.dumps({{"index": job["index"], "error": None}}) + "\\n")
    sys.stdout.flush()
"""


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A panorama of a checkered floor with dark pillars; it passes for a photograph, too."""
    folder = tmp_path_factory.mktemp("pictures")
    latitude, longitude = np.mgrid[90:-90:256j, -180:180:512j] * np.pi / 180
    x, z = (f(longitude) / np.tan(np.maximum(-latitude, 0.02)) for f in (np.sin, np.cos))
    floor = np.where((np.floor(x) + np.floor(z)) % 2 > 0, 230, 60)
    pillar = np.where(np.sin(6 * longitude) > 0.8, 30, 180)
    picture = np.where(latitude < -0.1, floor, pillar).astype(np.uint8)
    cv2.imwrite(str(folder / "hall.png"), np.repeat(picture[..., None], 3, axis=2))
    return folder


@pytest.fixture(scope="module")
def renderer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("renderer") / "blender"
    path.write_text(RENDERER.format(python=sys.executable, pause=0.5))
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


@pytest.fixture(scope="module", params=KINDS)
def words(request: pytest.FixtureRequest, pictures: Path, renderer: Path) -> list[str]:
    """A command without its output folder."""
    kinds = {
        "dwireframe": ["dwireframe", "--photos", str(pictures), "--size", "320", "--photometry"],
        "panoramas": ["panoramas", "--panoramas", str(pictures), "--size", "320"],
        "rooms": ["rooms", "--blender-python", str(renderer), "--size", "96"],
        "rooms by Blender": ["rooms", "--blender-python", BLENDER_PYTHON, "--size", "96"],
    }
    if request.param == "rooms by Blender" and not BLENDER_PYTHON:
        pytest.skip("STRAIGHTLENS_BLENDER_PYTHON not set")
    return ["synthesize", *kinds[request.param], "--count", str(COUNT), "--seed", "4"]


@pytest.fixture(scope="module")
def whole(words: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The set made in one go by one process."""
    out = tmp_path_factory.mktemp("whole") / "set"
    line = [*PROGRAM, *words, "--out", str(out), "--workers", "1"]
    subprocess.run(line, check=True, timeout=_LONGEST_S)
    return out


def fingerprint(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    names = [path.relative_to(folder).as_posix() for path in files]
    digests = [hashlib.sha256(path.read_bytes()).hexdigest() for path in files]
    return dict(zip(names, digests, strict=True))


def finished_items(out: Path) -> int:
    return len(list((out / "items").glob("[0-9]*.json")))


@contextmanager
def started(line: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    """A process in a group of its own, so that nothing of it outlives the test."""
    process = subprocess.Popen(
        [*PROGRAM, *line],
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def group_is_gone(group: int, *, within_s: float) -> bool:
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.2)
    return False


@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_killed_set_goes_on_to_the_same_bytes(
    words: list[str], whole: Path, workers: str, tmp_path: Path
) -> None:
    out = tmp_path / "set"
    line = [*words, "--out", str(out), "--workers", workers]
    with started(line) as process:
        end = time.monotonic() + _LONGEST_S
        while finished_items(out) < 2 and time.monotonic() < end:
            assert process.poll() is None, "it ended before it could be killed"
            time.sleep(0.005)
        process.kill()
        process.wait()
        # its workers and renderers notice that they are alone
        assert group_is_gone(process.pid, within_s=60)
    assert 2 <= finished_items(out) < COUNT
    subprocess.run([*PROGRAM, *line], check=True, timeout=_LONGEST_S)
    assert fingerprint(out) == fingerprint(whole)


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_makes_the_same_bytes(words: list[str], whole: Path, tmp_path: Path) -> None:
    pytest.importorskip("ray")
    out = tmp_path / "set"
    line = [*PROGRAM, *words, "--out", str(out), "--ray", "local"]
    subprocess.run(line, check=True, timeout=_LONGEST_S)
    assert fingerprint(out) == fingerprint(whole)

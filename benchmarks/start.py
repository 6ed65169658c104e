"""Cold starts, and peak memory of a process that rectifies one picture."""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path

from benchmarks.stages import SIZES, example
from benchmarks.timing import process, seconds
from hybrid import Picture, write_picture

COMMAND = "from hybrid.cli import main; main()"
METHODS = ("classical", "learned", "hybrid")
PEAK = """
import sys
from pathlib import Path
from hybrid import RectifyConfig, read_picture, rectify
picture = read_picture(sys.argv[1])
if len(sys.argv) > 2:
    rectify(picture.pixels, RectifyConfig(method=sys.argv[2]), throw=False)
# not ru_maxrss, which begins at that of the process that started this one
status = Path("/proc/self/status").read_text().splitlines()
print(next(line.split()[1] for line in status if line.startswith("VmHWM")))
"""


def measure_starts(rounds: int) -> dict[str, float]:
    """Seconds of processes; `import hybrid` by `-X importtime`, without the interpreter."""
    imports = [_import_time() for _ in range(rounds)]
    words = {
        "`python -c pass`": ("-c", "pass"),
        '`python -c "import hybrid"`': ("-c", "import hybrid"),
        "`straightlens --version`": ("-c", COMMAND, "--version"),
        "`straightlens rectify --help`": ("-c", COMMAND, "rectify", "--help"),
        "PyTorch alone": ("-c", "import torch"),
    }
    with tempfile.TemporaryDirectory() as folder:
        photo = Path(folder) / "photo.png"
        write_picture(photo, Picture(example(SIZES[0])))
        for method in METHODS:
            name = f"`straightlens rectify --method {method}`, 320x240"
            out = Path(folder) / method
            line = ("-c", COMMAND, "rectify", photo, "--out", out, "--overwrite")
            words[name] = (*map(str, line), "--method", method)
        found = {
            name: statistics.median(
                seconds(lambda line=line: process(*line)) for _ in range(rounds)
            )
            for name, line in words.items()
        }
    return {"`import hybrid`, as `-X importtime` counts": statistics.median(imports)} | found


def measure_memory() -> dict[str, list[float]]:
    """Peak resident memory in MB for each size: reading alone, then by each method (Linux)."""
    found: dict[str, list[float]] = {name: [] for name in ("reading the picture", *METHODS)}
    with tempfile.TemporaryDirectory() as folder:
        for size in SIZES:
            photo = Path(folder) / f"{size[0]}.png"
            write_picture(photo, Picture(example(size)))
            for name, values in found.items():
                chosen = [name] if name in METHODS else []
                values.append(int(process("-c", PEAK, photo, *chosen).split()[-1]) * 1.024e-3)
    return found


def _import_time() -> float:
    last = process("-X", "importtime", "-c", "import hybrid").splitlines()[-1]
    return float(last.split("|")[1]) / 1e6

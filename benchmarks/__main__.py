"""All figures of docs/benchmarks.md by one command, on an idle machine.

    python -m benchmarks [--parts stages,whole,networks,training,start,memory] [--rounds 7]

Parts that are not asked for keep their last figures, which out/benchmarks.json holds.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks.networks import measure_networks
from benchmarks.stages import BARE, SIZES, example, measure_stages, measure_whole
from benchmarks.start import measure_memory, measure_starts
from benchmarks.training_speed import measure_training
from classical.files import atomic_path
from learned.predictor import LINES_VIEW

ROOT = Path(__file__).parents[1]
PARTS = ("stages", "whole", "networks", "training", "start", "memory")
SECTIONS = {
    "whole": (
        "One picture",
        "From pixels to straight pixels, weights loaded, each time with another lens. `learned` "
        "looks for curves, too, to say how straight it leaves them.",
    ),
    "stages": (
        "Stages",
        f"Of the example picture. Line perception looks at no more than {LINES_VIEW} pixels "
        "across, LaRecNet at its frame. Maps are computed once for a lens.",
    ),
    "networks": (
        "PyTorch and ONNX Runtime",
        "One picture, in PyTorch as `rectify` runs it, with batch norms folded into convolutions. "
        "The first rows are how the shipped networks are used, on one thread so that an answer is "
        "the same to the last bit, while edges are found on others; the rest are both presets at "
        "the paper's frame, `paper` with random weights.",
    ),
    "training": (
        "Training",
        "Pictures a second on two cores: bf16, eight pictures a step, the making of data not "
        "counted. Phase one trains line perception, phase two the rest on samples made ahead.",
    ),
    "start": (
        "Cold start",
        "A new process each time, its files in memory. `import hybrid` loads neither PyTorch nor "
        "SciPy.",
    ),
    "memory": (
        "Peak memory",
        "Of a process that reads and rectifies one picture. Over 1,000 pictures it stays flat "
        "(`python -m benchmarks.memory`).",
    ),
}
HEADS = [f"{width}x{height}" for width, height in SIZES]


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--parts", default=",".join(PARTS))
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "benchmarks.md")
    parser.add_argument("--state", type=Path, default=ROOT / "out" / "benchmarks.json")
    options = parser.parse_args()
    state = json.loads(options.state.read_text()) if options.state.exists() else {}
    for part in options.parts.split(","):
        state[part] = measure(part, options.rounds)
    _write(options.state, json.dumps(state, indent=1))
    page = write_page(state)
    _write(options.out, page)
    print(page)


def measure(part: str, rounds: int) -> Any:
    """The figures of one part.

    Raises:
        ValueError: If there is no such part.
    """
    if part == "stages":
        return [measure_stages(example(size), rounds) for size in SIZES]
    if part == "whole":
        return [measure_whole(example(size), rounds) for size in SIZES]
    if part == "networks":
        return measure_networks(rounds)
    if part == "training":
        return measure_training(rounds)
    if part == "start":
        return measure_starts(rounds)
    if part == "memory":
        return measure_memory()
    raise ValueError(f"expected parts among {', '.join(PARTS)}, got {part!r}")


def write_page(state: dict[str, Any]) -> str:
    """The page in Markdown, of the parts that there are."""
    head = (
        f"# Speed\n\nMade by `make bench` on {_machine()}. Medians of wall-clock time; × is how "
        f"many times as long as a {BARE} of a picture of that size takes."
    )
    bare = [row[BARE] for row in state["stages"]] if "stages" in state else None
    tables = {
        "whole": lambda found: _table("whole `rectify`", HEADS, _by_size(found, bare)),
        "stages": lambda found: _table("stage", HEADS, _by_size(found, bare)),
        "networks": lambda found: _table(
            "network", ["PyTorch", "ONNX Runtime", "faster by"], _by_runtime(found)
        ),
        "training": lambda found: _table(
            "network",
            ["pictures a second"],
            {name: [_short(rate)] for name, rate in found.items()},
        ),
        "start": lambda found: _table(
            "process", ["time"], {name: [_duration(value)] for name, value in found.items()}
        ),
        "memory": lambda found: _table(
            "method", HEADS, {name: [f"{mb:.0f} MB" for mb in row] for name, row in found.items()}
        ),
    }
    blocks = [
        f"## {title}\n\n{words}\n\n{tables[part](state[part])}"
        for part, (title, words) in SECTIONS.items()
        if part in state
    ]
    return "\n\n".join([head, *blocks]) + "\n"


def _by_runtime(found: dict[str, dict[str, float]]) -> dict[str, list[str]]:
    """Rows of the networks."""
    rows = {}
    for name, times in found.items():
        torch, onnx = times["PyTorch"], times["ONNX Runtime"]
        rows[name] = [_duration(torch), _duration(onnx), f"{torch / onnx:.1f}×"]
    return rows


def _by_size(columns: list[dict[str, float]], bare: list[float] | None) -> dict[str, list[str]]:
    """Rows of durations, one column a size, with their ratio to a bare remap."""
    return {
        name: [
            _duration(column[name]) + (f" ({_short(column[name] / bare[i])}×)" if bare else "")
            for i, column in enumerate(columns)
        ]
        for name in columns[0]
    }


def _table(corner: str, heads: list[str], rows: dict[str, list[str]]) -> str:
    lines = [f"| {corner} | {' | '.join(heads)} |", f"|---|{'---:|' * len(heads)}"]
    lines += [f"| {name} | {' | '.join(cells)} |" for name, cells in rows.items()]
    return "\n".join(lines)


def _duration(value: float) -> str:
    return f"{value:.2f} s" if value >= 1 else f"{_short(1e3 * value)} ms"


def _short(value: float) -> str:
    """Two figures before the point, or as many behind it as are worth telling."""
    return f"{value:.0f}" if value >= 20 else f"{value:.1f}" if value >= 2 else f"{value:.2f}"


def _machine() -> str:
    """What matters of the machine, without its name."""
    names = ("numpy", "opencv-python-headless", "torch", "onnxruntime")
    versions = ", ".join(f"{name} {version(name)}" for name in names)
    return (
        f"{os.cpu_count()} cores of {platform.machine()} without a GPU, Python "
        f"{platform.python_version()}, {versions}"
    )


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()

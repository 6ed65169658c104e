"""Fuzz a reader with atheris (coverage-guided), outside of the test suite.

    pip install -e '.[fuzz,exr]'
    python tests/fuzz/fuzz.py picture -max_total_time=300

The first word is a target of fuzz_targets.py; what follows goes to libFuzzer. Inputs that found
something lie in out/fuzz/TARGET afterwards, and the last line counts the inputs.
"""

from __future__ import annotations

import logging
import os
import sys
import tempfile
import warnings
from pathlib import Path

import atheris

os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
ROOT = Path(__file__).resolve().parents[2]

with atheris.instrument_imports(include=["classical", "hybrid", "PIL", "tifffile", "yaml", "json"]):
    import tifffile  # noqa: F401
    import yaml  # noqa: F401
    from fuzz_targets import TARGETS, seeds


def main() -> None:
    """Run one target until libFuzzer is told to stop or something is found."""
    if len(sys.argv) < 2 or sys.argv[1] not in TARGETS:
        sys.exit(f"usage: {sys.argv[0]} {'|'.join(TARGETS)} [libFuzzer options]")
    name = sys.argv.pop(1)
    logging.getLogger("tifffile").setLevel(logging.CRITICAL)
    warnings.simplefilter("ignore")
    out = ROOT / "out" / "fuzz" / name
    corpus = out / "corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="fuzz-", dir=_memory()) as folder:
        here = Path(folder)
        for number, seed in enumerate(seeds(name, here)):
            (corpus / f"seed{number}").write_bytes(seed)
        target = TARGETS[name]
        options = [
            f"-artifact_prefix={out}/",
            "-timeout=30",
            "-rss_limit_mb=3000",
            "-max_len=65536",
        ]

        def one_input(data: bytes) -> None:
            target(data, here)

        atheris.Setup([sys.argv[0], *options, *sys.argv[1:], str(corpus)], one_input)
        atheris.Fuzz()


def _memory() -> str | None:
    """A folder in memory, where there is one."""
    return "/dev/shm" if Path("/dev/shm").is_dir() else None


if __name__ == "__main__":
    main()

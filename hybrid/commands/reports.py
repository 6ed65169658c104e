"""One report an item: what came of it, and how that is told."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from tqdm import tqdm

from classical.camera import Residual

T = TypeVar("T")
Report = dict[str, Any]
FAILURE = 1  # exit code when an item failed
ITEM_ERRORS = (OSError, ValueError, MemoryError)  # they end one item, not the command


def failure(source: Path, error: Exception) -> Report:
    """The report of an item that came to nothing because of one of `ITEM_ERRORS`."""
    if isinstance(error, MemoryError):
        reason = "not enough memory"
    else:  # without the path that the report names anyway
        text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        reason = " ".join(text.split()).removeprefix(f"{source}: ")
    return {"input": str(source), "status": "failed", "reason": reason}


def progress(items: Sequence[T]) -> Iterator[T]:
    """The items behind a bar on stderr, if there are many and someone looks."""
    return iter(tqdm(items, file=sys.stderr, disable=len(items) < 2 or not sys.stderr.isatty()))


def nearness(residual: Residual | None) -> str:
    """How near a written camera model comes to the lens, in words; empty where it is the same."""
    if residual is None:
        return ""
    rms, most = residual
    return f"; the written model is off by {rms:.3g} px rms, {most:.3g} px at most"


def tell(report: Report, *, as_json: bool) -> None:
    """One line an item: results on stdout, failures on stderr."""
    if as_json:
        tqdm.write(json.dumps(report, allow_nan=False), file=sys.stdout)
    if report["status"] == "failed":
        line = f"straightlens: {report['input']}: {report['reason']}"
        tqdm.write(line, file=sys.stderr)
    elif not as_json:
        line = f"{report['input']} -> {report['output']}  {report['status']}: {report['reason']}"
        tqdm.write(line, file=sys.stdout)

"""One report an item: what came of it, and how that is told."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from tqdm import tqdm

from classical.camera import Residual
from hybrid.failures import reason_of

T = TypeVar("T")
Report = dict[str, Any]
FAILURE = 1  # exit code when an item failed


def failure(source: Path, error: Exception) -> Report:
    """The report of an item that came to nothing because of one of `ITEM_ERRORS`."""
    return {"input": str(source), "status": "failed", "reason": reason_of(error, source)}


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
        tqdm.write(_printable(line), file=sys.stderr)
    elif not as_json:
        line = f"{report['input']} -> {report['output']}  {report['status']}: {report['reason']}"
        tqdm.write(_printable(line), file=sys.stdout)


def _printable(line: str) -> str:
    """A line on which no file name can break out."""
    return "".join(
        char if char.isprintable() else char.encode("unicode_escape").decode() for char in line
    )

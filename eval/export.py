"""Scores as CSV: one row a suite and method, and one row a photograph and method."""

import csv
import io
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from eval.summary import SuiteScores, median, upper


def summary_rows(suites: Sequence[SuiteScores]) -> Iterator[dict[str, Any]]:
    """One row a suite and method, with the means and quantiles of the tables."""
    for suite in suites:
        for row in suite.methods:
            out: dict[str, Any] = {
                "suite": suite.name,
                "method": row.method.tag,
                "n": len(suite.names),
            }
            out["failed"] = int(row.failed.sum())
            for protocol in ("paper", "aligned"):
                counts = row.counts(protocol)
                out[f"{protocol}_f"] = "" if counts is None else _plain(counts.f_score)
                for key in ("psnr", "ssim", "rpe"):
                    values = row.values(protocol, key)
                    out[f"{protocol}_{key}_mean"] = _plain(float(np.mean(values)))
                    out[f"{protocol}_{key}_median"] = _plain(median(values))
                    out[f"{protocol}_{key}_p90"] = _plain(upper(values))
            for key in ("straightness", "angular_error", "seconds"):
                out[f"{key}_median"] = _plain(median(row.values(key)))
                out[f"{key}_p90"] = _plain(upper(row.values(key)))
            yield out


def score_rows(suites: Sequence[SuiteScores]) -> Iterator[dict[str, Any]]:
    """One row a photograph and method."""
    for suite in suites:
        for row in suite.methods:
            for index, record in enumerate(row.records):
                out: dict[str, Any] = {
                    "suite": suite.name,
                    "picture": suite.names[index],
                    "group": suite.groups[index],
                    "fov": round(float(suite.fov[index]), 2),
                    "method": row.method.tag,
                    "status": record["status"],
                    "reason": record["reason"],
                }
                for protocol in ("paper", "aligned"):
                    for key in ("psnr", "ssim", "f", "rpe"):
                        out[f"{protocol}_{key}"] = _plain(record[protocol].get(key))
                for key in ("straightness", "angular_error", "focal_error", "predicted_error_px"):
                    out[key] = _plain(record[key])
                out["seconds"] = _plain(record["seconds"])
                yield out


def to_csv(rows: Iterable[dict[str, Any]]) -> str:
    """Rows of one shape as CSV with a heading."""
    listed = list(rows)
    stream = io.StringIO()
    writer = csv.DictWriter(stream, fieldnames=list(listed[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(listed)
    return stream.getvalue()


def _plain(value: float | None) -> float | str:
    return "" if value is None or not math.isfinite(value) else round(value, 6)

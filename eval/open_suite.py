"""Find out what kind of test set lies in a folder, and read it for the two loops."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from classical.camera import KannalaBrandt
from eval.cases import Case, Suite
from eval.metrics import aligned_error
from learned.slf.suite import FORMAT, SuiteFolder, SuiteItem

_SPACING = 4.0  # pixels between the samples that tell how bent a picture is


def open_suite(path: Path, *, min_bend: float = 0.0, every: int = 1) -> Suite:
    """Read a test set.

    Args:
        path: A folder with `suite.json`, either one of ours (`learned.slf.suite`) or a list of
            calibrated photographs: `image width height fx fy cx cy D camera`, the camera being
            r(θ) = f (θ + D1 θ³ + D2 θ⁵ + D3 θ⁷ + D4 θ⁹).
        min_bend: Leave out pictures whose aligned error, left alone, is below so many pixels of
            the 320 px frame: lenses that are nearly straight already.
        every: Take each so-many-th picture only.

    Raises:
        ValueError: If there is no such set, or nothing is left of it.
    """
    file = path / "suite.json" if path.is_dir() else path
    if not file.is_file():
        raise ValueError(f"expected a folder with suite.json, got {path}")
    record = json.loads(file.read_text(encoding="utf-8"))
    if isinstance(record, list):
        suite = _photographs(file, record)
    elif isinstance(record, dict) and record.get("format") == FORMAT:
        suite = _synthesised(SuiteFolder(file.parent), record)
    else:
        raise ValueError(f"expected a suite of {FORMAT!r} or a list of photographs in {file}")
    cases = [case for case in suite.cases if min_bend <= 0 or bend(case) >= min_bend][::every]
    if not cases:
        raise ValueError(f"expected pictures bent by {min_bend} px or more in {file}, got none")
    note = suite.note
    if min_bend > 0 and (left_out := len(suite.cases) - len(cases)) and every == 1:
        note += f" {left_out} nearly straight pictures (under {min_bend:g} px) are left out."
    return replace(suite, cases=tuple(cases), note=note.strip())


def bend(case: Case) -> float:
    """Aligned error of a picture that is left alone, in pixels of the 320 px frame."""
    camera = case.camera
    size = {"width": camera.width, "height": camera.height}
    return aligned_error(None, camera, **size, spacing=_SPACING)


def _synthesised(folder: SuiteFolder, header: dict[str, Any]) -> Suite:
    cases = tuple(_case(folder, item) for item in folder)
    name = str(header.get("name") or folder.path.name)
    note = str(header.get("note") or "")
    return Suite(name, cases, is_real=False, note=note)


def _case(folder: SuiteFolder, item: SuiteItem) -> Case:
    straight = folder.straight(item.index)
    return Case(
        name=f"{item.index:06d}",
        picture=folder.picture(item.index),
        camera=item.camera,
        group=item.origin,
        curves=tuple(curve.points for curve in item.curves),
        straight=straight if straight.is_file() else None,
    )


def _photographs(file: Path, entries: list[dict[str, Any]]) -> Suite:
    try:
        cases = tuple(_photograph(file.parent, entry) for entry in entries)
    except KeyError as error:
        raise ValueError(f"expected {error} in every entry of {file}") from error
    return Suite(file.parent.name, cases, is_real=True, note="Real photographs of known lenses.")


def _photograph(folder: Path, entry: dict[str, Any]) -> Case:
    width, height = int(entry["width"]), int(entry["height"])
    K = np.array([[entry["fx"], 0, entry["cx"]], [0, entry["fy"], entry["cy"]], [0, 0, 1]], float)
    camera = KannalaBrandt.from_opencv(K, np.array(entry["D"], float), width, height)
    limit = entry.get("theta_max_deg")
    if limit is not None and not 0 < math.radians(limit) <= math.pi:
        raise ValueError(f"expected theta_max_deg in (0, 180], got {limit}")
    name = Path(entry["image"]).with_suffix("").as_posix().replace("/", "__")
    group = str(entry.get("camera") or Path(entry["image"]).parent.as_posix())
    return Case(name, folder / entry["image"], camera, group)

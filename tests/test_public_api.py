"""The names that users import, and that they are this project's."""

import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import hybrid

ROOT = Path(__file__).resolve().parents[1]
NAMES = {
    "Calibration",
    "CameraFile",
    "KannalaBrandt",
    "Picture",
    "Pinhole",
    "Quality",
    "Rectification",
    "RectificationError",
    "Rectifier",
    "RectifyConfig",
    "calibrate",
    "draw_curves",
    "read_camera",
    "read_picture",
    "rectify",
    "write_camera",
    "write_picture",
}
SUBMODULES = {path.stem for path in (ROOT / "hybrid").glob("*.py")}


def test_hybrid_is_ours():
    assert hybrid.__file__ is not None
    assert Path(hybrid.__file__).is_relative_to(ROOT)


def test_exported_names_are_pinned():
    names = vars(hybrid).items()
    public = {name for name, value in names if name[0] != "_" and not inspect.ismodule(value)}
    assert public == NAMES


def test_no_exported_name_hides_a_submodule():
    assert not NAMES & SUBMODULES


HEAVY = {"torch", "scipy", "skimage", "nlopt", "matplotlib", "tifffile", "click", "yaml"}


@pytest.mark.parametrize(
    "statement", ["import hybrid", f"from hybrid import {', '.join(sorted(NAMES))}"]
)
def test_importing_hybrid_loads_no_heavy_package(statement):
    # NumPy, OpenCV and Pillow are what is left: a cold start of some 0.25 s
    code = f"import sys; {statement}; print(*{HEAVY} & set(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert done.stdout.split() == []

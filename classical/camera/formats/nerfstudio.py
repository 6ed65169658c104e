"""The camera in nerfstudio's transforms.json, model OPENCV_FISHEYE.

Pixels count from the outer corner of the top-left one, whose centre is (0.5, 0.5), as in COLMAP.
The poses of the pictures, `frames`, are somebody else's: an exported file has none.
"""

from __future__ import annotations

import json

from classical.camera.formats.colmap import CORNER
from classical.camera.formats.fisheye import fisheye_camera, fisheye_parameters
from classical.camera.formats.record import Content, shown
from classical.camera.kannala_brandt import KannalaBrandt

_MODEL = "OPENCV_FISHEYE"
_RADIAL = ("k1", "k2", "k3", "k4")
_TANGENTIAL = ("p1", "p2")


def dump(camera: KannalaBrandt) -> str:
    """The intrinsics of all frames, and an empty list of frames to fill in."""
    (fx, fy, cx, cy), coefficients = fisheye_parameters(camera)
    fields = {
        "camera_model": _MODEL,
        "w": camera.width,
        "h": camera.height,
        "fl_x": fx,
        "fl_y": fy,
        "cx": cx + CORNER,
        "cy": cy + CORNER,
        **dict(zip(_RADIAL, coefficients, strict=True)),
        "frames": [],
    }
    return json.dumps(fields, indent=2) + "\n"


def matches(content: Content) -> bool:
    """True for a record with fl_x or frames."""
    return "fl_x" in content.record or "frames" in content.record


def load(content: Content) -> dict[str, KannalaBrandt]:
    """The camera that all frames share."""
    record = content.record
    model = record.text("camera_model", default="?")
    if model != _MODEL:
        raise ValueError(f"expected the camera_model {_MODEL}, got {shown(model)}")
    if any(name in record and record.number(name) != 0 for name in _TANGENTIAL):
        raise ValueError("expected no tangential distortion, got p1 or p2")
    fx, fy = record.number("fl_x"), record.number("fl_y")
    cx, cy = record.number("cx") - CORNER, record.number("cy") - CORNER
    D = [record.number(name) if name in record else 0.0 for name in _RADIAL]
    return {"camera": fisheye_camera((fx, fy, cx, cy), D, record.size("w", "h"))}

"""The lens in a file of this project: Kannala–Brandt as it is used here, or a division model.

JSON with "format": "straightlens camera"; pixels count from the centre of the top-left one.
"""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from classical.camera.convert import Residual, nearest_kannala_brandt
from classical.camera.division import Division
from classical.camera.formats.record import Content, Record, shown
from classical.camera.kannala_brandt import N_COEFFICIENTS, KannalaBrandt

FORMAT = "straightlens camera"
VERSION = 1
_NUMBERS = ("m_u", "m_v", "u0", "v0")
_MODELS = ("kannala-brandt", "division")


def header() -> dict[str, Any]:
    """The fields that say what kind of file it is."""
    return {"format": FORMAT, "version": VERSION}


def lens_fields(camera: KannalaBrandt) -> dict[str, Any]:
    """The lens in plain numbers: our parameters, θ_max in degrees, and OpenCV's K and D."""
    K, D = camera.to_opencv()
    return {
        "model": _MODELS[0],
        "k": camera.k.tolist(),
        **{name: float(getattr(camera, name)) for name in _NUMBERS},
        "width": camera.width,
        "height": camera.height,
        "theta_max_degrees": math.degrees(camera.theta_max),
        "opencv_fisheye": {"K": K.tolist(), "D": D.tolist()},
    }


def dump_division(camera: Division, residual: Residual) -> str:
    """A file with the division model and how near it comes to the lens."""
    fields = {
        **header(),
        "model": _MODELS[1],
        "lambda": camera.lambda_,
        "focal": camera.focal_px,
        "u0": camera.u0,
        "v0": camera.v0,
        "width": camera.width,
        "height": camera.height,
        "residual": residual._asdict(),
    }
    return json.dumps(fields, indent=2) + "\n"


def matches(content: Content) -> bool:
    """True for a record of our format."""
    return content.record.text("format", default="") == FORMAT


def load(content: Content) -> dict[str, KannalaBrandt]:
    """The lens; of a division model the nearest."""
    record = content.record
    if record.number("version") != VERSION:
        raise ValueError(f"expected version {VERSION}, got {record.number('version'):g}")
    model = record.text("model", default="")
    if model not in _MODELS:
        raise ValueError(f"expected the model {' or '.join(_MODELS)}, got {shown(model)}")
    return {"camera": _division(record) if model == _MODELS[1] else _kannala_brandt(record)}


def _kannala_brandt(record: Record) -> KannalaBrandt:
    m_u, m_v, u0, v0 = (record.number(name) for name in _NUMBERS)
    size = record.size("width", "height")
    return KannalaBrandt(record.numbers("k", count=N_COEFFICIENTS), m_u, m_v, u0, v0, *size)


def _division(record: Record) -> KannalaBrandt:
    size = record.size("width", "height")
    lambda_, u0, v0, focal = (record.number(name) for name in ("lambda", "u0", "v0", "focal"))
    with np.errstate(all="ignore"):  # what overflows is not finite, and refused for that
        return nearest_kannala_brandt(Division(lambda_, u0, v0, *size, focal=focal))

"""camera.json: a lens in words that other programs can read.

The file holds the Kannala–Brandt parameters as this project uses them and the same lens as OpenCV's
fisheye model (K and D). Reading takes the first; the second is for other programs.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from classical.camera import KannalaBrandt
from classical.files import atomic_path
from hybrid.result import Quality, Status

FORMAT = "straightlens camera"
VERSION = 1
_NUMBERS = ("m_u", "m_v", "u0", "v0")


@dataclass(frozen=True, eq=False)
class CameraFile:
    """What a camera file holds.

    Attributes:
        camera: The lens.
        status: `ok` or `degraded`.
        reason: Why, in words.
        quality: How far to trust it.
    """

    camera: KannalaBrandt
    status: Status
    reason: str
    quality: Quality


def camera_dict(camera: KannalaBrandt) -> dict[str, Any]:
    """The lens in plain numbers: our parameters, θ_max in degrees, and OpenCV's K and D."""
    K, D = camera.to_opencv()
    return {
        "model": "kannala-brandt",
        "k": camera.k.tolist(),
        **{name: float(getattr(camera, name)) for name in _NUMBERS},
        "width": camera.width,
        "height": camera.height,
        "theta_max_degrees": math.degrees(camera.theta_max),
        "opencv_fisheye": {"K": K.tolist(), "D": D.tolist()},
    }


def quality_dict(quality: Quality) -> dict[str, Any]:
    """The quality in plain numbers; what is not known is null, as JSON has no NaN."""
    return {
        "rms_px": _finite(quality.rms_px),
        "n_curves": quality.n_curves,
        "n_inliers": quality.n_inliers,
        "predicted_error_px": _finite(quality.predicted_error_px),
        "scale_source": quality.scale_source,
        "scale_deviation": _finite(quality.scale_deviation),
        "covariance": quality.covariance.tolist(),
    }


def write_camera(path: str | os.PathLike[str], content: CameraFile) -> None:
    """Write a camera file, whole or not at all."""
    fields = {
        "format": FORMAT,
        "version": VERSION,
        "status": content.status,
        "reason": content.reason,
        **camera_dict(content.camera),
        "quality": quality_dict(content.quality),
    }
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(fields, indent=2) + "\n", encoding="utf-8")


def read_camera(path: str | os.PathLike[str]) -> CameraFile:
    """Read a camera file.

    Raises:
        FileNotFoundError: If there is none.
        ValueError: If it is no camera file of a version that is known; the message names the file
            and the field.
    """
    try:
        fields = json.loads(Path(path).read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path}: not a camera file: {error}") from None
    if not isinstance(fields, dict) or fields.get("format") != FORMAT:
        raise ValueError(f'{path}: not a camera file: expected "format": "{FORMAT}"')
    if fields.get("version") != VERSION:
        raise ValueError(f"{path}: expected version {VERSION}, got {fields.get('version')!r}")
    if fields.get("model") != "kannala-brandt":
        raise ValueError(f"{path}: expected the model kannala-brandt, got {fields.get('model')!r}")
    try:
        return CameraFile(
            _camera(fields), _status(fields), str(fields.get("reason", "")), _quality(fields)
        )
    except KeyError as error:
        raise ValueError(f"{path}: the field {error.args[0]!r} is missing") from None
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from None


def _camera(fields: dict[str, Any]) -> KannalaBrandt:
    m_u, m_v, u0, v0 = (float(fields[name]) for name in _NUMBERS)
    k = np.array(fields["k"], dtype=np.float64)
    if k.shape != (5,):
        raise ValueError(f"expected k of shape (5,), got {k.shape}")
    return KannalaBrandt(k, m_u, m_v, u0, v0, int(fields["width"]), int(fields["height"]))


def _status(fields: dict[str, Any]) -> Status:
    status = fields.get("status", "ok")
    if status not in ("ok", "degraded"):
        raise ValueError(f"expected the status ok or degraded, got {status!r}")
    return status


def _quality(fields: dict[str, Any]) -> Quality:
    quality = fields.get("quality", {})
    covariance = np.array(quality.get("covariance", np.zeros((9, 9))), dtype=np.float64)
    if covariance.shape != (9, 9):
        raise ValueError(f"expected a covariance of shape (9, 9), got {covariance.shape}")
    return Quality(
        rms_px=_number(quality.get("rms_px")),
        n_curves=int(quality.get("n_curves", 0)),
        n_inliers=int(quality.get("n_inliers", 0)),
        covariance=covariance,
        predicted_error_px=_number(quality.get("predicted_error_px")),
        scale_source=str(quality.get("scale_source", "")),
        scale_deviation=_number(quality.get("scale_deviation")),
    )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)

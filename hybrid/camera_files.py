"""Camera files: ours, which says how far to trust the lens, and those of other programs.

Ours is JSON with the Kannala–Brandt parameters as this project uses them and the same lens as K and
D of `cv2.fisheye`. `classical.camera.formats` holds the other formats; an ST-map is a warp that
carries our file in its header.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from typing import Any

import numpy as np

from classical.camera import KannalaBrandt, Residual
from classical.camera.formats import (
    CAMERA_FORMATS,
    Content,
    Record,
    cameras_of,
    chosen_camera,
    kind_of,
    read_content,
    shown,
    straightlens,
)
from classical.files import atomic_path
from classical.warp import (
    distort_maps,
    is_stmap_name,
    read_stmap_note,
    undistort_maps,
    write_stmap,
)
from hybrid.config import RectifyConfig
from hybrid.pipeline import straight_target
from hybrid.result import Quality, Status

OWN_FORMAT = "straightlens"
_FORMATS = {row.name: row for row in CAMERA_FORMATS}
_STMAPS = {"stmap": undistort_maps, "stmap-redistort": distort_maps}
_KNOWN_QUALITY = ("rms_px", "predicted_error_px", "scale_deviation")  # NaN where they are not


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


def format_names() -> tuple[str, ...]:
    """Names of the formats that `write_camera` knows."""
    return (OWN_FORMAT, *_FORMATS, *_STMAPS)


def format_suffix(kind: str) -> str:
    """The usual ending of the files of a format."""
    return _FORMATS[kind].suffix if kind in _FORMATS else ".tif" if kind in _STMAPS else ".json"


def write_camera(
    path: str | os.PathLike[str],
    content: CameraFile,
    kind: str = OWN_FORMAT,
    *,
    frame: RectifyConfig = RectifyConfig(),
) -> Residual | None:
    """Write a camera file, whole or not at all.

    Args:
        path: Where to; an ST-map ends in .exr, .tif or .tiff.
        content: The lens; what is known about it is kept in our own format and in ST-maps.
        kind: One of `format_names`.
        frame: The straight picture of an ST-map.

    Returns:
        How near the written model comes to the lens, where it is another model; else None.

    Raises:
        ValueError: If there is no such format, or the lens cannot be written in it.
        OSError: If the file cannot be written.
    """
    if kind not in format_names():
        raise ValueError(f"Expected a format in {', '.join(format_names())}, got {kind!r}.")
    if kind in _STMAPS:
        target = straight_target(content.camera, frame)
        write_stmap(path, _STMAPS[kind](content.camera, target), note=_own_text(content))
        return None
    text, residual = _own_text(content), None
    if kind in _FORMATS:
        text, residual = _FORMATS[kind].export(content.camera)
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return residual


def read_camera(path: str | os.PathLike[str], camera: str | None = None) -> CameraFile:
    """Read a camera file of any format that `write_camera` knows, told by its content.

    Args:
        path: The file.
        camera: Which camera, where the file holds several (cam0 of Kalibr, a number of COLMAP).

    Raises:
        FileNotFoundError: If there is none.
        ValueError: If it is no camera file; the message names the file and the field.
    """
    try:
        is_map = is_stmap_name(path)
        content = Content(read_stmap_note(path)) if is_map else read_content(path)
        lens = chosen_camera(cameras_of(content), camera)
        if kind_of(content) is not straightlens:
            return CameraFile(lens, "ok", "read from a file of another program", Quality())
        return CameraFile(lens, *_trust(content.record))
    except ValueError as error:
        raise ValueError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None


def quality_dict(quality: Quality) -> dict[str, Any]:
    """The quality in plain numbers; what is not known is null, as JSON has no NaN."""
    known = {name: getattr(quality, name) for name in _KNOWN_QUALITY}
    return {
        "n_curves": quality.n_curves,
        "n_inliers": quality.n_inliers,
        "scale_source": quality.scale_source,
        "covariance": quality.covariance.tolist(),
    } | {name: float(value) if math.isfinite(value) else None for name, value in known.items()}


def _own_text(content: CameraFile) -> str:
    fields = {
        **straightlens.header(),
        "status": content.status,
        "reason": content.reason,
        **straightlens.lens_fields(content.camera),
        "quality": quality_dict(content.quality),
    }
    return json.dumps(fields, indent=2) + "\n"


def _trust(record: Record) -> tuple[Status, str, Quality]:
    """What our own file says beside the lens."""
    status = record.text("status", default="ok")
    if status != "ok" and status != "degraded":
        raise ValueError(f"expected the status ok or degraded, got {shown(status)}")
    reason = record.text("reason", default="")
    return status, reason, _quality(record.part("quality")) if "quality" in record else Quality()


def _quality(record: Record) -> Quality:
    covariance = np.zeros(81)
    if "covariance" in record:
        covariance = record.numbers("covariance", count=81)
    known = {name: record.optional_number(name) for name in _KNOWN_QUALITY}
    counts = (record.optional_number(name) for name in ("n_curves", "n_inliers"))
    n_curves, n_inliers = (0 if math.isnan(count) else int(count) for count in counts)
    return Quality(
        n_curves=n_curves,
        n_inliers=n_inliers,
        covariance=covariance.reshape(9, 9),
        scale_source=record.text("scale_source", default=""),
        **known,
    )

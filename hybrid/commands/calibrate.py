"""The command `straightlens calibrate`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from classical.camera import Residual
from classical.camera.formats import lens_fields
from hybrid.arrays import unit_range
from hybrid.camera_files import CameraFile, quality_dict, write_camera
from hybrid.commands import options
from hybrid.commands.checks import (
    check_camera_name,
    make_folder,
    misuse,
    pictures,
    refuse_existing,
    usage_error,
)
from hybrid.commands.reports import FAILURE, Report, failure, nearness, progress, tell
from hybrid.config import RectifyConfig
from hybrid.failures import ITEM_ERRORS
from hybrid.images import read_picture
from hybrid.pipeline import Rectifier
from hybrid.result import Calibration


@click.command()
@options.paths
@click.option(
    "--out",
    required=True,
    type=options.NEW_FILE,
    help="The camera file to write, e.g. camera.json.",
)
@options.kind
@options.lens
@options.frame
@options.overwrite
@options.as_json("the result as one JSON object")
@options.threads
def calibrate(
    paths: tuple[Path, ...], out: Path, kind: str, overwrite: bool, as_json: bool, **chosen: Any
) -> int:
    """Find the one lens that took all the pictures, in one joint fit.

    A file that cannot be read is reported and left out; the exit code is then 1. --fov, --focal,
    --balance and --size choose the straight picture of an ST-map.
    """
    with misuse():
        config = RectifyConfig(**chosen)
    sources = pictures(paths)
    refuse_existing([out], overwrite=overwrite)
    check_camera_name(out, kind)
    unread, images = _read_all(sources)
    if not images:
        raise click.ClickException("none of the pictures could be read")
    _check_one_size(images)
    found = Rectifier(config).calibrate(list(images.values()))
    residual = None
    if found.camera is not None:
        make_folder(out.parent)
        content = CameraFile(found.camera, found.status, found.reason, found.quality)
        residual = write_camera(out, content, kind, frame=config)
    _tell(found, out, residual, len(images), unread if as_json else None)
    return FAILURE if unread or found.camera is None else 0


def _read_all(sources: Sequence[Path]) -> tuple[list[Report], dict[Path, np.ndarray]]:
    """The reports of the files that cannot be read, and the pictures of the others."""
    unread: list[Report] = []
    images: dict[Path, np.ndarray] = {}
    for source in progress(sources):
        try:
            images[source] = unit_range(read_picture(source).pixels)
        except ITEM_ERRORS as error:
            unread.append(failure(source, error))
            tell(unread[-1], as_json=False)
    return unread, images


def _check_one_size(images: dict[Path, np.ndarray]) -> None:
    """Pictures of one lens have one size; the complaint names the files."""
    sizes = {image.shape[1::-1]: path for path, image in images.items()}
    if len(sizes) > 1:
        told = [f"{path} is {w}x{h}" for (w, h), path in list(sizes.items())[:2]]
        raise usage_error(f"pictures of one lens have one size, but {' and '.join(told)}")


def _tell(
    found: Calibration,
    out: Path,
    residual: Residual | None,
    n_images: int,
    unread: list[Report] | None,
) -> None:
    """The result: JSON if the list of unread files is given, else in words."""
    failed = found.camera is None
    if unread is not None:
        report = {
            "status": "failed" if failed else found.status,
            "reason": found.reason,
            "n_images": n_images,
            "unread": unread,
            "camera_file": None if failed else str(out),
            "residual": None if residual is None else residual._asdict(),
            "camera": None if found.camera is None else lens_fields(found.camera),
            "quality": quality_dict(found.quality),
        }
        click.echo(json.dumps(report, allow_nan=False))
    if failed:
        click.echo(f"straightlens: no lens found: {found.reason}", err=True)
    elif unread is None:
        noun = "picture" if n_images == 1 else "pictures"
        words = f"{found.status}: {found.reason}{nearness(residual)}"
        click.echo(f"{n_images} {noun} -> {out}  {words}")

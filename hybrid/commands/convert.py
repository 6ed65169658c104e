"""The command `straightlens convert`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from hybrid.camera_files import read_camera, write_camera
from hybrid.commands import options
from hybrid.commands.checks import (
    check_camera_name,
    make_folder,
    misuse,
    refuse_existing,
    refuse_inputs,
)
from hybrid.commands.reports import nearness
from hybrid.config import RectifyConfig


@click.command()
@click.argument("camera", type=options.EXISTING_FILE)
@click.option("--out", required=True, type=options.NEW_FILE, help="The camera file to write.")
@options.kind
@options.camera_name
@options.frame
@options.overwrite
@options.as_json("the result as one JSON object")
def convert(
    camera: Path,
    out: Path,
    kind: str,
    camera_name: str | None,
    overwrite: bool,
    as_json: bool,
    **frame: Any,
) -> None:
    """Write a camera file in another format.

    CAMERA is a file of any of the formats. --fov, --focal, --balance and --size choose the straight
    picture of an ST-map.
    """
    with misuse():
        config = RectifyConfig(**frame)
        content = read_camera(camera, camera_name)
    check_camera_name(out, kind)
    refuse_inputs([out], [camera])
    refuse_existing([out], overwrite=overwrite)
    make_folder(out.parent)
    residual = write_camera(out, content, kind, frame=config)
    if as_json:
        told = None if residual is None else residual._asdict()
        click.echo(json.dumps({"input": str(camera), "camera_file": str(out), "residual": told}))
    else:
        click.echo(f"{camera} -> {out}  {kind}{nearness(residual)}")

"""The command `straightlens rectify`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from classical.camera.formats import lens_fields
from hybrid.arrays import unit_range
from hybrid.camera_files import (
    CameraFile,
    format_suffix,
    quality_dict,
    read_camera,
    write_camera,
)
from hybrid.commands import options
from hybrid.commands.checks import (
    make_folder,
    misuse,
    pictures,
    refuse_existing,
    refuse_inputs,
    usage_error,
)
from hybrid.commands.reports import FAILURE, Report, failure, nearness, progress, tell
from hybrid.config import RectifyConfig
from hybrid.exif import straight_exif
from hybrid.failures import ITEM_ERRORS
from hybrid.images import Picture, is_picture_name, read_picture, write_picture
from hybrid.overlay import draw_curves
from hybrid.pipeline import Rectifier


@click.command()
@options.paths
@click.option(
    "--out",
    required=True,
    type=options.NEW_FOLDER,
    help="Folder for the straight pictures and their NAME.camera.json; made if there is none.",
)
@options.lens
@options.camera
@options.camera_name
@options.kind
@options.frame
@click.option("--overlay", is_flag=True, help="Also write NAME.overlay.png with the curves.")
@options.overwrite
@options.as_json("one JSON object a picture")
@options.threads
def rectify(
    paths: tuple[Path, ...],
    out: Path,
    camera: Path | None,
    camera_name: str | None,
    kind: str,
    overlay: bool,
    overwrite: bool,
    as_json: bool,
    **chosen: Any,
) -> int:
    """Straighten pictures: files, and all pictures in folders.

    Each picture is taken on its own; for many pictures of one lens run `calibrate` first and pass
    its file with --camera. A picture that cannot be read or tells nothing about its lens is
    reported, the others are done, and the exit code is 1.
    """
    with misuse():
        config = RectifyConfig(**chosen)
        known = None if camera is None else read_camera(camera, camera_name)
    sources = pictures(paths)
    jobs = [_job(source, out, kind, overlay) for source in sources]
    _refuse_losses(jobs, overwrite)
    make_folder(out)
    rectifier = Rectifier(config)
    failed = False
    for job in progress(jobs):
        try:
            report = _rectify_one(job, rectifier, known, kind)
        except ITEM_ERRORS as error:
            report = failure(job.source, error)
        failed |= report["status"] == "failed"
        tell(report, as_json=as_json)
    return FAILURE if failed else 0


@dataclass(frozen=True)
class _Job:
    """A picture and the files that come of it."""

    source: Path
    picture: Path
    camera: Path
    overlay: Path | None

    def outputs(self) -> list[Path]:
        files = [self.picture, self.camera, self.overlay]
        return [path for path in files if path is not None]


def _refuse_losses(jobs: Sequence[_Job], overwrite: bool) -> None:
    """Misuse of all jobs where files would be lost."""
    outputs = [path for job in jobs for path in job.outputs()]
    doubles = [path for path, number in Counter(outputs).items() if number > 1]
    if doubles:
        raise usage_error(f"two inputs would both write {doubles[0]}")
    refuse_inputs(outputs, [job.source for job in jobs])
    refuse_existing(outputs, overwrite=overwrite)


def _job(source: Path, out: Path, kind: str, overlay: bool) -> _Job:
    name = source.name if is_picture_name(source) else f"{source.name}.png"
    drawn = out / f"{source.stem}.overlay.png" if overlay else None
    return _Job(source, out / name, out / f"{source.stem}.camera{format_suffix(kind)}", drawn)


def _rectify_one(job: _Job, rectifier: Rectifier, known: CameraFile | None, kind: str) -> Report:
    """Read, rectify and write one picture."""
    picture = read_picture(job.source)
    camera = None if known is None else known.camera
    result = rectifier.rectify(unit_range(picture.pixels), camera=camera, throw=False)
    report: Report = {"input": str(job.source), "status": result.status}
    report["reason"] = result.reason
    if result.status == "failed":
        return report
    exif = picture.exif
    if result.camera is not None and result.target is not None:
        exif = straight_exif(exif, result.camera, result.target)
    write_picture(job.picture, replace(picture, pixels=result.image, exif=exif))
    report["output"] = str(job.picture)
    if job.overlay is not None:
        write_picture(job.overlay, Picture(draw_curves(picture.pixels, result.curves)))
        report["overlay"] = str(job.overlay)
    if result.camera is not None:
        content = CameraFile(result.camera, result.status, result.reason, result.quality)
        if known is not None:
            content = replace(known, camera=result.camera)
        residual = write_camera(job.camera, content, kind, frame=rectifier.config)
        report["reason"] += nearness(residual)
        report |= {"camera_file": str(job.camera), "camera": lens_fields(result.camera)}
    return report | {"quality": quality_dict(result.quality)}

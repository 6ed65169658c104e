"""The command `straightlens video`."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from classical.camera.formats import lens_fields
from hybrid.camera_files import CameraFile, quality_dict, read_camera, write_camera
from hybrid.commands import options
from hybrid.commands.checks import (
    check_camera_name,
    make_folder,
    misuse,
    refuse_existing,
    refuse_inputs,
    usage_error,
)
from hybrid.commands.reports import FAILURE, Report, nearness
from hybrid.config import RectifyConfig
from hybrid.images import Picture, is_picture_name, write_picture
from hybrid.pipeline import Rectifier
from hybrid.video import CODECS, PRESETS, Encoding, Film, calibrate_film, rectify_film

_ENCODING = (
    click.option("--codec", type=click.Choice(CODECS), default=Encoding.codec, show_default=True),
    click.option(
        "--preset",
        type=click.Choice(PRESETS),
        default=Encoding.preset,
        show_default=True,
        help="Slower ones give smaller files.",
    ),
    click.option(
        "--crf",
        type=click.IntRange(0, 51),
        default=Encoding.crf,
        show_default=True,
        help="Quality: 0 is lossless, 51 the worst.",
    ),
)


@click.command()
@click.argument("source", type=options.EXISTING_FILE)
@click.argument("out", required=False, type=options.NEW_FILE)
@options.camera
@options.camera_name
@click.option("--save-camera", type=options.NEW_FILE, help="Also write the lens to this file.")
@options.kind
@click.option("--preview", type=options.NEW_FILE, help="Write one straight frame as a picture.")
@click.option("--at", type=click.FloatRange(0), default=0.0, help="Second of the preview.")
@options.lens
@options.frame
@_ENCODING[0]
@_ENCODING[1]
@_ENCODING[2]
@options.overwrite
@options.as_json("the result as one JSON object")
@options.threads
def video(
    source: Path,
    out: Path | None,
    camera: Path | None,
    camera_name: str | None,
    save_camera: Path | None,
    kind: str,
    preview: Path | None,
    at: float,
    overwrite: bool,
    as_json: bool,
    **chosen: Any,
) -> int:
    """Straighten a film; its sound, frame times and the way it is turned are kept.

    The lens is found from chosen frames of the film, or given by --camera. Without OUT only the
    preview and the camera file are written.
    """
    with misuse():
        encoding = Encoding(**{name: chosen.pop(name) for name in ("codec", "preset", "crf")})
        rectifier = Rectifier(RectifyConfig(**chosen))
        known = None if camera is None else read_camera(camera, camera_name)
    _check_outputs(source, camera, (out, preview, save_camera), kind, overwrite)
    report: Report = {"input": str(source)}
    found = known or _calibrated(source, rectifier, report)
    if found is not None:
        report |= {"status": found.status, "reason": found.reason}
        report |= {"camera": lens_fields(found.camera), "quality": quality_dict(found.quality)}
        if save_camera is not None:
            residual = write_camera(save_camera, found, kind, frame=rectifier.config)
            report["reason"] += nearness(residual)
            report["camera_file"] = str(save_camera)
        if preview is not None:
            _write_preview(source, preview, at, rectifier, found)
            report["preview"] = str(preview)
        if out is not None:
            report |= _straighten(source, out, found, rectifier.config, encoding)
    return _tell(report, as_json)


def _check_outputs(
    source: Path,
    camera: Path | None,
    named: Sequence[Path | None],
    kind: str,
    overwrite: bool,
) -> None:
    """Misuse if nothing is to be written, or something would be lost."""
    outputs = [path for path in named if path is not None]
    if not outputs:
        raise usage_error("nothing to do: give OUT, --preview or --save-camera")
    if len({path.resolve() for path in outputs}) < len(outputs):
        raise usage_error("two outputs have the same name")
    _, preview, save_camera = named
    if preview is not None and not is_picture_name(preview):
        raise usage_error(f"a preview is a picture such as frame.png, got {preview.name}")
    if save_camera is not None:
        check_camera_name(save_camera, kind)
    refuse_inputs(outputs, [source] if camera is None else [source, camera])
    refuse_existing(outputs, overwrite=overwrite)
    for path in outputs:
        make_folder(path.parent)


def _calibrated(source: Path, rectifier: Rectifier, report: Report) -> CameraFile | None:
    """The lens found in the film, or None with the reason in the report."""
    found, times = calibrate_film(source, rectifier)
    report |= {"frames_used": [round(time, 3) for time in times]}
    if found.camera is None:
        report |= {"status": "failed", "reason": found.reason}
        return None
    return CameraFile(found.camera, found.status, found.reason, found.quality)


def _write_preview(
    source: Path, path: Path, at: float, rectifier: Rectifier, found: CameraFile
) -> None:
    with Film(source) as film:
        frames = next(film.frames_from([at], 1))
        if not frames:
            raise ValueError(f"{source}: no frame at {at:g} s")
        result = rectifier.rectify(film.picture(frames[0]), camera=found.camera)
    write_picture(path, Picture(result.image))


def _straighten(
    source: Path, out: Path, found: CameraFile, config: RectifyConfig, encoding: Encoding
) -> Report:
    """Make the film, with a bar on stderr if someone looks."""
    with tqdm(desc=source.name, unit="frame", file=sys.stderr, disable=None) as bar:

        def advance(done: int, total: int | None) -> None:
            bar.total = total
            bar.update(done - bar.n)

        film = rectify_film(
            source, out, found.camera, config=config, encoding=encoding, progress=advance
        )
    return {
        "output": str(out),
        "n_frames": film.n_frames,
        "n_broken": film.n_broken,
        "seconds": round(film.seconds, 3),
        "frames_per_second": round(film.rate, 2),
        "busy_seconds": {stage: round(spent, 3) for stage, spent in film.busy.items()},
    }


def _tell(report: Report, as_json: bool) -> int:
    """One line, or one JSON object; returns the exit code."""
    if as_json:
        click.echo(json.dumps(report, allow_nan=False))
    if report["status"] == "failed":
        click.echo(f"straightlens: {report['input']}: {report['reason']}", err=True)
        return FAILURE
    if not as_json:
        words = f"{report['status']}: {report['reason']}"
        written = [report[name] for name in ("output", "preview", "camera_file") if name in report]
        click.echo(f"{report['input']} -> {', '.join(written)}  {words}")
        if "n_frames" in report:
            broken = f", {report['n_broken']} broken left out" if report["n_broken"] else ""
            rate = f"{report['frames_per_second']:.1f} frames a second"
            click.echo(f"{report['n_frames']} frames{broken}, {rate}")
    return 0

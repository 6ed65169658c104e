"""The commands `straightlens rectify` and `straightlens calibrate`."""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import click
import numpy as np
from tqdm import tqdm

from classical.camera import KannalaBrandt
from hybrid.camera_files import CameraFile, camera_dict, quality_dict, read_camera, write_camera
from hybrid.config import RectifyConfig
from hybrid.images import Picture, is_picture_name, read_picture, write_picture
from hybrid.methods import DEFAULT_METHOD, method_names
from hybrid.overlay import draw_curves
from hybrid.pipeline import Rectifier
from hybrid.result import Calibration, Rectification

T = TypeVar("T")
FAILURE = 1  # exit code when an item failed


class SizeType(click.ParamType):
    """WIDTHxHEIGHT in pixels."""

    name = "WxH"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        """Read "640x480"."""
        if isinstance(value, tuple):
            return value
        try:
            width, height = (int(part) for part in str(value).lower().split("x"))
        except ValueError:
            self.fail(f"expected WIDTHxHEIGHT, for example 1280x960, got {value!r}", param, ctx)
        return width, height


def _paths(command: Callable[..., T]) -> Callable[..., T]:
    """The argument PATHS: files and folders that exist."""
    kind = click.Path(exists=True, path_type=Path)
    return click.argument("paths", nargs=-1, required=True, type=kind)(command)


def _method(command: Callable[..., T]) -> Callable[..., T]:
    """The option --method."""
    return click.option(
        "--method",
        type=click.Choice(method_names()),
        default=DEFAULT_METHOD,
        show_default=True,
        help="How the lens is found.",
    )(command)


@click.command()
@_paths
@click.option(
    "--out",
    required=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for the straight pictures and their NAME.camera.json; made if there is none.",
)
@_method
@click.option(
    "--camera",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Use this camera.json instead of estimating the lens.",
)
@click.option("--fov", type=float, help="Horizontal field of view of the result, degrees.")
@click.option("--focal", type=float, help="Focal length of the result, pixels.")
@click.option("--balance", type=float, help="0: no empty pixel (default); 1: nothing lost.")
@click.option("--size", type=SizeType(), help="Size of the result, e.g. 1280x960.")
@click.option("--overlay", is_flag=True, help="Also write NAME.overlay.png with the curves.")
@click.option("--overwrite", is_flag=True, help="Replace files that exist.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object a picture.")
@click.option("--threads", type=int, help="CPU threads to use.")
def rectify(
    paths: tuple[Path, ...],
    out: Path,
    method: str,
    camera: Path | None,
    overlay: bool,
    overwrite: bool,
    as_json: bool,
    **frame: Any,
) -> int:
    """Straighten pictures: files, and all pictures in folders.

    Each picture is taken on its own; for many pictures of one lens run `calibrate` first and pass
    its file with --camera. A picture that cannot be read or tells nothing about its lens is
    reported, the others are done, and the exit code is 1.
    """
    config = _config(method=method, **frame)
    jobs = _jobs(_pictures(paths), out, overlay, overwrite)
    known = None if camera is None else _camera(camera)
    _make_folder(out)
    rectifier = Rectifier(config)
    failed = False
    for job in _progress(jobs):
        report = _attempt(job.source, lambda job=job: _rectify_one(job, rectifier, known))
        failed |= report["status"] == "failed"
        _tell(report, as_json)
    return FAILURE if failed else 0


@click.command()
@_paths
@click.option(
    "--out",
    required=True,
    type=click.Path(dir_okay=False, path_type=Path),
    help="The camera file to write, e.g. camera.json.",
)
@_method
@click.option("--overwrite", is_flag=True, help="Replace the file if it exists.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object.")
@click.option("--threads", type=int, help="CPU threads to use.")
def calibrate(
    paths: tuple[Path, ...],
    out: Path,
    method: str,
    overwrite: bool,
    as_json: bool,
    threads: int | None,
) -> int:
    """Find the one lens that took all the pictures, in one joint fit.

    A file that cannot be read is reported and left out; the exit code is then 1.
    """
    config = _config(method=method, threads=threads)
    sources = _pictures(paths)
    _refuse_existing([out], overwrite)
    reports, images = _read_all(sources)
    if not images:
        raise click.ClickException("none of the pictures could be read")
    _check_one_size(images)
    found = Rectifier(config).calibrate(list(images.values()))
    if found.camera is not None:
        _make_folder(out.parent)
        content = CameraFile(found.camera, found.status, found.reason, found.quality)
        write_camera(out, content)
    _tell_calibration(found, out, len(images), reports if as_json else None)
    return FAILURE if reports or found.camera is None else 0


# ---- what is to be done ------------------------------------------------------------------------


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


def _config(**options: Any) -> RectifyConfig:
    """The options as a config; what it refuses is misuse."""
    try:
        return RectifyConfig(**options)
    except ValueError as error:
        raise click.UsageError(str(error), click.get_current_context()) from error


def _pictures(paths: Iterable[Path]) -> list[Path]:
    """Files as they are, folders as the pictures in them."""
    sources: list[Path] = []
    for path in paths:
        if not path.is_dir():
            sources.append(path)
            continue
        inside = sorted(entry for entry in path.iterdir() if is_picture_name(entry))
        if not inside:
            raise click.UsageError(f"no pictures in the folder {path}", click.get_current_context())
        sources += inside
    return list(dict.fromkeys(sources))


def _jobs(sources: Sequence[Path], out: Path, overlay: bool, overwrite: bool) -> list[_Job]:
    """The jobs, refused as a whole where files would be lost."""
    jobs = [_job(source, out, overlay) for source in sources]
    outputs = [path for job in jobs for path in job.outputs()]
    doubles = [path for path, number in Counter(outputs).items() if number > 1]
    context = click.get_current_context()
    if doubles:
        raise click.UsageError(f"two inputs would both write {doubles[0]}", context)
    inputs = {source.resolve() for source in sources}
    for path in outputs:
        if path.resolve() in inputs:
            raise click.UsageError(f"{path} is an input; choose another --out", context)
    _refuse_existing(outputs, overwrite)
    return jobs


def _job(source: Path, out: Path, overlay: bool) -> _Job:
    name = source.name if is_picture_name(source) else f"{source.name}.png"
    drawn = out / f"{source.stem}.overlay.png" if overlay else None
    return _Job(source, out / name, out / f"{source.stem}.camera.json", drawn)


def _refuse_existing(outputs: Sequence[Path], overwrite: bool) -> None:
    existing = [path for path in outputs if path.exists()]
    if existing and not overwrite:
        more = f" and {len(existing) - 1} more" if len(existing) > 1 else ""
        message = f"{existing[0]}{more} exists; use --overwrite to replace"
        raise click.UsageError(message, click.get_current_context())


def _camera(path: Path) -> CameraFile:
    try:
        return read_camera(path)
    except ValueError as error:
        raise click.UsageError(str(error), click.get_current_context()) from error


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise click.ClickException(f"cannot make the folder {folder}: {error.strerror}") from error


# ---- doing it ----------------------------------------------------------------------------------


def _attempt(source: Path, work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Do one item; what goes wrong with it is its report and no more."""
    try:
        return work()
    except (OSError, ValueError) as error:
        return _failure(source, _one_line(error, source))
    except MemoryError:
        return _failure(source, "not enough memory")


def _failure(source: Path, reason: str) -> dict[str, Any]:
    """The report of an item that came to nothing."""
    return {"input": str(source), "status": "failed", "reason": reason}


def _rectify_one(job: _Job, rectifier: Rectifier, known: CameraFile | None) -> dict[str, Any]:
    """Read, rectify and write one picture."""
    picture = read_picture(job.source)
    camera = None if known is None else known.camera
    result = rectifier.rectify(_unit_range(picture.pixels), camera=camera, throw=False)
    report: dict[str, Any] = {"input": str(job.source), "status": result.status}
    report["reason"] = result.reason
    if result.status == "failed":
        return report
    write_picture(job.picture, replace(picture, pixels=result.image))
    report["output"] = str(job.picture)
    if job.overlay is not None:
        write_picture(job.overlay, Picture(draw_curves(picture.pixels, result.curves)))
        report["overlay"] = str(job.overlay)
    if result.camera is not None:
        _write_camera_of(job, result, known, result.camera)
        report |= {"camera_file": str(job.camera), "camera": camera_dict(result.camera)}
    return report | {"quality": quality_dict(result.quality)}


def _write_camera_of(
    job: _Job, result: Rectification, known: CameraFile | None, camera: KannalaBrandt
) -> None:
    content = CameraFile(camera, result.status, result.reason, result.quality)
    if known is not None:
        content = replace(known, camera=camera)
    write_camera(job.camera, content)


def _read_all(
    sources: Sequence[Path],
) -> tuple[list[dict[str, Any]], dict[Path, np.ndarray]]:
    """The reports of the files that cannot be read, and the pictures of the others."""
    reports: list[dict[str, Any]] = []
    images: dict[Path, np.ndarray] = {}
    for source in _progress(sources):
        try:
            images[source] = _unit_range(read_picture(source).pixels)
        except (OSError, ValueError) as error:
            reports.append(_failure(source, _one_line(error, source)))
            _tell(reports[-1], as_json=False)
    return reports, images


def _check_one_size(images: dict[Path, np.ndarray]) -> None:
    """Pictures of one lens have one size."""
    sizes = {image.shape[1::-1]: path for path, image in images.items()}
    if len(sizes) > 1:
        told = [f"{path} is {w}x{h}" for (w, h), path in list(sizes.items())[:2]]
        raise click.UsageError(
            f"pictures of one lens have one size, but {' and '.join(told)}",
            click.get_current_context(),
        )


def _unit_range(pixels: np.ndarray) -> np.ndarray:
    """Float pictures of any range, brought to [0, 1] if they exceed it."""
    if pixels.dtype != np.float32:
        return pixels
    return np.clip(pixels / max(1.0, float(pixels.max(initial=0.0))), 0, 1)


# ---- telling -----------------------------------------------------------------------------------


def _progress(items: Sequence[T]) -> Iterator[T]:
    """The items behind a bar on stderr, if there are many and someone looks."""
    return iter(tqdm(items, file=sys.stderr, disable=len(items) < 2 or not sys.stderr.isatty()))


def _tell(report: dict[str, Any], as_json: bool) -> None:
    """One line a picture: results on stdout, failures on stderr."""
    if as_json:
        tqdm.write(json.dumps(report, allow_nan=False), file=sys.stdout)
    if report["status"] == "failed":
        line = f"straightlens: {report['input']}: {report['reason']}"
        tqdm.write(line, file=sys.stderr)
    elif not as_json:
        line = f"{report['input']} -> {report['output']}  {report['status']}: {report['reason']}"
        tqdm.write(line, file=sys.stdout)


def _tell_calibration(
    found: Calibration, out: Path, n_images: int, unread: list[dict[str, Any]] | None
) -> None:
    """The result of a calibration: JSON if the list of unread files is given, else in words."""
    failed = found.camera is None
    if unread is not None:
        report = {
            "status": "failed" if failed else found.status,
            "reason": found.reason,
            "n_images": n_images,
            "unread": unread,
            "camera_file": None if failed else str(out),
            "camera": None if found.camera is None else camera_dict(found.camera),
            "quality": quality_dict(found.quality),
        }
        click.echo(json.dumps(report, allow_nan=False))
    if failed:
        click.echo(f"straightlens: no lens found: {found.reason}", err=True)
    elif unread is None:
        noun = "picture" if n_images == 1 else "pictures"
        click.echo(f"{n_images} {noun} -> {out}  {found.status}: {found.reason}")


def _one_line(error: Exception, source: Path) -> str:
    """An error in words, without the path that the report names anyway."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(text.split()).removeprefix(f"{source}: ")

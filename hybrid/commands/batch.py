"""The command `straightlens batch`."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from tqdm import tqdm

from hybrid.batch import GROUPINGS, Batch, BatchConfig
from hybrid.camera_files import read_camera
from hybrid.commands import options
from hybrid.commands.checks import misuse
from hybrid.commands.reports import FAILURE, Report, tell
from hybrid.config import RectifyConfig


@click.command()
@click.argument("folder", type=options.EXISTING_FOLDER)
@click.option(
    "--out",
    required=True,
    type=options.NEW_FOLDER,
    help="Folder for the straight pictures, laid out as FOLDER, and manifest.jsonl.",
)
@click.option(
    "--group-by",
    type=click.Choice(GROUPINGS),
    default=BatchConfig.group_by,
    show_default=True,
    help="Which pictures have one lens: those of one camera, lens and focal length, those of one "
    "folder, or none but itself. Pictures of one lens have one size.",
)
@click.option(
    "--sample",
    type=click.IntRange(1),
    default=BatchConfig.sample,
    show_default=True,
    help="Pictures of a group that tell its lens.",
)
@options.camera
@options.camera_name
@options.lens
@options.frame
@click.option("--workers", type=click.IntRange(1), help="Processes; default: one for each core.")
@click.option(
    "--ray",
    "cluster",
    metavar="ADDRESS",
    help="Work on a Ray cluster instead (auto, local or host:port) with a common file system.",
)
@options.overwrite
@options.as_json("one JSON object a picture")
def batch(
    folder: Path,
    out: Path,
    group_by: str,
    sample: int,
    camera: Path | None,
    camera_name: str | None,
    workers: int | None,
    cluster: str | None,
    overwrite: bool,
    as_json: bool,
    **chosen: Any,
) -> int:
    """Straighten all pictures in a folder and below it, by all cores or a cluster.

    One lens is found for each group of pictures. A batch that was stopped goes on where it was
    when it is called again, and so does one whose FOLDER got more pictures. EXIF data and colour
    profiles are kept; the tags of the lens tell of the straight picture. What cannot be done is
    reported, the others are done, and the exit code is 1.
    """
    with misuse():
        config = RectifyConfig(**chosen)
        known = None if camera is None else read_camera(camera, camera_name).camera
        how = BatchConfig(group_by, sample, known, workers, cluster, overwrite)
        job = Batch(folder, out, config, how)
    with job:
        n_before = job.n_pictures - job.n_left
        for _ in _bar(job.find_lenses(), "lenses", job.n_lenses):
            pass
        counts: Counter[str] = Counter()
        for fields in _bar(job.straighten(), "pictures", job.n_left):
            counts[fields["status"]] += 1
            if as_json or fields["status"] == "failed":
                tell(_report(fields, folder, out), as_json=as_json)
    if not as_json:
        told = [f"{counts[status]} {status}" for status in ("ok", "degraded", "failed")]
        before = f", {n_before} done before" if n_before else ""
        click.echo(f"{job.n_pictures} pictures -> {out}  {', '.join(told)}{before}")
    return FAILURE if counts["failed"] else 0


def _bar(steps: Iterator[Report], what: str, total: int) -> Iterator[Report]:
    """The steps behind a bar on stderr, if someone looks."""
    return iter(tqdm(steps, what, total, file=sys.stderr, disable=None, smoothing=0.05))


def _report(fields: Report, folder: Path, out: Path) -> Report:
    """A line of the manifest with whole paths."""
    report = {**fields, "input": str(folder / fields["input"])}
    for name in ("output", "camera_file"):
        if fields.get(name) is not None:
            report[name] = str(out / fields[name])
    return report

"""A folder of pictures straightened by many workers; it can be stopped and gone on with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from types import TracebackType

from classical.camera import KannalaBrandt
from classical.files import remove_leftovers
from hybrid.batch.groups import GROUPINGS, Job, find_pictures, sampled
from hybrid.batch.manifest import NAME as MANIFEST
from hybrid.batch.manifest import Manifest
from hybrid.batch.work import LENSES, Fields, Task, Workplace, classified, find_lens, straighten
from hybrid.camera_files import read_camera
from hybrid.config import RectifyConfig
from learned.pool import WorkPool, processor_count

_DONE = ("ok", "degraded")


@dataclass(frozen=True)
class BatchConfig:
    """How a batch is done.

    Attributes:
        group_by: Which pictures have one lens: "exif" (camera, lens, focal length and size),
            "folder" (and size) or "none" (each picture alone).
        sample: So many pictures of a group tell its lens.
        camera: The lens of all pictures, if it is known.
        workers: Processes; None takes one for each core.
        cluster: Address of a Ray cluster that works instead; see `WorkPool`.
        overwrite: Do everything again.
    """

    group_by: str = "exif"
    sample: int = 8
    camera: KannalaBrandt | None = None
    workers: int | None = None
    cluster: str | None = None
    overwrite: bool = False

    def __post_init__(self) -> None:
        if self.group_by not in GROUPINGS:
            raise ValueError(f"Expected group_by in {', '.join(GROUPINGS)}, got {self.group_by!r}.")
        if self.sample < 1:
            raise ValueError(f"Expected a sample of at least one picture, got {self.sample}.")


class Batch:
    """Pictures of a folder and those below it, straightened into another folder.

    Use it as a context manager; exhaust `find_lenses`, then `straighten`. Results mirror the
    folder, and `manifest.jsonl` beside them says what came of each picture. A batch that was
    stopped, or whose folder got more pictures, is gone on with by making it again: what the
    manifest calls done and is there is left alone, failures are tried again.

    Args:
        folder: The pictures.
        out: The results; made if there is no such folder.
        config: Method and frame.
        how: Grouping and workers.

    Attributes:
        n_pictures: Number of pictures.

    Raises:
        ValueError: If there are no pictures, files would be lost, or the results in `out` were made
            with other settings.
    """

    def __init__(
        self,
        folder: Path,
        out: Path,
        config: RectifyConfig = RectifyConfig(),
        how: BatchConfig = BatchConfig(),
    ) -> None:
        _check_apart(folder, out)
        self._place = Workplace(folder.resolve(), out.resolve(), config)
        self._how = how
        self._pool = WorkPool(workers=how.workers or processor_count(), cluster=how.cluster)
        self._names = find_pictures(self._place.folder, self._place.out)
        self.n_pictures = len(self._names)
        if not self._names:
            raise ValueError(f"no pictures in the folder {folder}")
        if not how.overwrite and not (out / MANIFEST).exists():
            _check_free(out, self._names)
        out.mkdir(parents=True, exist_ok=True)
        self._manifest = Manifest(out, _settings(config, how), restart=how.overwrite)
        for place in {out / name.parent for name in (*self._names, Path(LENSES) / "any")}:
            remove_leftovers(place)
        self._left: list[Job] = []

    def __enter__(self) -> Batch:
        self._pool.__enter__()
        names = [name for name in self._names if not self._is_done(name)]
        classify = partial(classified, self._place, self._group_by)
        self._left = list(self._pool.ordered(classify, names))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._pool.__exit__(kind, error, trace)
        self._manifest.close()

    @property
    def n_left(self) -> int:
        """Pictures that are not done yet."""
        return len(self._left)

    @property
    def n_lenses(self) -> int:
        """Lenses that are not known yet."""
        return len(self._unknown())

    def find_lenses(self) -> Iterator[Fields]:
        """Find the lens of each group that has none yet; yields what came of it."""
        for fields in self._pool.ordered(partial(find_lens, self._place), self._unknown()):
            self._manifest.add_lens(fields)
            yield fields

    def straighten(self) -> Iterator[Fields]:
        """Straighten the pictures that are left; yields what came of each."""
        cameras = {group: self._camera(fields) for group, fields in self._manifest.lenses.items()}
        tasks: list[Task] = []
        for job in self._left:
            known = self._manifest.lenses.get(job.group)
            if known is not None and known["status"] == "failed":
                reason = f"no lens found for its group: {known['reason']}"
                yield self._noted({**_named(job), "status": "failed", "reason": reason})
            else:
                tasks.append(Task(job, self._how.camera or cameras.get(job.group)))
        for fields in self._pool.ordered(partial(straighten, self._place), tasks):
            yield self._noted(fields)

    @property
    def _group_by(self) -> str:
        return "none" if self._how.camera is not None else self._how.group_by

    def _unknown(self) -> list[list[Job]]:
        """Samples of the groups whose lens is to be found."""
        lenses = self._manifest.lenses
        known = {group for group, fields in lenses.items() if self._is_found(fields)}
        samples = sampled(self._left, self._how.sample)
        return [jobs for group, jobs in samples.items() if group not in known]

    def _is_found(self, fields: Fields) -> bool:
        file = fields["camera_file"]
        return fields["status"] in _DONE and (file is None or (self._place.out / file).is_file())

    def _camera(self, fields: Fields) -> KannalaBrandt | None:
        file = fields["camera_file"]
        return None if file is None else read_camera(self._place.out / file).camera

    def _is_done(self, name: Path) -> bool:
        """True where a picture's result is there, and the picture is the one that it came from."""
        fields = self._manifest.pictures.get(name.as_posix(), {})
        if fields.get("status") not in _DONE or not (self._place.out / name).is_file():
            return False
        try:
            stat = (self._place.folder / name).stat()
        except OSError:
            return False
        return (fields["bytes"], fields["mtime_ns"]) == (stat.st_size, stat.st_mtime_ns)

    def _noted(self, fields: Fields) -> Fields:
        self._manifest.add_picture(fields)
        return fields


def _named(job: Job) -> Fields:
    return {"input": job.name.as_posix(), "group": job.group}


def _settings(config: RectifyConfig, how: BatchConfig) -> Fields:
    """What the results depend on."""
    settings = asdict(config)
    del settings["threads"]
    camera = None if how.camera is None else how.camera.to_vector().tolist()
    return settings | {"group_by": how.group_by, "sample": how.sample, "camera": camera}


def _check_apart(folder: Path, out: Path) -> None:
    """Refuse to write among the pictures."""
    inputs, results = folder.resolve(), out.resolve()
    if inputs == results or results in inputs.parents:
        raise ValueError(f"the results in {out} would lie among the pictures; choose another --out")


def _check_free(out: Path, names: list[Path]) -> None:
    """Refuse to replace files that no batch has made."""
    existing = [out / name for name in names if (out / name).exists()]
    if existing:
        more = f" and {len(existing) - 1} more" if len(existing) > 1 else ""
        raise ValueError(f"{existing[0]}{more} exists; use --overwrite to replace")

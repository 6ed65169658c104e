"""The commands `straightlens synthesize …`. Torch is imported when something is made."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from learned.slf.rooms.recipe import RoomRecipe
    from learned.slf.suite import SuiteFolder
    from learned.slf.synthesis import Made, SetCfg

_LENSES_A_PHOTOGRAPH = 8  # as the paper bent each
_PRIORS = ("paper", "wild", "fisheye")
_EXISTING_FOLDER = click.Path(exists=True, file_okay=False, path_type=Path)


def _set_options(
    *, size: int, prior: str | None, count: str | None = None
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Options that every set has; `count` says how many pictures there are by default."""
    told = f"Pictures in the set; default: {count}." if count else "Pictures in the set."
    options = [
        click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder."),
        click.option("--count", required=count is None, type=click.IntRange(1), help=told),
        click.option("--seed", default=1, show_default=True, help="Same seed, same bytes."),
        click.option(
            "--size",
            default=size,
            show_default=True,
            type=click.IntRange(32, 4096),
            help="Width and height of the pictures in pixels.",
        ),
        click.option(
            "--photometry/--clean", default=False, help="Noise, blur, compression and the like."
        ),
        click.option("--workers", type=click.IntRange(1), help="Processes; default: one a core."),
        click.option(
            "--ray",
            "cluster",
            metavar="ADDRESS",
            help="Work on a Ray cluster instead (auto, local or host:port).",
        ),
    ]

    if prior is not None:
        named = click.Choice(_PRIORS)
        options.append(click.option("--prior", default=prior, show_default=True, type=named))

    def add(command: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def _blender_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options of what Blender renders."""
    options = [
        click.option(
            "--blender-python",
            default=sys.executable,
            help="Interpreter with bpy 4.5; best an environment of its own. Default: this one.",
        ),
        click.option(
            "--samples", default=4, show_default=True, type=click.IntRange(1), help="A pixel."
        ),
        click.option(
            "--threads",
            default=1,
            show_default=True,
            type=click.IntRange(1),
            help="Of each Blender.",
        ),
        click.option(
            "--furniture",
            type=_EXISTING_FOLDER,
            help="Folder of .sh3f files of Sweet Home 3D, whose models stand among the drawn "
            "furniture; Debian's sweethome3d-furniture has /usr/share/sweethome3d/furniture.",
        ),
        click.option("--cc0", is_flag=True, help="Only furniture in the public domain."),
    ]
    for option in reversed(options):
        command = option(command)
    return command


@click.group()
def synthesize() -> None:
    """Make fisheye pictures with known lenses and lines, for training and for tests.

    A set is made again from its seed, byte for byte; a run that was stopped goes on where it was.
    """


@synthesize.command()
@click.option("--photos", required=True, type=_EXISTING_FOLDER, help="Undistorted photographs.")
@_set_options(size=320, prior="paper", count="eight lenses a photograph")
def dwireframe(photos: Path, **options: Any) -> None:
    """Bend perspective photographs and their straight lines (the paper's D-Wireframe).

    Lines come from annotation files of the wireframe dataset (.pkl, _line.mat, .json) where there
    are any below the folder of photographs; a detector finds them in the others.
    """
    from learned.slf.pack import picture_paths
    from learned.slf.synthesis import make_dwireframe
    from learned.slf.wireframes import with_annotations

    paths = _checked(picture_paths, photos)
    photographs = with_annotations(paths, photos)
    options["count"] = options["count"] or _LENSES_A_PHOTOGRAPH * len(paths)
    annotated = sum(photograph.annotation is not None for photograph in photographs)
    settings = {
        **_source_settings(paths, photos),
        **({"annotated": annotated} if annotated else {}),
    }
    _make("dwireframe", partial(make_dwireframe, photographs), settings, options)


@synthesize.command()
@click.option("--panoramas", "folder", required=True, type=_EXISTING_FOLDER, help="2:1 pictures.")
@_set_options(size=640, prior="wild")
def panoramas(folder: Path, **options: Any) -> None:
    """Cut equirectangular panoramas with any lens and pose; fields of view are true."""
    from learned.slf.pack import picture_paths
    from learned.slf.synthesis import make_panorama_cut

    paths = _checked(picture_paths, folder)
    make = partial(make_panorama_cut, paths)
    _make("panoramas", make, _source_settings(paths, folder), options)


@synthesize.command()
@click.option(
    "--prior",
    default="equisolid",
    show_default=True,
    type=click.Choice(["equisolid", *_PRIORS]),
    help="Equisolid is the paper's single lens.",
)
@_blender_options
@_set_options(size=320, prior=None)
def rooms(
    blender_python: str,
    samples: int,
    threads: int,
    furniture: Path | None,
    cc0: bool,
    **options: Any,
) -> None:
    """Render furnished rooms and streets with a perspective twin of every picture."""
    from learned.slf.rooms.recipe import room_of

    recipe, furnished = _recipe(options, blender_python, samples, threads, furniture, cc0)
    folder = begun(options["out"], "rooms", {**_settings(options), **furnished})
    try:
        finish(folder, partial(room_of, recipe), options)
    except (RuntimeError, OSError) as error:
        raise click.ClickException(str(error)) from error


@synthesize.command("room-panoramas")
@_blender_options
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder.")
@click.option("--count", required=True, type=click.IntRange(1), help="Panoramas in the folder.")
@click.option("--seed", default=1, show_default=True, help="Same seed, same bytes.")
@click.option(
    "--height",
    default=512,
    show_default=True,
    type=click.IntRange(64, 4096),
    help="Of the panoramas in pixels; they are twice as wide.",
)
@click.option("--workers", type=click.IntRange(1), help="Processes; default: one a core.")
def room_panoramas(
    blender_python: str,
    samples: int,
    threads: int,
    furniture: Path | None,
    cc0: bool,
    out: Path,
    count: int,
    seed: int,
    height: int,
    workers: int | None,
) -> None:
    """Render what is all around a camera in furnished rooms and streets, for `pack --rooms`.

    One panorama serves any number of lenses and poses, so it is worth many rooms of `rooms`.
    """
    from tqdm import tqdm

    from learned.pool import WorkPool, processor_count
    from learned.slf.rooms.recipe import make_panorama, panorama_path

    options = {"prior": "none", "size": height, "seed": seed, "photometry": False}
    recipe, furnished = _recipe(options, blender_python, samples, threads, furniture, cc0)
    _begin_panoramas(out, {"seed": seed, "height": height, **furnished})
    missing = [i for i in range(count) if not panorama_path(out, i).exists()]
    bar = tqdm(total=count, initial=count - len(missing), unit="picture", disable=None)
    try:
        with bar, WorkPool(workers=workers or processor_count()) as pool:
            for _ in pool.ordered(partial(make_panorama, recipe, out.resolve()), missing):
                bar.update()
    except (RuntimeError, OSError) as error:
        raise click.ClickException(str(error)) from error


def _begin_panoramas(out: Path, settings: dict[str, Any]) -> None:
    """Write down what a folder's panoramas are made of, or see that it is the same."""
    from learned.slf.suite import write_whole

    path = out / "settings.json"
    if not path.exists():
        out.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(settings, indent=1).encode() + b"\n")
    elif (found := json.loads(path.read_text())) != settings:
        message = f"expected panoramas made with {settings}, got {found} in {out}"
        raise click.UsageError(message)


def _recipe(
    options: dict[str, Any],
    blender_python: str,
    samples: int,
    threads: int,
    furniture: Path | None,
    cc0: bool,
) -> tuple[RoomRecipe, dict[str, Any]]:
    """What rooms depend on, and what their folder says of it."""
    from learned.slf.rooms.recipe import RoomRecipe

    settings: dict[str, Any] = {"samples": samples}
    if furniture is not None:
        settings |= {"furniture": _catalogue_names(furniture, cc0), "cc0": cc0}
        furniture = furniture.resolve()
    recipe = RoomRecipe(_config(options), blender_python, samples, threads, furniture, cc0)
    return recipe, settings


def _catalogue_names(folder: Path, cc0: bool) -> list[str]:
    """The catalogues of a folder, which are read once so that a bad one is misuse."""
    from learned.slf.rooms.catalogue import read_catalogues

    models = _checked(partial(read_catalogues, cc0_only=cc0), folder)
    return sorted({model.archive.name for model in models})


@synthesize.command()
@click.option("--photos", type=_EXISTING_FOLDER, help="Undistorted photographs.")
@click.option("--panoramas", "folder", type=_EXISTING_FOLDER, help="Equirectangular panoramas.")
@click.option("--rooms", type=_EXISTING_FOLDER, help="Panoramas made by `room-panoramas`.")
@click.option(
    "--patterns", default=400, show_default=True, type=click.IntRange(0), help="Drawn textures."
)
@click.option(
    "--boards",
    default=0,
    show_default=True,
    type=click.IntRange(0),
    help="Drawn calibration targets and posters, for `train --board`.",
)
@click.option("--out", required=True, type=click.Path(path_type=Path), help="File to write.")
@click.option("--seed", default=1, show_default=True, help="Of what is drawn.")
@click.option("--workers", default=2, show_default=True, type=click.IntRange(1))
def pack(
    photos: Path | None,
    folder: Path | None,
    rooms: Path | None,
    patterns: int,
    boards: int,
    out: Path,
    seed: int,
    workers: int,
) -> None:
    """Pack photographs and panoramas with their lines, for training on the fly."""
    from tqdm import tqdm

    from learned.slf.atlas import PANORAMA, ROOM, save_atlas
    from learned.slf.pack import annotated_photographs, build_atlas, picture_paths
    from learned.slf.panorama_lines import annotated_panorama
    from learned.slf.patterns import draw_patterns, draw_targets
    from learned.slf.wireframes import with_annotations

    if photos is None and folder is None and rooms is None and patterns == boards == 0:
        raise click.UsageError(
            "expected --photos, --panoramas, --rooms, --patterns or --boards, got none"
        )
    flat = _checked(picture_paths, photos) if photos else []
    round_ = [
        (path, kind)
        for where, kind in ((folder, PANORAMA), (rooms, ROOM))
        if where is not None
        for path in _checked(picture_paths, where)
    ]
    with tqdm(total=len(flat) + len(round_), unit="picture", disable=None) as bar:

        def pictures() -> Any:
            photographs = with_annotations(flat, photos) if photos else []
            yield from annotated_photographs(photographs, workers=workers, progress=bar.update)
            for path, kind in round_:
                yield annotated_panorama(path, kind=kind)
                bar.update()
            yield from draw_patterns(patterns, seed=seed)
            yield from draw_targets(boards, seed=seed)

        save_atlas(_checked(build_atlas, pictures()), out)


@synthesize.command()
@click.option("--photos", required=True, type=_EXISTING_FOLDER, help="Undistorted photographs.")
@click.option("--panoramas", "folder", required=True, type=_EXISTING_FOLDER, help="2:1 pictures.")
@click.option("--blender-python", help="Interpreter with bpy 4.5; without it there are no rooms.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder of the sets.")
@click.option("--seed", default=1, show_default=True, help="Same seed, same bytes.")
@click.option("--workers", type=click.IntRange(1), help="Processes; default: one a core.")
@click.pass_context
def testset(
    context: click.Context,
    photos: Path,
    folder: Path,
    blender_python: str | None,
    out: Path,
    seed: int,
    workers: int | None,
) -> None:
    """Make the evaluation sets: 400 D-Wireframe, 100 panorama cuts, 100 rooms."""
    shared = {"seed": seed, "photometry": False, "workers": workers, "cluster": None}
    wireframe = {**shared, "count": 400, "size": 320, "prior": "paper"}
    context.invoke(dwireframe, photos=photos, out=out / "dwireframe", **wireframe)
    cuts = {**shared, "count": 100, "size": 640, "prior": "wild"}
    context.invoke(panoramas, folder=folder, out=out / "panoramas", **cuts)
    if blender_python is not None:
        options = {**shared, "count": 100, "size": 320, "prior": "equisolid"}
        options |= {"blender_python": blender_python, "samples": 4, "threads": 1}
        options |= {"furniture": None, "cc0": False}
        context.invoke(rooms, out=out / "rooms", **options)


@synthesize.command("prior")
@click.argument("name", type=click.Choice(_PRIORS))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="PNG to write.")
@click.option("--count", default=4000, show_default=True, type=click.IntRange(10))
@click.option("--seed", default=1, show_default=True)
def show_prior(name: str, out: Path, count: int, seed: int) -> None:
    """Plot a lens prior: histograms of its parameters, fields of view and log density."""
    from learned.slf.card import prior_sheet
    from learned.slf.suite import write_png

    write_png(out, prior_sheet(name, count, seed=seed))


def _make(
    kind: str, make: Callable[..., Made], sources: dict[str, Any], options: dict[str, Any]
) -> None:
    """Begin or go on with a set, then write its card."""
    folder = begun(options["out"], kind, {**_settings(options), **sources})
    try:
        finish(folder, partial(make, config=_config(options)), options)
    except ValueError as error:
        raise click.ClickException(str(error)) from error


def _source_settings(paths: list[Path], root: Path) -> dict[str, Any]:
    """How many files a set is made from, and a checksum of their names."""
    names = "\n".join(path.relative_to(root).as_posix() for path in paths)
    digest = hashlib.sha256(names.encode()).hexdigest()[:16]
    return {"sources": len(paths), "sources_sha256": digest}


def _config(options: dict[str, Any]) -> SetCfg:
    from learned.slf.photometry import PhotometryCfg
    from learned.slf.synthesis import SetCfg

    photometry = PhotometryCfg() if options["photometry"] else None
    return SetCfg(
        prior=options["prior"], size=options["size"], seed=options["seed"], photometry=photometry
    )


def _settings(options: dict[str, Any]) -> dict[str, Any]:
    return {name: options[name] for name in ("seed", "count", "size", "prior", "photometry")}


def begun(out: Path, kind: str, settings: dict[str, Any]) -> SuiteFolder:
    """A suite folder with its header; a folder with other settings is misuse."""
    from learned.slf.suite import SuiteFolder

    folder = SuiteFolder(out)
    notes = {
        "dwireframe": "Photographs as planes in front of the lens; the field of view is nominal.",
        "panoramas": "Cuts of panoramas; camera and field of view are true.",
        "rooms": "Rendered rooms; camera, field of view and perspective twin are true.",
    }
    header = {"kind": kind, "name": out.name, "note": notes[kind], "settings": settings}
    _checked(folder.begin, header)
    return folder


def finish(folder: SuiteFolder, make: Callable[[int], Made], options: dict[str, Any]) -> None:
    """Make what is missing, with progress, and write the card."""
    from tqdm import tqdm

    from learned.pool import processor_count
    from learned.slf.card import write_card
    from learned.slf.synthesis import synthesize as make_missing

    count, cluster = options["count"], options["cluster"]
    workers = options["workers"] or processor_count()
    with tqdm(total=count, unit="picture", disable=None) as bar:
        make_missing(folder, make, count, workers=workers, cluster=cluster, progress=bar.update)
    write_card(folder)


def _checked(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call, and turn a ValueError into misuse of the command line."""
    try:
        return function(*arguments)
    except ValueError as error:
        raise click.UsageError(str(error)) from error

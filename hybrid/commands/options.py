"""Options and arguments that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from hybrid.camera_files import OWN_FORMAT, format_names
from hybrid.methods import DEFAULT_METHOD, method_names

Command = TypeVar("Command", bound=Callable[..., Any])

EXISTING = click.Path(exists=True, path_type=Path)
EXISTING_FILE = click.Path(exists=True, dir_okay=False, path_type=Path)
EXISTING_FOLDER = click.Path(exists=True, file_okay=False, path_type=Path)
NEW_FILE = click.Path(dir_okay=False, path_type=Path)
NEW_FOLDER = click.Path(file_okay=False, path_type=Path)


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


def _named_or_there(
    context: click.Context, parameter: click.Parameter, value: str | None
) -> str | None:
    """Weights: a bare name is one of those that ship, anything else a file."""
    if value is None or (Path(value).name == value and not Path(value).suffix):
        return value
    return str(EXISTING_FILE.convert(value, parameter, context))


paths = click.argument("paths", nargs=-1, required=True, type=EXISTING)
method = click.option(
    "--method",
    type=click.Choice(method_names()),
    default=DEFAULT_METHOD,
    show_default=True,
    help="How the lens is found.",
)
weights = click.option(
    "--weights",
    metavar="FILE|NAME",
    callback=_named_or_there,
    help="Weights of the networks: a file, or the name of some that ship (compact, compact-wf).",
)
camera = click.option(
    "--camera", type=EXISTING_FILE, help="Use this camera file instead of estimating the lens."
)
camera_name = click.option(
    "--camera-name", help="Which camera of --camera, if it holds several (cam0 of Kalibr)."
)
kind = click.option(
    "--format",
    "kind",
    type=click.Choice(format_names()),
    default=OWN_FORMAT,
    show_default=True,
    help="Of the camera file.",
)
overwrite = click.option("--overwrite", is_flag=True, help="Replace files that exist.")
threads = click.option("--threads", type=int, help="CPU threads to use.")


def as_json(what: str) -> Callable[[Command], Command]:
    """The option --json, whose value is called `as_json`."""
    return click.option("--json", "as_json", is_flag=True, help=f"Print {what}.")


def lens(command: Command) -> Command:
    """The options that say how the lens is found and what is known of it."""
    for option in reversed((method, weights, *_KNOWN)):
        command = option(command)
    return command


def frame(command: Command) -> Command:
    """The options that choose what the straight picture shows."""
    for option in reversed(_FRAME):
        command = option(command)
    return command


_FRAME = (
    click.option("--fov", type=float, help="Horizontal field of view of the result, degrees."),
    click.option("--focal", type=float, help="Focal length of the result, pixels."),
    click.option("--balance", type=float, help="0: no empty pixel (default); 1: nothing lost."),
    click.option("--size", type=SizeType(), help="Size of the result, e.g. 1280x960."),
)

_KNOWN = (
    click.option("--camera-fov", type=float, help="Field of view of the photograph, if known."),
    click.option("--camera-focal", type=float, help="Its focal length in pixels, if known."),
    click.option("--circle-fov", type=float, help="Field of view of its image circle, if known."),
)

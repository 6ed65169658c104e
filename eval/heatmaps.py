"""The command `straightlens heatmaps`: photographs under what line perception sees in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import click
import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray
from PIL import Image, ImageDraw, ImageFont

from eval.gallery import colored
from hybrid.arrays import to_rgb8
from hybrid.commands import options
from hybrid.commands.checks import (
    make_folder,
    pictures,
    refuse_existing,
    refuse_inputs,
    usage_error,
)
from hybrid.commands.reports import FAILURE, failure, progress, tell
from hybrid.failures import ITEM_ERRORS
from hybrid.images import Picture, is_picture_name, read_picture, write_picture
from hybrid.page import on_black

_SIDE = 420  # longest side of a photograph on the sheet, pixels
_GAP = 12
_NAME = 26  # pixels below a photograph for its name
_HEAD = 44  # pixels above the first row
_BAR = 160  # width of the colour scale
_PAPER, _INK = 250, 40  # grey levels
_DARK = 0.45  # brightness of the photograph under the heat
_SHARE, _GAIN = 0.9, 1.5  # of the colours where the network is sure; how soon they get there
_FAINTEST = 60  # of 255, first colour in use; the darker ones drown in photographs
_MOST = 400  # photographs on a sheet
_TITLE = "Lines that the network sees in the photograph:  unsure"


@click.command()
@options.paths
@click.option("--out", required=True, type=options.NEW_FILE, help="The sheet, a PNG or JPEG file.")
@options.weights
@click.option(
    "--columns",
    default=4,
    show_default=True,
    type=click.IntRange(1, 12),
    help="Photographs side by side.",
)
@options.overwrite
def heatmaps(
    paths: tuple[Path, ...], out: Path, weights: str | None, columns: int, overwrite: bool
) -> int:
    """Lay out photographs with the heatmap of line perception over each, to be looked at.

    PATHS are files and folders of pictures. A picture that cannot be read is reported and left out,
    and the exit code is 1.
    """
    sources = pictures(paths)
    if not is_picture_name(out):
        raise usage_error(f"expected --out to be a picture such as sheet.png, got {out.name}")
    if len(sources) > _MOST:
        raise usage_error(f"expected up to {_MOST} pictures on a sheet, got {len(sources)}")
    refuse_inputs([out], sources)
    refuse_existing([out], overwrite=overwrite)
    make_folder(out.parent)
    from learned.predictor import Predictor

    predictor = Predictor.from_weights(weights)
    cells = []
    for source in progress(sources):
        try:
            photo = to_rgb8(read_picture(source).pixels)
        except ITEM_ERRORS as error:
            tell(failure(source, error), as_json=False)
            continue
        cells.append(Cell(source.name, overlay(photo, predictor.lines(on_black(photo)).lineness)))
    if not cells:
        raise click.ClickException("expected a picture that can be read, got none")
    write_picture(out, Picture(sheet(cells, columns)))
    click.echo(out)
    return 0 if len(cells) == len(sources) else FAILURE


@dataclass(frozen=True)
class Cell:
    """A photograph of the sheet.

    Attributes:
        name: What stands below it.
        pixels: No side longer than `_SIDE`.
    """

    name: str
    pixels: UInt8[ndarray, "h w 3"]


def overlay(photo: UInt8[ndarray, "h w 3"], heat: Float[ndarray, "_ _"]) -> UInt8[ndarray, "_ _ 3"]:
    """A dim grey photograph with a heatmap over it, in the size of the sheet.

    Args:
        photo: The photograph.
        heat: Of all of it, in [0, 1] and of any size.
    """
    scale = _SIDE / max(photo.shape[:2])
    size = [max(1, round(side * scale)) for side in photo.shape[1::-1]]
    small = cv2.resize(photo, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY)[..., None] * _DARK
    level = np.clip(cv2.resize(heat.astype(np.float32), size), 0, 1)
    share = _SHARE * np.minimum(_GAIN * level, 1)[..., None]
    return np.rint(grey * (1 - share) + _colours(level) * share).astype(np.uint8)


def _colours(level: Float[ndarray, "h w"]) -> UInt8[ndarray, "h w 3"]:
    """The colour scale at levels in [0, 1]."""
    return colored(np.rint(_FAINTEST + (255 - _FAINTEST) * level).astype(np.uint8))


def sheet(cells: Sequence[Cell], columns: int) -> UInt8[ndarray, "_ _ 3"]:
    """Photographs in rows with their names below, under a line that explains the colours."""
    columns = min(columns, len(cells))
    rows = [cells[first : first + columns] for first in range(0, len(cells), columns)]
    heights = [max(cell.pixels.shape[0] for cell in row) for row in rows]
    title = round(_font(16).getlength(_TITLE)) + _BAR + 2 * _GAP + 60
    width = max(_GAP + columns * (_SIDE + _GAP), title)
    page = Image.new("RGB", (width, _HEAD + sum(heights) + len(rows) * _NAME), (_PAPER,) * 3)
    draw = ImageDraw.Draw(page)
    _explain(page, draw)
    top = _HEAD
    for row, height in zip(rows, heights, strict=True):
        for column, cell in enumerate(row):
            left = _GAP + column * (_SIDE + _GAP)
            tall, wide = cell.pixels.shape[:2]
            at = (left + (_SIDE - wide) // 2, top + height - tall)
            page.paste(Image.fromarray(cell.pixels), at)
            name = _shortened(cell.name)
            middle = left + _SIDE / 2
            draw.text((middle, top + height + 3), name, (_INK,) * 3, _font(14), anchor="ma")
        top += height + _NAME
    return np.asarray(page)


def _explain(page: Image.Image, draw: ImageDraw.ImageDraw) -> None:
    """The colour scale with its words."""
    font = _font(16)
    middle = _HEAD // 2
    draw.text((_GAP, middle), _TITLE, (_INK,) * 3, font, anchor="lm")
    left = _GAP + round(font.getlength(_TITLE)) + 8
    ramp = np.tile(np.linspace(0, 1, _BAR), (16, 1))
    page.paste(Image.fromarray(_colours(ramp)), (left, middle - 8))
    draw.text((left + _BAR + 8, middle), "sure", (_INK,) * 3, font, anchor="lm")


def _shortened(name: str) -> str:
    """A name with its middle left out where it is too long for its place."""
    font = _font(14)
    kept = len(name)
    short = name
    while font.getlength(short) > _SIDE and kept > 2:
        kept -= 1
        short = f"{name[: (kept + 1) // 2]}…{name[-(kept // 2) :]}"
    return short


@cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)

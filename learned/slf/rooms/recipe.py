"""Rooms by any number of processes: each opens its own studio and Blender once."""

import atexit
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from learned.slf.rooms.catalogue import read_catalogues
from learned.slf.rooms.render import (
    Renderer,
    RoomStudio,
    make_room,
    make_room_panorama,
    open_studio,
)
from learned.slf.suite import write_png
from learned.slf.synthesis import Made, SetCfg


@dataclass(frozen=True)
class RoomRecipe:
    """All that a room depends on but its number.

    Attributes:
        config: Lens prior, size and seed.
        python: Interpreter that has `bpy`.
        samples: Rays per pixel.
        threads: Threads of each Blender; the pictures do not depend on it.
        furniture: Folder of .sh3f files, if any.
        cc0: Only furniture in the public domain.
    """

    config: SetCfg
    python: str
    samples: int = 4
    threads: int = 1
    furniture: Path | None = None
    cc0: bool = False


def room_of(recipe: RoomRecipe, index: int) -> Made:
    """Room `index` of a recipe, by this process's studio."""
    return make_room(_studio(recipe), index, recipe.config)


def make_panorama(recipe: RoomRecipe, folder: Path, index: int) -> None:
    """Write panorama `index` of a recipe into a folder; its height is the recipe's size."""
    config = recipe.config
    image = make_room_panorama(_studio(recipe), index, config.seed, config.size)
    write_png(panorama_path(folder, index), image)


def panorama_path(folder: Path, index: int) -> Path:
    """Where panorama `index` lies."""
    return folder / f"{index:06d}.png"


@lru_cache(maxsize=1)
def _studio(recipe: RoomRecipe) -> RoomStudio:
    """The studio of this process; its textures and its Blender go when the process ends."""
    open_things = ExitStack()
    folder = Path(open_things.enter_context(tempfile.TemporaryDirectory(prefix="studio-")))
    renderer = Renderer(recipe.python, samples=recipe.samples, threads=recipe.threads)
    open_things.enter_context(renderer)
    atexit.register(open_things.close)
    models = []
    if recipe.furniture is not None:
        models = read_catalogues(recipe.furniture, cc0_only=recipe.cc0)
    return open_studio(renderer, folder, seed=recipe.config.seed, models=models)

"""Furniture models of Sweet Home 3D: .sh3f files, zips of OBJ models with a catalogue of sizes.

Debian's package sweethome3d-furniture puts them into /usr/share/sweethome3d/furniture. Each
catalogue states its licence (CC0 or CC-BY 3.0); who uses a model has to name it, so every set lists
the models in it.
"""

import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
from jaxtyping import Float
from numpy import ndarray

SUFFIX = ".sh3f"
_CATALOGUE = "PluginFurnitureCatalog.properties"
_CATEGORIES = ("Living room", "Kitchen", "Bedroom", "Office", "Bathroom")
_SMALLEST_M, _LARGEST_M = (0.3, 0.3, 0.3), (3.2, 2.3, 2.3)  # width, depth, height
_MOST_BYTES = 4_000_000  # of an OBJ file: some 60,000 triangles
_CC0 = re.compile(r"public domain|cc-?0", re.IGNORECASE)
_GLASS = re.compile(r"^\s*(d\s+0?\.\d|Tr\s+(0?\.[1-9]|1\b))", re.MULTILINE)
_ESCAPE = re.compile(r"\\u([0-9a-fA-F]{4})")


@dataclass(frozen=True)
class Model:
    """One piece of furniture that stands on the floor.

    Attributes:
        name: Unique name in its catalogue.
        archive: The .sh3f file.
        member: The OBJ file in it.
        size: Width, depth and height in metres.
        rotation: Turn of the OBJ file's axes (x right, y up, z to the front), before it is sized.
        licence: In the catalogue's words.
        creator: Who made it.
    """

    name: str
    archive: Path
    member: str
    size: tuple[float, float, float]
    rotation: Float[ndarray, "3 3"]
    licence: str
    creator: str

    @property
    def is_cc0(self) -> bool:
        """Whether the model is in the public domain."""
        return bool(_CC0.search(self.licence))

    @property
    def credit(self) -> str:
        """The line that names the model."""
        return f"{self.name} by {self.creator}; {self.licence}"


def read_catalogues(folder: Path, *, cc0_only: bool = False) -> list[Model]:
    """The usable models of all catalogues in a folder, in a fixed order.

    Usable is what stands on the floor of a room, is of a furniture's size, opaque, and has an OBJ
    file.

    Args:
        folder: Holds .sh3f files.
        cc0_only: Leave out what asks for attribution.

    Raises:
        ValueError: If there is no catalogue or nothing in it is usable.
    """
    archives = sorted(folder.glob(f"*{SUFFIX}"))
    if not archives:
        raise ValueError(f"expected {SUFFIX} files in {folder}, got none")
    models = [model for archive in archives for model in _read_archive(archive)]
    models = [model for model in models if model.is_cc0 or not cc0_only]
    if not models:
        raise ValueError(f"expected usable furniture in {folder}, got none")
    return models


def extract(model: Model, folder: Path) -> Path:
    """Unpack a model with its materials and textures; returns the OBJ file."""
    place = folder / model.archive.stem
    parent = PurePosixPath(model.member).parent
    with zipfile.ZipFile(model.archive) as archive:
        names = [n for n in archive.namelist() if PurePosixPath(n).parent == parent]
        archive.extractall(place, [name for name in names if not name.endswith("/")])
    return place / model.member


def _read_archive(path: Path) -> list[Model]:
    try:
        with zipfile.ZipFile(path) as archive:
            properties = _properties(archive.read(_CATALOGUE).decode("latin-1"))
            sizes = {entry.filename: entry.file_size for entry in archive.infolist()}
            numbers = sorted(int(key[3:]) for key in properties if key.startswith("id#"))
            found = (_model(path, properties, number) for number in numbers)
            return [m for m in found if m and _is_usable(archive, m, sizes)]
    except (zipfile.BadZipFile, KeyError) as error:
        raise ValueError(f"expected a furniture catalogue in {path}, got {error}") from error


def _properties(text: str) -> dict[str, str]:
    r"""A Java properties file: key=value lines, comments with #, letters as \uXXXX."""
    pairs = (line.split("=", 1) for line in text.splitlines() if "=" in line and line[:1] != "#")
    return {
        key.strip(): _ESCAPE.sub(lambda m: chr(int(m[1], 16)), value).strip()
        for key, value in pairs
    }


def _model(path: Path, properties: Mapping[str, str], number: int) -> Model | None:
    """One entry of a catalogue, or None if it is no furniture for the floor of a room."""

    def entry(name: str, default: str = "") -> str:
        return properties.get(f"{name}#{number}", default)

    size = tuple(float(entry(n, "0")) / 100 for n in ("width", "depth", "height"))
    fits = all(a <= b <= c for a, b, c in zip(_SMALLEST_M, size, _LARGEST_M, strict=True))
    stands = not entry("elevation") and entry("doorOrWindow") != "true"
    if not (fits and stands and entry("category") in _CATEGORIES):
        return None
    rotation = np.array([float(x) for x in entry("modelRotation", "1 0 0 0 1 0 0 0 1").split()])
    licence = " ".join(properties.get("license", "licence not stated").split())
    width, depth, height = size
    return Model(
        name=entry("id"),
        archive=path,
        member=entry("model").lstrip("/"),
        size=(width, depth, height),
        rotation=rotation.reshape(3, 3),
        licence=licence,
        creator=entry("creator", "unknown"),
    )


def _is_usable(archive: zipfile.ZipFile, model: Model, sizes: Mapping[str, int]) -> bool:
    """Whether a model is there, of moderate size and opaque: lines seen through glass count not."""
    if not 0 < sizes.get(model.member, 0) <= _MOST_BYTES:
        return False
    materials = str(PurePosixPath(model.member).with_suffix(".mtl"))
    if materials not in sizes:
        return True
    return not _GLASS.search(archive.read(materials).decode("latin-1"))

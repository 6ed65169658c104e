"""Annotation files of the wireframe dataset, which D-Wireframe was bent from.

Huang et al., "Learning to Parse Wireframes in Images of Man-Made Environments", CVPR 2018. For a
picture `NAME.jpg` the lines are in one of

    NAME.pkl        a dictionary with `points` (x, y) and `lines`, pairs of numbers of points
    NAME_line.mat   MATLAB: `lines`, (n, 4) as x1, y1, x2, y2
    *.json          as L-CNN passes the dataset on: a list of entries with `filename` and `lines`

anywhere below the folder of photographs, so the dataset may lie as it is unpacked.
"""

import json
import pickle
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

_MATLAB_TAIL = "_line"
# the origin is the corner of the top-left pixel (L-CNN mirrors x to width - x)
_CENTRE = 0.5
_HARMLESS = {
    ("numpy._core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "scalar"),
    ("numpy", "ndarray"),
    ("numpy", "dtype"),
    ("_codecs", "encode"),
    ("builtins", "set"),
    ("__builtin__", "set"),
}


class Photograph(NamedTuple):
    """A perspective photograph.

    Attributes:
        path: The picture.
        annotation: File that holds its lines; None where they have to be found.
    """

    path: Path
    annotation: Path | None = None


def with_annotations(paths: Iterable[Path], root: Path) -> list[Photograph]:
    """Photographs with the annotation files of the wireframe dataset, where there are any.

    Args:
        paths: The pictures.
        root: Folder whose annotation files are looked at, with all below it.
    """
    known: dict[str, Path] = {}
    for file in sorted(root.rglob("*.json")):
        known |= dict.fromkeys(_listed(file), file)
    for file in sorted(root.rglob(f"*{_MATLAB_TAIL}.mat")):
        known[file.stem.removesuffix(_MATLAB_TAIL)] = file
    known |= {file.stem: file for file in sorted(root.rglob("*.pkl"))}
    return [Photograph(path, known.get(path.stem)) for path in paths]


def wireframe_segments(photograph: Photograph) -> Float[ndarray, "n 4"]:
    """The annotated lines (u1, v1, u2, v2) in pixels of the photograph, longest first.

    Raises:
        ValueError: If the file holds no lines of this picture.
    """
    file = photograph.annotation
    assert file is not None
    if file.suffix == ".json":
        lines = _listed(file)[photograph.path.stem]
    else:
        lines = _of_matlab(file) if file.suffix == ".mat" else _of_pickle(file)
    ends = _checked(lines, file) - _CENTRE
    lengths = np.hypot(ends[:, 2] - ends[:, 0], ends[:, 3] - ends[:, 1])
    order = np.argsort(-lengths, kind="stable")
    return ends[order][lengths[order] > 0].astype(np.float32)


class _ArraysOnly(pickle.Unpickler):
    """Reads containers, numbers and NumPy arrays; a pickle that names anything else is refused."""

    def find_class(self, module: str, name: str) -> Any:
        module = module.replace("numpy.core", "numpy._core")
        if (module, name) not in _HARMLESS:
            raise pickle.UnpicklingError(f"it holds {module}.{name}")
        return super().find_class(module, name)


def _of_pickle(file: Path) -> Any:
    try:
        with file.open("rb") as stream:
            record = _ArraysOnly(stream, encoding="latin1").load()  # written by Python 2
        points = np.asarray(record["points"], float).reshape(-1, 2)
        pairs = np.asarray(record["lines"], int).reshape(-1, 2)
        return points[pairs].reshape(-1, 4)
    except (pickle.UnpicklingError, EOFError, KeyError, IndexError, TypeError, ValueError) as error:
        raise ValueError(f"expected a pickle of the wireframe dataset in {file}: {error}") from None


def _of_matlab(file: Path) -> Any:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        return loadmat(file)["lines"]
    except (MatReadError, KeyError, NotImplementedError, ValueError) as error:
        raise ValueError(f"expected the array `lines` in {file}: {error}") from None


@lru_cache(maxsize=8)
def _listed(file: Path) -> dict[str, Any]:
    """Lines by the picture's name, of a JSON list; empty for other JSON files."""
    try:
        record = json.loads(file.read_text())
    except ValueError:
        return {}
    entries = record if isinstance(record, list) else []
    return {
        Path(str(entry["filename"])).stem: entry["lines"]
        for entry in entries
        if isinstance(entry, dict) and {"filename", "lines"} <= entry.keys()
    }


def _checked(lines: Any, file: Path) -> ndarray:
    try:
        ends = np.asarray(lines, float).reshape(-1, 4)
    except (TypeError, ValueError):
        ends = np.full((1, 4), np.nan)
    if not np.isfinite(ends).all():
        raise ValueError(f"expected lines x1, y1, x2, y2 in {file}")
    return ends

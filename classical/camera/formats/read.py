"""Reading a camera file of any known kind, told by its content."""

from __future__ import annotations

import os
from collections.abc import Mapping
from types import ModuleType

from classical.camera.formats import (
    colmap,
    gyroflow,
    kalibr,
    nerfstudio,
    ocam,
    opencv,
    straightlens,
)
from classical.camera.formats.record import Content, read_content
from classical.camera.kannala_brandt import KannalaBrandt

_KINDS = (colmap, ocam, straightlens, gyroflow, nerfstudio, opencv, kalibr)


def read_lens(path: str | os.PathLike[str], camera: str | None = None) -> KannalaBrandt:
    """Read the lens of a camera file of any format in `CAMERA_FORMATS`, or of this project.

    Args:
        path: The file; what it is shows in its content.
        camera: Which camera, where the file holds several (cam0 of Kalibr, a number of COLMAP).

    Returns:
        The lens; of a model other than Kannala–Brandt the nearest.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is of no known kind, broken, or of a lens that is not a fisheye.
    """
    try:
        return chosen_camera(cameras_of(read_content(path)), camera)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def kind_of(content: Content) -> ModuleType:
    """The module of the format that a file has.

    Raises:
        ValueError: If it has none of these.
    """
    for kind in _KINDS:
        if kind.matches(content):
            return kind
    raise ValueError("not a camera file of a known kind")


def cameras_of(content: Content) -> Mapping[str, KannalaBrandt | ValueError]:
    """The cameras of a file by name; an error stands for one that cannot be used.

    Raises:
        ValueError: If the file is of no known kind or broken.
    """
    return kind_of(content).load(content)


def chosen_camera(
    cameras: Mapping[str, KannalaBrandt | ValueError], name: str | None
) -> KannalaBrandt:
    """The camera of that name, or the only one.

    Raises:
        ValueError: If there is none of that name, or several and no name.
    """
    listed = ", ".join(list(cameras)[:8])
    if name is None and len(cameras) > 1:
        raise ValueError(f"the file holds {len(cameras)} cameras, say which: {listed}")
    if name is not None and name not in cameras:
        raise ValueError(f"expected the camera {name!r}, got {listed}")
    found = cameras[name] if name is not None else next(iter(cameras.values()))
    if isinstance(found, ValueError):
        raise found
    return found

"""The table of formats that a lens can be written in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from classical.camera.convert import Residual, conversion_residual, nearest_division, nearest_ocam
from classical.camera.formats import (
    colmap,
    gyroflow,
    kalibr,
    nerfstudio,
    ocam,
    opencv,
    straightlens,
)
from classical.camera.kannala_brandt import KannalaBrandt


class Export(NamedTuple):
    """The text of a camera file, and how near its model comes; None where it is exact."""

    text: str
    residual: Residual | None


@dataclass(frozen=True)
class CameraFormat:
    """A row of the table.

    Attributes:
        name: What the user writes.
        title: What it is, in a few words.
        suffix: Usual ending of its files.
        export: Turns a lens into the text of a file.
    """

    name: str
    title: str
    suffix: str
    export: Callable[[KannalaBrandt], Export]


def _exact(dump: Callable[[KannalaBrandt], str]) -> Callable[[KannalaBrandt], Export]:
    return lambda camera: Export(dump(camera), None)


def _division(camera: KannalaBrandt) -> Export:
    nearest = nearest_division(camera)
    residual = conversion_residual(camera, nearest)
    return Export(straightlens.dump_division(nearest, residual), residual)


def _ocam(camera: KannalaBrandt) -> Export:
    nearest = nearest_ocam(camera)
    residual = conversion_residual(camera, nearest)
    return Export(ocam.dump(nearest, residual), residual)


CAMERA_FORMATS = (
    CameraFormat("opencv", "cv2.FileStorage, for cv2.fisheye", ".yaml", _exact(opencv.dump_opencv)),
    CameraFormat("colmap", "cameras.txt, OPENCV_FISHEYE", ".txt", _exact(colmap.dump)),
    CameraFormat("kalibr", "camchain, pinhole-equi", ".yaml", _exact(kalibr.dump)),
    CameraFormat("ros", "camera_info, equidistant", ".yaml", _exact(opencv.dump_ros)),
    CameraFormat("nerfstudio", "transforms.json without frames", ".json", _exact(nerfstudio.dump)),
    CameraFormat("gyroflow", "lens profile", ".json", _exact(gyroflow.dump)),
    CameraFormat("ocam", "OCamCalib's calib_results.txt, nearest polynomial", ".txt", _ocam),
    CameraFormat("division", "one-parameter division model, nearest", ".json", _division),
)

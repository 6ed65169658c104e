"""OpenCV's fisheye model in a YAML file of `cv2.FileStorage`, and the ROS message camera_info.

Both count pixels from the centre of the top-left one, as this project does, and name the four
coefficients after the linear one; ROS calls the model `equidistant`.
"""

from __future__ import annotations

import cv2
import numpy as np

from classical.camera.formats.fisheye import fisheye_camera
from classical.camera.formats.record import Content, Record, picture_size, shown
from classical.camera.kannala_brandt import KannalaBrandt

_FISHEYE_NAMES = (
    "fisheye",
    "equidistant",
    "equi",
    "kannala_brandt",
    "kannala_brandt4",
    "opencv_fisheye",
)
_MATRIX = ("camera_matrix", "K", "cameraMatrix", "intrinsic_matrix")
_DISTORTION = ("distortion_coefficients", "D", "distCoeffs", "dist_coeffs")
_SIZES = ("image_size", "resolution", "size", "imageSize")


def dump_opencv(camera: KannalaBrandt) -> str:
    """A file for `cv2.FileStorage`: camera_matrix and distortion_coefficients for `cv2.fisheye`."""
    K, D = camera.to_opencv()
    mode = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML
    file = cv2.FileStorage("camera.yaml", mode)
    file.write("image_width", camera.width)
    file.write("image_height", camera.height)
    file.write("distortion_model", "fisheye")
    file.write("camera_matrix", K)
    file.write("distortion_coefficients", D.reshape(4, 1))
    return file.releaseAndGetString()


def dump_ros(camera: KannalaBrandt) -> str:
    """A file for `camera_info_manager`; the projection matrix keeps the scale of the centre."""
    import yaml  # not needed for reading

    K, D = camera.to_opencv()
    fields = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": "camera",
        "camera_matrix": _ros_matrix(K),
        "distortion_model": "equidistant",
        "distortion_coefficients": _ros_matrix(D[None]),
        "rectification_matrix": _ros_matrix(np.eye(3)),
        "projection_matrix": _ros_matrix(np.hstack([K, np.zeros((3, 1))])),
    }
    return yaml.safe_dump(fields, sort_keys=False, default_flow_style=None)


def matches(content: Content) -> bool:
    """True for a record with a camera matrix."""
    return any(name in content.record for name in _MATRIX)


def load(content: Content) -> dict[str, KannalaBrandt]:
    """The camera of a file of OpenCV or ROS."""
    record = content.record
    fx, skew, cx, _, fy, cy, *_ = record.numbers(*_MATRIX, count=9).tolist()
    D = record.numbers(*_DISTORTION)
    model = record.text("distortion_model", "model", default="fisheye").lower()
    if model not in _FISHEYE_NAMES or len(D) != 4:
        raise ValueError(
            "expected a fisheye calibration with four coefficients, "
            f"got the model {shown(model)} with {len(D)}"
        )
    if abs(skew) > 1e-9 * abs(fx):
        raise ValueError(f"expected a camera matrix without skew, got {skew:g}")
    return {"camera": fisheye_camera((fx, fy, cx, cy), D.tolist(), _size(record))}


def _size(record: Record) -> tuple[int, int]:
    for name in _SIZES:
        if name in record:
            return picture_size(*record.numbers(name, count=2).tolist())
    return record.size("image_width", "image_height")


def _ros_matrix(values: np.ndarray) -> dict[str, object]:
    rows, columns = values.shape
    return {"rows": rows, "cols": columns, "data": values.ravel().tolist()}

"""Gyroflow's lens profile, model OpenCV fisheye; pixels count from the centre of the top-left one.

Gyroflow puts the principal point in the middle unless the profile says `asymmetrical`.
"""

from __future__ import annotations

import json

from classical.camera.formats.fisheye import fisheye_camera
from classical.camera.formats.record import Content, shown
from classical.camera.kannala_brandt import KannalaBrandt

_MODELS = ("", "opencv_fisheye")


def dump(camera: KannalaBrandt) -> str:
    """A lens profile; names of camera and lens are left for the user to fill in."""
    K, D = camera.to_opencv()
    size = {"w": camera.width, "h": camera.height}
    fields = {
        "name": f"Straightlens_{camera.width}x{camera.height}",
        "note": "",
        "calibrated_by": "Straightlens",
        "camera_brand": "",
        "camera_model": "",
        "lens_model": "",
        "camera_setting": "",
        "calib_dimension": size,
        "orig_dimension": size,
        "output_dimension": size,
        "frame_readout_time": None,
        "gyro_lpf": None,
        "input_horizontal_stretch": 1.0,
        "input_vertical_stretch": 1.0,
        "num_images": 0,
        "fps": 0.0,
        "crop": None,
        "official": False,
        "asymmetrical": True,
        "use_opencv_fisheye": True,
        "fisheye_params": {
            "RMS_error": 0.0,
            "camera_matrix": K.tolist(),
            "distortion_coeffs": D.tolist(),
            "radial_distortion_limit": None,
        },
        "use_opencv_standard": False,
        "identifier": "",
        "calibrator_version": "1.6.0",  # Gyroflow refuses a profile without; of this layout
        "date": "",
        "compatible_settings": [],
        "sync_settings": None,
        "distortion_model": "opencv_fisheye",
    }
    return json.dumps(fields, indent=2) + "\n"


def matches(content: Content) -> bool:
    """True for a record with fisheye_params."""
    return "fisheye_params" in content.record


def load(content: Content) -> dict[str, KannalaBrandt]:
    """The camera of a profile."""
    record = content.record
    model = record.text("distortion_model", default="")
    if model not in _MODELS:
        raise ValueError(f"expected the distortion_model opencv_fisheye, got {shown(model)}")
    for name in ("input_horizontal_stretch", "input_vertical_stretch"):
        if name in record and record.number(name) not in (0.0, 1.0):
            raise ValueError(f"expected pictures that are not stretched, got {name}")
    lens, size = record.part("fisheye_params"), record.part("calib_dimension")
    fx, _, cx, _, fy, cy, *_ = lens.numbers("camera_matrix", count=9).tolist()
    D = lens.numbers("distortion_coeffs", count=4)
    return {"camera": fisheye_camera((fx, fy, cx, cy), D.tolist(), size.size("w", "h"))}

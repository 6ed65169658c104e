"""Kalibr's camchain, model pinhole-equi; pixels count from the centre of the top-left one."""

from __future__ import annotations

from classical.camera.formats.fisheye import fisheye_camera, fisheye_parameters
from classical.camera.formats.record import Content, Record, picture_size, shown
from classical.camera.kannala_brandt import KannalaBrandt

_FIELDS = ("camera_model", "distortion_model")
_MODEL = ("pinhole", "equidistant")


def dump(camera: KannalaBrandt) -> str:
    """A camchain of one camera, cam0."""
    import yaml  # not needed for reading

    parameters, coefficients = fisheye_parameters(camera)
    fields = {
        "camera_model": _MODEL[0],
        "intrinsics": parameters,
        "distortion_model": _MODEL[1],
        "distortion_coeffs": coefficients,
        "resolution": [camera.width, camera.height],
        "cam_overlaps": [],
        "rostopic": "/cam0/image_raw",
    }
    return yaml.safe_dump({"cam0": fields}, sort_keys=False, default_flow_style=None)


def matches(content: Content) -> bool:
    """True for a record whose parts name a camera model."""
    return bool(_cameras(content.record))


def load(content: Content) -> dict[str, KannalaBrandt | ValueError]:
    """The cameras of the chain; one of another model is told when it is asked for."""
    found: dict[str, KannalaBrandt | ValueError] = {}
    for camera, record in _cameras(content.record).items():
        model = " ".join(record.text(name, default="?") for name in _FIELDS)
        if model == " ".join(_MODEL):
            found[camera] = _camera(record)
        else:
            message = f"expected {' '.join(_MODEL)} in {camera}, got {shown(model)}"
            found[camera] = ValueError(message)
    return found


def _cameras(record: Record) -> dict[str, Record]:
    return {name: part for name, part in record.parts().items() if "camera_model" in part}


def _camera(record: Record) -> KannalaBrandt:
    parameters = record.numbers("intrinsics", count=4)
    coefficients = record.numbers("distortion_coeffs", count=4)
    size = picture_size(*record.numbers("resolution", count=2).tolist())
    return fisheye_camera(parameters.tolist(), coefficients.tolist(), size)

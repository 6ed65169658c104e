"""COLMAP's cameras.txt, model OPENCV_FISHEYE.

COLMAP counts pixels from the outer corner of the top-left one, whose centre is (0.5, 0.5).
"""

from __future__ import annotations

from classical.camera.formats.fisheye import fisheye_camera, fisheye_parameters
from classical.camera.formats.record import Content, picture_size
from classical.camera.kannala_brandt import KannalaBrandt

CORNER = 0.5  # coordinates of the centre of the top-left pixel
# for each model, the places of fx, fy, cx, cy and of the coefficients that it has
_MODELS = {
    "OPENCV_FISHEYE": ((0, 1, 2, 3), (4, 5, 6, 7)),
    "RADIAL_FISHEYE": ((0, 0, 1, 2), (3, 4)),
    "SIMPLE_RADIAL_FISHEYE": ((0, 0, 1, 2), (3,)),
}


def dump(camera: KannalaBrandt) -> str:
    """A cameras.txt of one camera with the number 1."""
    (fx, fy, cx, cy), coefficients = fisheye_parameters(camera)
    numbers = [fx, fy, cx + CORNER, cy + CORNER, *coefficients]
    words = ["1", "OPENCV_FISHEYE", str(camera.width), str(camera.height)]
    header = (
        "# Camera list with one line of data per camera:\n"
        "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
        "# Number of cameras: 1\n"
    )
    return header + " ".join(words + [repr(number) for number in numbers]) + "\n"


def matches(content: Content) -> bool:
    """True where a line begins as a camera does: number, MODEL, width, height."""
    if not content.lines or len(content.lines[0]) < 5:
        return False
    number, model, width, height = content.lines[0][:4]
    return model.isupper() and all(word.isdecimal() for word in (number, width, height))


def load(content: Content) -> dict[str, KannalaBrandt | ValueError]:
    """The cameras by their numbers; one of another model is told when it is asked for."""
    found: dict[str, KannalaBrandt | ValueError] = {}
    for number, *words in content.lines:
        try:
            found[number] = _camera(words)
        except ValueError as error:
            found[number] = ValueError(f"camera {number[:9]}: {error}")
    return found


def _camera(words: list[str]) -> KannalaBrandt:
    model = words[0] if words else ""
    if model not in _MODELS:
        raise ValueError(f"expected the model {' or '.join(_MODELS)}, got {model[:40]}")
    focal_and_centre, coefficients = _MODELS[model]
    width, height, *numbers = (float(word) for word in words[1:])
    expected = 1 + max(focal_and_centre + coefficients)
    if len(numbers) != expected:
        raise ValueError(f"expected {expected} parameters of {model}, got {len(numbers)}")
    fx, fy, cx, cy = (numbers[i] for i in focal_and_centre)
    D = [*(numbers[i] for i in coefficients), 0.0, 0.0, 0.0][:4]
    return fisheye_camera((fx, fy, cx - CORNER, cy - CORNER), D, picture_size(width, height))

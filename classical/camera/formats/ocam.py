"""OCamCalib's calib_results.txt: Scaramuzza's polynomials.

The centre is given row first and counts from the centre of the top-left pixel ("starting from 0,
C convention").
"""

from __future__ import annotations

import numpy as np

from classical.camera.convert import Residual, nearest_kannala_brandt
from classical.camera.formats.record import Content, picture_size
from classical.camera.kannala_brandt import KannalaBrandt
from classical.camera.ocam import Ocam

_LARGEST_SHEAR = 5e-3  # of the affine part, which Kannala–Brandt has not


def dump(camera: Ocam, residual: Residual) -> str:
    """The file; how near it comes to the lens stands in its first comment."""
    nearness = f"nearest to the lens by {residual.rms_px:.4f} px rms, {residual.max_px:.4f} at most"
    records = (  # one comment each, no more: OCamCalib's reader counts lines
        (
            "polynomial coefficients for the DIRECT mapping function (ocam_model.ss in MATLAB). "
            f"These are used by cam2world ({nearness})",
            [len(camera.direct), *camera.direct.tolist()],
        ),
        (
            "polynomial coefficients for the inverse mapping function (ocam_model.invpol in "
            "MATLAB). These are used by world2cam",
            [len(camera.inverse), *camera.inverse.tolist()],
        ),
        ('center: "row" and "column", starting from 0 (C convention)', [camera.v0, camera.u0]),
        ('affine parameters "c", "d", "e"', [camera.stretch, 0.0, 0.0]),
        ('image size: "height" and "width"', [camera.height, camera.width]),
    )
    parts = [f"#{title}\n\n{' '.join(map(repr, numbers))}\n" for title, numbers in records]
    return "\n".join(parts)


def matches(content: Content) -> bool:
    """True where the first line is a count and that many numbers."""
    if not content.lines:
        return False
    first = content.lines[0]
    return first[0].isdecimal() and len(first[0]) < 4 and len(first) == int(first[0]) + 1


def load(content: Content) -> dict[str, KannalaBrandt]:
    """The Kannala–Brandt lens nearest to the camera of the file."""
    ocam = parse(content)
    with np.errstate(all="ignore"):  # what overflows is not finite, and refused for that
        return {"camera": nearest_kannala_brandt(ocam, aspect=ocam.stretch)}


def parse(content: Content) -> Ocam:
    """The camera of the file as it is.

    Raises:
        ValueError: If a record is missing or the affine part shears.
    """
    try:
        rows = [np.array(words, dtype=np.float64) for words in content.lines[:5]]
    except ValueError:
        raise ValueError("expected numbers in every line that is no comment") from None
    counts = [len(row) for row in rows]
    if counts[2:] != [2, 3, 2]:
        raise ValueError(f"expected the five records of OCamCalib, got lines of {counts} numbers")
    direct, inverse, (row, column), (stretch, *shears), (height, width) = rows
    if np.abs(shears).max() > _LARGEST_SHEAR:
        raise ValueError(f"expected square axes, got shear {shears[0]:g}, {shears[1]:g}")
    size = picture_size(float(width), float(height))
    return Ocam(direct[1:], inverse[1:], float(column), float(row), float(stretch), *size)

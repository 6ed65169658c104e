"""Curves drawn over their picture, coloured by how straight the lens makes them.

Residuals run through viridis, which people with any kind of colour blindness can order; curves that
the fit did not take for straight lines are vermilion and dashed, so that they differ in form too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, Shaped, UInt8

from classical.fit import FittedCurve
from hybrid.arrays import check_image, to_rgb8

_REJECTED = (213, 94, 0)  # vermilion of Okabe & Ito
_DARKEST = 60  # of 255, first colour of the scale in use
_SUBPIXEL_BITS = 4
_SCALES = (0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)  # pixels; ends of the legend
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw_curves(
    image: Shaped[np.ndarray, "..."],
    curves: Sequence[FittedCurve],
    *,
    max_residual: float | None = None,
    legend: bool = True,
) -> UInt8[np.ndarray, "h w 3"]:
    """Draw curves over a picture with a legend in pixels.

    Args:
        image: The picture that the curves were found in; RGB, grey or RGBA.
        curves: Polylines with their residuals.
        max_residual: Residual in pixels of the legend's upper end; None chooses a round number by
            the curves.
        legend: Whether to draw the legend.

    Returns:
        An RGB picture of 8 bits.
    """
    check_image(image)
    canvas = to_rgb8(image).copy()
    unit = max(canvas.shape[:2]) / 1280
    top = _scale_end(curves) if max_residual is None else max_residual
    width = max(1, round(2 * unit))
    for curve in sorted(curves, key=lambda curve: curve.inlier):
        if curve.inlier:
            _polyline(canvas, curve.points, (0, 0, 0), width + max(1, round(2 * unit)))
            _polyline(canvas, curve.points, _colour(curve.residual_px / top), width)
        else:
            _dashes(canvas, curve.points, max(1, round(unit)), 8 * unit)
    if legend and min(canvas.shape[:2]) >= 100:
        _draw_legend(canvas, top, unit)
    return canvas


def _scale_end(curves: Sequence[FittedCurve]) -> float:
    """The smallest round number that nearly all inliers stay below."""
    residuals = [curve.residual_px for curve in curves if curve.inlier]
    wanted = float(np.quantile(residuals, 0.95)) if residuals else 0.0
    return next((scale for scale in _SCALES if scale >= wanted), _SCALES[-1])


def _colour(share: float) -> tuple[int, int, int]:
    """Viridis at a place in [0, 1], without its darkest part, which drowns in photographs."""
    level = np.uint8(round(_DARKEST + (255 - _DARKEST) * min(max(share, 0.0), 1.0)))
    blue, green, red = cv2.applyColorMap(np.full((1, 1), level), cv2.COLORMAP_VIRIDIS)[0, 0]
    return int(red), int(green), int(blue)


def _polyline(
    canvas: np.ndarray, points: Float[np.ndarray, "n 2"], colour: tuple[int, int, int], width: int
) -> None:
    fixed = np.rint(points * 2**_SUBPIXEL_BITS).astype(np.int32)
    cv2.polylines(canvas, [fixed], False, colour, width, cv2.LINE_AA, _SUBPIXEL_BITS)


def _dashes(
    canvas: np.ndarray, points: Float[np.ndarray, "n 2"], width: int, period: float
) -> None:
    """Every other stretch of a rejected curve."""
    steps = np.hypot(*np.diff(points, axis=0).T)
    dash = (np.concatenate([[0.0], np.cumsum(steps)]) // max(period, 3.0)).astype(int)
    for number in range(0, int(dash[-1]) + 1, 2):
        part = points[dash == number]
        if len(part) > 1:
            _polyline(canvas, part, _REJECTED, width)


def _draw_legend(canvas: np.ndarray, top: float, unit: float) -> None:
    """A dark box in the corner with the colour scale and what the dashes mean."""
    size = max(0.35, 0.5 * unit)
    line = math.ceil(30 * size)
    text = [f"0 to {top:g} px off straight", "dashed: not a line"]
    width = max(cv2.getTextSize(words, _FONT, size, 1)[0][0] for words in text) + line
    height = round(3.4 * line)
    box = canvas[-height:, :width]
    box[:] = box // 4
    bottom = canvas.shape[0] - height
    left, right = line // 2, min(width - line // 2, canvas.shape[1] - 1)
    for x in range(left, right):
        colour = _colour((x - left) / (right - left))
        cv2.line(canvas, (x, bottom + line // 3), (x, bottom + line), colour, 1)
    for row, words in enumerate(text):
        colour = (255, 255, 255) if row == 0 else (255, 160, 90)
        at = (left, bottom + round((1.85 + row) * line))
        cv2.putText(canvas, words, at, _FONT, size, colour, 1, cv2.LINE_AA)

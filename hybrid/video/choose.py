"""The frames of a film that tell most about its lens.

Spread over the film, the sharpest of each moment, and of these greedily those whose lines lie where
the lines of the frames before do not.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from classical.lines import ImageCurvesConfig, curves_from_image
from hybrid.video.source import Film

MAX_FRAMES = 8
_MOMENTS = 16
_BURST = 5  # successive frames, of which the sharpest is taken
_LOOKED_AT = 640  # pixels across of what is looked at
_BLURRED = 0.3  # of the median sharpness; less is left out
_GRID = (16, 9, 4)  # columns, rows, directions
_NEW = 0.05  # a frame that adds a smaller share of lines is not worth its time
_SPACING = 4.0  # pixels between points of a curve
_CURVES = ImageCurvesConfig(max_size=_LOOKED_AT, min_size=1, max_curves=150)


def chosen_frames(
    film: Film, *, most: int = MAX_FRAMES
) -> list[tuple[float, UInt8[np.ndarray, "h w 3"]]]:
    """Choose frames to calibrate from.

    Args:
        film: The film.
        most: At most so many.

    Returns:
        For each its time in seconds and its picture, upright; in order of time.

    Raises:
        ValueError: If no frame can be decoded.
    """
    candidates = [max(burst, key=_sharpness) for burst in _bursts(film) if burst]
    if not candidates:
        raise ValueError(f"{film.path}: no frame can be decoded")
    sharpness = np.array([_sharpness(frame) for frame in candidates])
    sharp = [
        frame
        for frame, value in zip(candidates, sharpness, strict=True)
        if value >= _BLURRED * np.median(sharpness)
    ]
    lines = [_line_cells(_grey(frame)) for frame in sharp]
    chosen = sorted(_greedy(lines, most))
    return [(film.seconds(sharp[i]), film.picture(sharp[i])) for i in chosen]


def _bursts(film: Film) -> list[list[Any]]:
    """A few successive frames of each moment; of a film of unknown length, of its first seconds."""
    step = 1.0 if film.duration is None else film.duration / _MOMENTS
    times = [(i + 0.5) * step for i in range(_MOMENTS)]
    if film.n_frames is not None and film.n_frames <= _MOMENTS:
        return [[frame] for frame in film.frames()]
    bursts = list(film.frames_from(times, _BURST))
    return (
        bursts if any(bursts) else [[frame] for frame, _ in zip(film.frames(), times, strict=False)]
    )


def _grey(frame: Any) -> UInt8[np.ndarray, "h w"]:
    """A small grey picture of a frame as it is stored."""
    grey = frame.reformat(format="gray").to_ndarray()
    factor = _LOOKED_AT / max(grey.shape)
    if factor >= 1:
        return grey
    size = max(1, round(grey.shape[1] * factor)), max(1, round(grey.shape[0] * factor))
    return cv2.resize(grey, size, interpolation=cv2.INTER_AREA)


def _sharpness(frame: Any) -> float:
    """Variance of the Laplacian."""
    return float(cv2.Laplacian(_grey(frame), cv2.CV_32F).var())


def _line_cells(grey: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "columns rows directions"]:
    """Where in the picture lines run, and in which direction."""
    columns, rows, directions = _GRID
    cells = np.zeros(_GRID, bool)
    for curve in curves_from_image(grey, config=_CURVES):
        points = curve.thinned(_SPACING)
        steps = np.diff(points, axis=0)
        middle = points[:-1] + steps / 2
        angle = np.arctan2(steps[:, 1], steps[:, 0]) % np.pi
        u = np.clip(middle[:, 0] / grey.shape[1] * columns, 0, columns - 1).astype(int)
        v = np.clip(middle[:, 1] / grey.shape[0] * rows, 0, rows - 1).astype(int)
        cells[u, v, (angle / np.pi * directions).astype(int) % directions] = True
    return cells


def _greedy(lines: list[np.ndarray], most: int) -> list[int]:
    """Indices of the frames, the one with the most new lines first."""
    chosen: list[int] = []
    seen = np.zeros(_GRID, bool)
    while len(chosen) < min(most, len(lines)):
        gains = [0 if i in chosen else int((cells & ~seen).sum()) for i, cells in enumerate(lines)]
        best = int(np.argmax(gains))
        if chosen and gains[best] < max(1, _NEW * seen.sum()):
            break
        chosen.append(best)
        seen |= lines[best]
    return chosen

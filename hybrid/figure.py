"""One picture that tells the whole story: input, curves over it, result, numbers of the lens."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Shaped, UInt8

from classical.camera import KannalaBrandt
from hybrid.arrays import to_rgb8
from hybrid.overlay import draw_curves
from hybrid.result import Rectification

_FONT = cv2.FONT_HERSHEY_SIMPLEX
_INK, _PAPER = (40, 40, 40), 250
_GAP = 12  # pixels between panels
_TITLE = 34  # pixels above a panel


def side_by_side(
    image: Shaped[np.ndarray, "..."], result: Rectification, *, height: int = 480
) -> UInt8[np.ndarray, "h w 3"]:
    """Lay out input, heatmap if there is one, curves, result and numbers in one row.

    Args:
        image: The picture that was rectified.
        result: What came of it.
        height: Height of each panel in pixels.

    Returns:
        An RGB picture of 8 bits.
    """
    small = _at_height(to_rgb8(image), height)
    factor = height / image.shape[0]
    curves = [replace(curve, points=curve.points * factor) for curve in result.curves]
    columns = [
        _panel("input", small),
        *_heatmap(result, small),
        _panel("curves found in it", draw_curves(small, curves)),
        _panel("rectified", _at_height(to_rgb8(result.image), height)),
        _numbers(result, height),
    ]
    gap = np.full((height + _TITLE, _GAP, 3), _PAPER, np.uint8)
    row = [gap]
    for column in columns:
        row += [column, gap]
    strip = np.hstack(row)
    return np.vstack([strip, np.full((_GAP, strip.shape[1], 3), _PAPER, np.uint8)])


def describe(result: Rectification) -> list[str]:
    """The lens and how far to trust it, a line each."""
    quality = result.quality
    lines = [f"status: {result.status}"]
    if result.camera is not None:
        lines += describe_camera(result.camera)
    if result.target is not None:
        view = math.degrees(result.target.horizontal_fov)
        lines.append(f"shown: {view:.1f} deg across, f = {result.target.focal_u:.1f} px")
    if quality.n_curves:
        lines.append(f"curves: {quality.n_inliers} straight of {quality.n_curves}")
        lines.append(f"off straight: {quality.rms_px:.2f} px rms")
    if math.isfinite(quality.predicted_error_px):
        lines.append(f"expected error: {quality.predicted_error_px:.2f} px of 320")
    if math.isfinite(quality.scale_deviation):
        spread = 100 * quality.scale_deviation
        lines.append(f"focal length: from {quality.scale_source}, +-{spread:.0f} %")
    return lines


def describe_camera(camera: KannalaBrandt) -> list[str]:
    """The lens in OpenCV's terms."""
    K, D = camera.to_opencv()
    middle = np.array([[-0.5, camera.v0], [camera.width - 0.5, camera.v0]])
    rays, seen = camera.unproject(middle)
    edges = [math.degrees(math.atan2(abs(x), z)) for x, _, z in rays]
    view = f"{sum(edges):.1f} deg" if seen.all() else f"over {sum(edges):.0f} deg"
    return [
        f"field of view: {view} across",
        f"fx = {K[0, 0]:.1f}  fy = {K[1, 1]:.1f}",
        f"cx = {K[0, 2]:.1f}  cy = {K[1, 2]:.1f}",
        *(f"D{i + 1} = {value:+.5f}" for i, value in enumerate(D)),
    ]


def _heatmap(result: Rectification, picture: np.ndarray) -> list[np.ndarray]:
    """The heatmap's panel, over a dim picture; none without a heatmap."""
    if result.heatmap is None:
        return []
    size = (picture.shape[1], picture.shape[0])
    heat = cv2.resize(result.heatmap.astype(np.float32), size)[..., None]
    colour = cv2.applyColorMap((heat * 255).astype(np.uint8), cv2.COLORMAP_INFERNO)[..., ::-1]
    mixed = (1 - heat) * 0.35 * picture + heat * colour
    return [_panel("lines the network sees", mixed.astype(np.uint8))]


def _at_height(pixels: np.ndarray, height: int) -> np.ndarray:
    width = max(1, round(pixels.shape[1] * height / pixels.shape[0]))
    kernel = cv2.INTER_AREA if height < pixels.shape[0] else cv2.INTER_LINEAR
    return cv2.resize(pixels, (width, height), interpolation=kernel)


def _panel(title: str, pixels: np.ndarray) -> np.ndarray:
    """A picture under its title."""
    height, width = pixels.shape[:2]
    panel = np.full((height + _TITLE, width, 3), _PAPER, np.uint8)
    panel[_TITLE:] = pixels
    cv2.putText(panel, title, (2, _TITLE - 11), _FONT, 0.62, _INK, 1, cv2.LINE_AA)
    return panel


def _numbers(result: Rectification, height: int) -> np.ndarray:
    """The numbers as a panel of their own."""
    lines = describe(result)
    scale = 0.55
    width = max(cv2.getTextSize(line, _FONT, scale, 1)[0][0] for line in lines) + 8
    panel = np.full((height + _TITLE, width, 3), _PAPER, np.uint8)
    cv2.putText(panel, "the lens", (2, _TITLE - 11), _FONT, 0.62, _INK, 1, cv2.LINE_AA)
    step = min(30, (height - 10) // len(lines))
    for number, line in enumerate(lines):
        at = (2, _TITLE + 20 + number * step)
        cv2.putText(panel, line, at, _FONT, scale, _INK, 1, cv2.LINE_AA)
    return panel

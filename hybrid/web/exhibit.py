"""One uploaded picture with its lens, and the pictures of it that the page shows."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from classical.camera import KannalaBrandt, Pinhole
from classical.warp import pinhole_target, remap, undistort_maps
from hybrid.arrays import to_rgb8
from hybrid.images import Picture
from hybrid.overlay import draw_curves
from hybrid.result import Calibration

PREVIEW_SIDE = 1280  # pixels; what a screen shows
_HEAT_SHARE = 0.75  # of the heatmap's colours where it is sure
_JPEG_QUALITY = 88


@dataclass(frozen=True)
class View:
    """What the straight picture shows.

    Attributes:
        fov: Horizontal field of view in degrees, or None.
        balance: 0 to 1, or None; at most one of the two is given.
    """

    fov: float | None = None
    balance: float | None = None

    def target(self, camera: KannalaBrandt) -> Pinhole:
        """The pinhole camera of the view, at the size of the camera's picture."""
        return pinhole_target(camera, fov=self.fov, balance=self.balance)


@dataclass(frozen=True, eq=False)
class Exhibit:
    """A picture and what was found out about it.

    Attributes:
        picture: As it was uploaded, upright.
        found: Its lens, or None before it was looked for.
    """

    picture: Picture
    found: Calibration | None = None

    @property
    def width(self) -> int:
        """Pixels."""
        return self.picture.pixels.shape[1]

    @property
    def height(self) -> int:
        """Pixels."""
        return self.picture.pixels.shape[0]

    @property
    def camera(self) -> KannalaBrandt | None:
        """The lens, if it was found."""
        return None if self.found is None else self.found.camera

    @property
    def heatmap(self) -> Float[np.ndarray, "_ _"] | None:
        """Where the network sees lines, 0 to 1, of any size; None where no network looked."""
        heatmaps = () if self.found is None else self.found.heatmaps
        return heatmaps[0] if heatmaps else None

    @cached_property
    def preview(self) -> UInt8[np.ndarray, "h w 3"]:
        """The picture in RGB of 8 bits, no side longer than `PREVIEW_SIDE`."""
        pixels = to_rgb8(self.picture.pixels)
        factor = PREVIEW_SIDE / max(self.width, self.height)
        if factor >= 1:
            return pixels
        size = (max(1, round(self.width * factor)), max(1, round(self.height * factor)))
        return cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)

    @cached_property
    def before(self) -> bytes:
        """The preview as JPEG."""
        return jpeg(self.preview)

    @cached_property
    def curves(self) -> bytes:
        """The picture with the curves coloured by their residual, at screen size, as JPEG."""
        found = () if self.found is None else self.found.curves[0]
        canvas = self.preview
        factor = PREVIEW_SIDE / max(canvas.shape[:2])
        if factor > 1:  # so that the lines are drawn fine over a small picture, too
            canvas = cv2.resize(canvas, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
        scale = np.array(canvas.shape[1::-1]) / (self.width, self.height)
        shown = [replace(curve, points=(curve.points + 0.5) * scale - 0.5) for curve in found]
        return jpeg(draw_curves(canvas, shown))

    @cached_property
    def lines(self) -> bytes | None:
        """The preview under the heatmap, as JPEG; None without a heatmap."""
        if self.heatmap is None:
            return None
        height, width = self.preview.shape[:2]
        heat = cv2.resize(self.heatmap.astype(np.float32), (width, height))
        heat = np.clip(heat, 0, 1)[..., None]
        levels = np.rint(heat * 255).astype(np.uint8)
        colours = cv2.applyColorMap(levels, cv2.COLORMAP_INFERNO)[..., ::-1]
        share = _HEAT_SHARE * np.sqrt(heat)
        dark = self.preview * 0.55
        return jpeg(np.rint(dark * (1 - share) + colours * share).astype(np.uint8))

    def straight(self, view: View) -> tuple[bytes, Pinhole | None]:
        """The preview made straight, as JPEG, and its pinhole camera.

        Without a lens it is the preview as it is, and there is no camera.

        Raises:
            ValueError: If the lens cannot be shown so.
        """
        if self.camera is None:
            return self.before, None
        height, width = self.preview.shape[:2]
        camera = self.camera.resized(width, height)
        target = view.target(camera)
        return jpeg(remap(self.preview, undistort_maps(camera, target))), target

    def straight_picture(self, view: View) -> Picture:
        """The picture made straight at full size and depth, with its profile and EXIF.

        Raises:
            ValueError: If there is no lens, or it cannot be shown so.
        """
        if self.camera is None:
            raise ValueError("Expected a picture with a lens, got one without.")
        maps = undistort_maps(self.camera, view.target(self.camera))
        return replace(self.picture, pixels=remap(self.picture.pixels, maps))


def jpeg(pixels: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """An RGB picture as the bytes of a JPEG file."""
    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    return cv2.imencode(".jpg", np.ascontiguousarray(pixels[..., ::-1]), options)[1].tobytes()


def degrees_across(target: Pinhole) -> float:
    """Horizontal field of view of a straight picture, degrees."""
    return math.degrees(target.horizontal_fov)

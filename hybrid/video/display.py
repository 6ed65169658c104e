"""How the frames of a film are shown: films of phones are stored lying down, some are squeezed."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Shaped

from classical.warp import WarpMaps
from classical.warp.maps import OUTSIDE

_SQUARE = 1e-3  # relative difference of a pixel's sides that is none


@dataclass(frozen=True)
class Display:
    """From stored frames to upright ones with square pixels.

    Attributes:
        stored_width: Width of the stored frames, pixels.
        stored_height: Their height, pixels.
        quarter_turns: How often they are turned by 90° counter-clockwise to be shown.
        pixel_aspect: Width of a stored pixel for a height of one.
    """

    stored_width: int
    stored_height: int
    quarter_turns: int = 0
    pixel_aspect: float = 1.0

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the upright frames, pixels."""
        wide = self._square_size()
        return (wide[1], wide[0]) if self.quarter_turns % 2 else wide

    def upright(self, pixels: Shaped[np.ndarray, "..."]) -> Shaped[np.ndarray, "..."]:
        """A stored frame as it is shown, shape (height, width, channels)."""
        if self._square_size() != (self.stored_width, self.stored_height):
            pixels = cv2.resize(pixels, self._square_size(), interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(np.rot90(pixels, self.quarter_turns))

    def stored_maps(
        self, maps: WarpMaps, step: tuple[int, int], offset: tuple[float, float]
    ) -> WarpMaps:
        """Maps into upright frames as maps into a plane of stored ones.

        Args:
            maps: Where pixels lie in the upright frame.
            step: Columns and rows of the stored frame for one of the plane (2, 2 for the colour of
                4:2:0).
            offset: Where the plane's top-left sample lies in the stored frame, pixels.
        """
        width, height = self.size
        last_u, last_v = np.float32(width - 1), np.float32(height - 1)
        u, v = (  # np.rot90, taken back
            (maps.u, maps.v),
            (last_v - maps.v, maps.u),
            (last_u - maps.u, last_v - maps.v),
            (maps.v, last_u - maps.u),
        )[self.quarter_turns % 4]
        squeeze = np.float32(self.stored_width / self._square_size()[0])
        u = (u + np.float32(0.5)) * squeeze - np.float32(0.5)
        plane = tuple(
            -(-n // s) for n, s in zip((self.stored_width, self.stored_height), step, strict=True)
        )
        placed = []
        for values, first, by, count in zip((u, v), offset, step, plane, strict=True):
            inside = np.clip((values - np.float32(first)) / np.float32(by), 0, count - 1)
            placed.append(np.where(maps.valid, inside, np.float32(OUTSIDE)))
        return WarpMaps(placed[0], placed[1], maps.valid, *plane)

    def _square_size(self) -> tuple[int, int]:
        """Size of a stored frame stretched to square pixels."""
        if abs(self.pixel_aspect - 1) < _SQUARE:
            return self.stored_width, self.stored_height
        return round(self.stored_width * self.pixel_aspect), self.stored_height

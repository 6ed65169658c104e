"""The picture as the baselines want it: grey, in floating point, and of a size they can work at."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

GREY_WEIGHTS = (0.30, 0.59, 0.11)
"""Weights of red, green and blue in the grey picture (Alemán-Flores et al., IPOL 2014)."""


@dataclass(frozen=True)
class WorkingPicture:
    """A grey picture at the size at which edges are sought.

    Attributes:
        grey: Grey values 0 … 255, shape (h, w).
        scale: Working size / size of the picture given, the same across and down.
        width: Width of the picture given, pixels.
        height: Height of the picture given, pixels.
    """

    grey: Float[np.ndarray, "h w"]
    scale: float
    width: int
    height: int

    def to_picture(self, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Map working pixels to pixels of the picture given (pixel centres at whole numbers)."""
        return (points + 0.5) / self.scale - 0.5


def working_picture(
    image: UInt8[np.ndarray, "h w 3"] | UInt8[np.ndarray, "h w"],
    *,
    smallest: int | None,
    largest: int | None,
) -> WorkingPicture:
    """Turn a picture grey and bring its longer side between `smallest` and `largest` pixels.

    Args:
        image: Grey or RGB picture, uint8.
        smallest: A shorter longer side is enlarged to this (cubic); None leaves it.
        largest: A longer one is reduced to this (by area); None leaves it.

    Raises:
        ValueError: If `image` is not an 8-bit grey or RGB picture with both sides over 2 px.
    """
    _check(image)
    height, width = image.shape[:2]
    grey = image.astype(np.float32)
    if grey.ndim == 3:
        grey = grey @ np.array(GREY_WEIGHTS, np.float32)
    longer = max(width, height)
    target = max(longer, smallest or 0)
    target = min(target, largest or target)
    scale = target / longer
    if scale != 1.0:
        size = (max(round(width * scale), 3), max(round(height * scale), 3))
        grey = cv2.resize(
            grey, size, interpolation=cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
        )
    return WorkingPicture(np.asarray(grey), scale, width, height)


def _check(image: np.ndarray) -> None:
    rgb_or_grey = image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)
    if image.dtype != np.uint8 or not rgb_or_grey or min(image.shape[:2]) < 3:
        raise ValueError(
            f"Expected a uint8 picture of shape (h, w) or (h, w, 3) with sides over 2 px, "
            f"got {image.dtype} of shape {image.shape}."
        )

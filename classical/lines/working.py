"""The picture that lines are sought in: grey, and of a workable size."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8


def grey_picture(image: UInt8[np.ndarray, "h w *c"]) -> UInt8[np.ndarray, "h w"]:
    """A picture in grey.

    Args:
        image: Grey (h, w) or RGB (h, w, 3), uint8.

    Raises:
        ValueError: If it is none of these.
    """
    if image.dtype != np.uint8 or image.ndim not in (2, 3):
        raise ValueError(f"Expected uint8 (h, w) or (h, w, 3), got {image.dtype} {image.shape}.")
    if image.ndim == 2:
        return np.ascontiguousarray(image)
    if image.shape[2] != 3:
        raise ValueError(f"Expected 3 channels, got {image.shape[2]}.")
    return cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)


def working_picture(
    grey: UInt8[np.ndarray, "h w"], min_size: int, max_size: int
) -> tuple[Float[np.ndarray, "wh ww"], Float[np.ndarray, " 2"]]:
    """A float picture of a workable size, and its pixels per pixel of the input along u and v.

    Args:
        grey: The picture.
        min_size: Smaller ones are enlarged to this longest side, but at most twice.
        max_size: Larger ones are reduced to it.
    """
    longest = max(grey.shape)
    scale = min(max(min_size / longest, 1.0), 2.0)
    if longest > max_size:
        scale = max_size / longest
    height, width = grey.shape
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    if scale != 1.0:
        kind = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
        grey = cv2.resize(grey, size, interpolation=kind)
    return grey.astype(np.float32), np.array([size[0] / width, size[1] / height])

"""The pictures that `rectify` takes, checked once and shown to estimators as RGB of 8 bits."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Shaped, UInt8

_KINDS = "uint8, uint16, or float in [0, 1]"
_SHAPES = "(h, w), (h, w, 1), (h, w, 3) or (h, w, 4)"


def check_image(image: object) -> None:
    """Refuse what is no picture.

    Raises:
        TypeError: If it is no NumPy array.
        ValueError: If its shape, type or values are not those of a picture.
    """
    if not isinstance(image, np.ndarray):
        raise TypeError(f"Expected a NumPy array, got {type(image).__name__}.")
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (1, 3, 4)):
        raise ValueError(f"Expected an image of shape {_SHAPES}, got {image.shape}.")
    if image.size == 0:
        raise ValueError(f"Expected an image with pixels, got shape {image.shape}.")
    if image.dtype in (np.uint8, np.uint16):
        return
    if image.dtype not in (np.float16, np.float32, np.float64):
        raise ValueError(f"Expected an image of type {_KINDS}, got {image.dtype}.")
    if not np.isfinite(image).all():
        raise ValueError("Expected finite pixels, got a NaN or an infinity.")
    low, high = float(image.min()), float(image.max())
    if low < -1e-3 or high > 1 + 1e-3:
        raise ValueError(f"Expected float pixels in [0, 1], got {low:g} to {high:g}.")


def to_rgb8(image: Shaped[np.ndarray, "..."]) -> UInt8[np.ndarray, "h w 3"]:
    """The picture as RGB of 8 bits; alpha is dropped.

    Args:
        image: A picture that passed `check_image`.
    """
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    elif image.dtype != np.uint8:
        image = np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
    if image.ndim == 2 or image.shape[2] == 1:
        return cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_GRAY2RGB)
    return np.ascontiguousarray(image[..., :3])


def unit_range(pixels: Shaped[np.ndarray, "..."]) -> Shaped[np.ndarray, "..."]:
    """Float pixels of a file, which may have any range, as `check_image` wants them.

    Args:
        pixels: Of any type; float32 that exceeds [0, 1] is divided by its maximum and clipped.
    """
    if pixels.dtype != np.float32:
        return pixels
    return np.clip(pixels / max(1.0, float(pixels.max(initial=0.0))), 0, 1)

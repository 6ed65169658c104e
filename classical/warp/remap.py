"""Resampling of pictures of any usual type through a map."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Shaped

from classical.warp.maps import WarpMaps

_KERNELS = {
    "nearest": cv2.INTER_NEAREST,
    "linear": cv2.INTER_LINEAR,
    "cubic": cv2.INTER_CUBIC,
    "lanczos": cv2.INTER_LANCZOS4,
}
_MAX_CHANNELS = 4  # of cv2.remap with a constant border
_DTYPES = ("uint8", "uint16", "float16", "float32", "float64")


def remap(
    image: Shaped[np.ndarray, "..."],
    maps: WarpMaps,
    *,
    interpolation: str = "linear",
    antialias: bool = True,
) -> Shaped[np.ndarray, "..."]:
    """Make the new picture of a map; pixels without a source become 0.

    Args:
        image: The source, shape (height, width) or (height, width, channels), of type uint8,
            uint16, float16, float32 or float64; all floats are interpolated in float32.
        maps: Where each new pixel lies in the source.
        interpolation: "nearest", "linear", "cubic" or "lanczos".
        antialias: Smooth the source where it shrinks. Not done with "nearest", which is for labels.

    Returns:
        The new picture with the dtype and channels of the source.

    Raises:
        ValueError: If the shape, the dtype or an option is none of these.
    """
    kernel = _check(image, maps, interpolation)
    if image.dtype in (np.float16, np.float64):  # in float32 OpenCV places lookups exactly
        single = image.astype(np.float32)
        out = remap(single, maps, interpolation=interpolation, antialias=antialias)
        return out.astype(image.dtype)
    new_shape = maps.u.shape + image.shape[2:]
    if 0 in new_shape:
        return np.zeros(new_shape, image.dtype)
    u, v = maps.u, maps.v
    if antialias and interpolation != "nearest":
        sheet = maps.smoothing.sheet
        image = image if sheet is None else sheet.draw(image)
        u, v = maps.lookup
    channels = image.reshape(*image.shape[:2], -1)
    if channels.shape[2] <= _MAX_CHANNELS:
        return _sampled(image, u, v, kernel, maps).reshape(new_shape)
    planes = np.moveaxis(channels, 2, 0)
    sampled = [_sampled(np.ascontiguousarray(p), u, v, kernel, maps) for p in planes]
    return np.stack(sampled, axis=-1)


def _sampled(
    image: np.ndarray, u: np.ndarray, v: np.ndarray, kernel: int, maps: WarpMaps
) -> np.ndarray:
    """Look the pixels up; kernels wider than two pixels must not mix in the black outside."""
    if kernel in (cv2.INTER_NEAREST, cv2.INTER_LINEAR):
        return cv2.remap(image, u, v, kernel)
    sampled = cv2.remap(image, u, v, kernel, borderMode=cv2.BORDER_REPLICATE)
    sampled[~maps.valid] = 0
    return sampled


def _check(image: np.ndarray, maps: WarpMaps, interpolation: str) -> int:
    """Refuse what cannot be resampled; returns OpenCV's number of the kernel."""
    if interpolation not in _KERNELS:
        raise ValueError(f"Expected interpolation in {sorted(_KERNELS)}, got {interpolation!r}.")
    if image.ndim not in (2, 3):
        raise ValueError(f"Expected an image of 2 or 3 dimensions, got shape {image.shape}.")
    if image.dtype.name not in _DTYPES:
        raise ValueError(f"Expected an image of type {', '.join(_DTYPES)}, got {image.dtype}.")
    if image.shape[:2] != (maps.source_height, maps.source_width):
        raise ValueError(
            "Expected an image of the map's source size "
            f"{maps.source_width}x{maps.source_height}, got {image.shape[1]}x{image.shape[0]}."
        )
    return _KERNELS[interpolation]

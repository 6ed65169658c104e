"""Any picture into a square frame and the estimate back out of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Integer
from numpy import ndarray
from torch import Tensor
from torch.nn import functional

from classical.camera import KannalaBrandt


@dataclass(frozen=True)
class Letterbox:
    """Where a picture lies in a square frame: resized to fit, centred, black around.

    Attributes:
        width: Width of the picture in pixels.
        height: Height of the picture in pixels.
        size: Side of the frame in pixels.
    """

    width: int
    height: int
    size: int

    @property
    def inner(self) -> tuple[int, int]:
        """Width and height of the picture inside the frame."""
        scale = self.size / max(self.width, self.height)
        return max(1, round(self.width * scale)), max(1, round(self.height * scale))

    @property
    def corner(self) -> tuple[int, int]:
        """Frame pixel (x, y) of the picture's top-left pixel."""
        width, height = self.inner
        return (self.size - width) // 2, (self.size - height) // 2

    def fill(self, image: Float[Tensor, "1 c h w"]) -> Float[Tensor, "1 c s s"]:
        """The frame with the picture in it."""
        width, height = self.inner
        x, y = self.corner
        small = resized(image, height, width)
        pads = (x, self.size - width - x, y, self.size - height - y)
        return functional.pad(small, pads)

    def camera(self, k: Float[ndarray, " 9"]) -> KannalaBrandt:
        """The picture's camera from the frame's lens in half widths of the frame."""
        half = self.size / 2
        middle = (self.size - 1) / 2
        vector = np.concatenate([k[:5], k[5:7] * half, k[7:9] * half + middle])
        frame = KannalaBrandt.from_vector(vector.astype(np.float64), self.size, self.size)
        part = frame.cropped(*self.corner, *self.inner)
        return part.resized(self.width, self.height).normalized()

    def covariance(self, covariance: Float[ndarray, "9 9"]) -> Float[ndarray, "9 9"]:
        """Covariance of the picture's camera vector from that of the frame's lens.

        In the gauge m_u = 1 the way from one to the other is affine and diagonal. The gauge itself
        has no spread.
        """
        width, height = self.inner
        jacobian = np.empty(9)
        jacobian[:5] = self.size / width
        jacobian[5] = 0.0
        jacobian[6] = width / 2 * (self.height / height)
        jacobian[7] = self.size / 2 * (self.width / width)
        jacobian[8] = self.size / 2 * (self.height / height)
        return jacobian[:, None] * covariance * jacobian

    def content(self, frame: Float[ndarray, "s s"]) -> Float[ndarray, "h w"]:
        """The part of a map over the frame that the picture covers."""
        (width, height), (x, y) = self.inner, self.corner
        return frame[y : y + height, x : x + width]


def resized(image: Float[Tensor, "b c h w"], height: int, width: int) -> Tensor:
    """Resample; outer edges stay in place, and shrinking averages."""
    if image.shape[-2:] == (height, width):
        return image
    return functional.interpolate(
        image, size=(height, width), mode="bilinear", align_corners=False, antialias=True
    )


def as_tensor(image: Integer[ndarray, "h w *c"] | Float[ndarray, "h w *c"]) -> Tensor:
    """A picture as RGB in [0, 1]: grey is repeated, alpha dropped, integers scaled.

    Args:
        image: Grey, RGB or RGBA; unsigned integers of any depth, or floats in [0, 1].

    Returns:
        Shape (1, 3, h, w), float32.

    Raises:
        ValueError: If the shape is not that of a picture.
    """
    if image.ndim == 2:
        image = image[..., None]
    if image.ndim != 3 or image.shape[2] not in (1, 3, 4) or 0 in image.shape:
        raise ValueError(f"expected a picture (h, w), (h, w, 1), (h, w, 3 or 4), got {image.shape}")
    channels = np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image[..., :3]
    top = np.iinfo(image.dtype).max if np.issubdtype(image.dtype, np.integer) else 1.0
    values = channels / np.float32(top)
    if not np.issubdtype(image.dtype, np.unsignedinteger):
        values = values.clip(0.0, 1.0)
    values = np.ascontiguousarray(values.transpose(2, 0, 1), dtype=np.float32)
    return torch.from_numpy(values)[None]

"""Pictures in the frame of the comparison: 320 px wide, a pinhole of f = 160 px at its centre."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray

from eval.metrics import FRAME_FOCAL, FRAME_WIDTH, Lens, align

Maps = tuple[Float32[ndarray, "h2 w2"], Float32[ndarray, "h2 w2"]]

OUTSIDE = -32.0
"""Coordinate of a pixel without a source; it resamples to black."""


@dataclass(frozen=True)
class Similarity:
    """x ↦ scale · rotation x + shift in the plane of the frame, relative to its centre, pixels."""

    scale: float = 1.0
    rotation: Float[ndarray, "2 2"] | None = None
    shift: Float[ndarray, " 2"] | None = None

    def inverse(self, points: Float[ndarray, "n 2"]) -> Float[ndarray, "n 2"]:
        """Undo the similarity; a scale of 0 sends everything to infinity."""
        moved = points if self.shift is None else points - self.shift
        turned = moved if self.rotation is None else moved @ self.rotation
        return turned / (self.scale if self.scale > 0.0 else 1e-12)


@dataclass(frozen=True)
class Resampled:
    """A lens seen through a resampled photograph, whose outer edges stay in place.

    Attributes:
        lens: The lens of the photograph.
        scale: New size over old size along u and v, shape (2,).
    """

    lens: Lens
    scale: Float[ndarray, " 2"]

    def project(
        self, rays: Float[ndarray, "n 3"]
    ) -> tuple[Float[ndarray, "n 2"], Bool[ndarray, " n"]]:
        """Map rays to pixels of the resampled photograph."""
        points, valid = self.lens.project(rays)
        return (points + 0.5) * self.scale - 0.5, valid

    def unproject(
        self, points: Float[ndarray, "n 2"]
    ) -> tuple[Float[ndarray, "n 3"], Bool[ndarray, " n"]]:
        """Map pixels of the resampled photograph to rays."""
        return self.lens.unproject((points + 0.5) / self.scale - 0.5)


def frame_size(width: int, height: int) -> tuple[int, int]:
    """Size (width, height) of the frame for a photograph: 320 px wide, of the same shape."""
    return FRAME_WIDTH, max(1, round(FRAME_WIDTH * height / width))


def to_frame_size(photo: UInt8[ndarray, "h w *c"]) -> UInt8[ndarray, "h2 w2 *c"]:
    """Shrink a photograph to the size of the frame by the mean over areas; smaller ones grow."""
    size = frame_size(photo.shape[1], photo.shape[0])
    if size == (photo.shape[1], photo.shape[0]):
        return photo
    shrink = size[0] < photo.shape[1]
    return cv2.resize(photo, size, interpolation=cv2.INTER_AREA if shrink else cv2.INTER_LINEAR)


def best_similarity(place: Float[ndarray, "n 2"], target: Float[ndarray, "n 2"]) -> Similarity:
    """The similarity of the aligned protocol; places of the same pixels in the frame."""
    return Similarity(*align(place, target))


def source_maps(
    lens: Lens | None, width: int, height: int, *, similarity: Similarity | None = None
) -> tuple[Float32[ndarray, "h w"], Float32[ndarray, "h w"]]:
    """For each pixel of the frame, where it lies in the photograph, as `cv2.remap` takes it.

    Args:
        lens: Camera of the photograph; `None` leaves it alone.
        width: Width of the photograph in pixels.
        height: Height of the photograph in pixels.
        similarity: Moves the rectified picture within the frame (the aligned protocol).

    Returns:
        Columns and rows in the photograph; `OUTSIDE` where it has nothing to show.
    """
    columns, rows = frame_size(width, height)
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    place = (similarity or Similarity()).inverse(grid - [(columns - 1) / 2, (rows - 1) / 2])
    if lens is None:
        points = place * (width / FRAME_WIDTH) + [(width - 1) / 2, (height - 1) / 2]
        seen = np.ones(len(points), dtype=bool)
    else:
        rays = np.column_stack([place, np.full(len(place), FRAME_FOCAL)])
        points, seen = lens.project(rays / np.linalg.norm(rays, axis=1, keepdims=True))
    inside = (points >= -0.5) & (points <= [width - 0.5, height - 0.5])
    points = np.where((seen & inside.all(axis=1))[:, None], points, OUTSIDE).astype(np.float32)
    maps = points.reshape(rows, columns, 2)
    return np.ascontiguousarray(maps[..., 0]), np.ascontiguousarray(maps[..., 1])


def rectify_picture(
    photo: UInt8[ndarray, "h w *c"],
    lens: Lens | None,
    *,
    similarity: Similarity | None = None,
) -> UInt8[ndarray, "h2 w2 *c"]:
    """Rectify a photograph into the frame, bilinearly; what it does not show is black."""
    maps = source_maps(lens, photo.shape[1], photo.shape[0], similarity=similarity)
    return resample_picture(photo, maps)


def rectify_labels(
    labels: UInt8[ndarray, "h w"], lens: Lens | None, *, similarity: Similarity | None = None
) -> UInt8[ndarray, "h2 w2"]:
    """Rectify a map of labels (line lengths) into the frame: nearest pixel, nothing is mixed."""
    maps = source_maps(lens, labels.shape[1], labels.shape[0], similarity=similarity)
    return resample_labels(labels, maps)


def resample_picture(photo: UInt8[ndarray, "h w *c"], maps: Maps) -> UInt8[ndarray, "h2 w2 *c"]:
    """Take a picture through maps, bilinearly."""
    return cv2.remap(photo, *maps, cv2.INTER_LINEAR)


def resample_labels(labels: UInt8[ndarray, "h w"], maps: Maps) -> UInt8[ndarray, "h2 w2"]:
    """Take labels through maps, by the nearest pixel."""
    return cv2.remap(labels, *maps, cv2.INTER_NEAREST)

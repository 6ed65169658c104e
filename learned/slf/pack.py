"""Photographs to a pack: decode, annotate, shrink, store. Needs OpenCV; done once."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray

from learned.slf.atlas import LEVELS, PHOTOGRAPH, Atlas
from learned.slf.segments import annotate
from learned.slf.wireframes import Photograph, wireframe_segments

PICTURE_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp")


@dataclass(frozen=True)
class Annotated:
    """One picture of a pack.

    Attributes:
        image: RGB bytes.
        segments: (u1, v1, u2, v2) in pixels.
        kind: One of the kinds of `learned.slf.atlas`.
    """

    image: UInt8[ndarray, "h w 3"]
    segments: Float[ndarray, "n 4"]
    kind: int = PHOTOGRAPH


def picture_paths(folder: Path) -> list[Path]:
    """Every picture file below a folder, in the order of their names.

    Raises:
        ValueError: If there is none.
    """
    found = sorted(p for p in folder.rglob("*") if p.suffix.lower() in PICTURE_SUFFIXES)
    if not found:
        raise ValueError(f"expected a folder with pictures, got none in {folder}")
    return found


def read_rgb(path: Path) -> UInt8[ndarray, "h w 3"]:
    """Decode a picture as 8-bit RGB.

    Raises:
        ValueError: If the file cannot be decoded.
    """
    import cv2

    bgr = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if bgr is None:
        raise ValueError(f"expected a picture, got an unreadable file: {path}")
    return np.ascontiguousarray(bgr[..., ::-1])


def annotated_photograph(photograph: Photograph, *, longest: int = 640) -> Annotated:
    """Read a photograph, shrink it to at most `longest` pixels a side, and read or find its lines.

    Raises:
        ValueError: If the picture or its annotation cannot be read.
    """
    full = read_rgb(photograph.path)
    image = shrunk(full, longest)
    if photograph.annotation is None:
        return Annotated(image, annotate(image))
    scale = np.tile([image.shape[i] / full.shape[i] for i in (1, 0)], 2)
    segments = (wireframe_segments(photograph) + 0.5) * scale - 0.5
    return Annotated(image, segments.astype(np.float32))


def shrunk(image: UInt8[ndarray, "h w 3"], longest: int) -> UInt8[ndarray, "h2 w2 3"]:
    """Scale a picture down, by area, until its longer side is at most `longest` pixels."""
    import cv2

    height, width = image.shape[:2]
    scale = longest / max(height, width)
    if scale >= 1.0:
        return image
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def annotated_photographs(
    photographs: Iterable[Photograph],
    *,
    workers: int = 2,
    progress: Callable[[], object] | None = None,
) -> Iterator[Annotated]:
    """Annotate photographs side by side, in the order given."""
    with ThreadPoolExecutor(workers) as pool:
        for item in pool.map(annotated_photograph, photographs):
            if progress is not None:
                progress()
            yield item


def build_atlas(pictures: Iterable[Annotated]) -> Atlas:
    """Lay pictures, their mip levels and their segments out in one pack."""
    words: list[ndarray] = []
    base, extent, segments, first, kind = [], [], [], [0], []
    position = 0
    for picture in pictures:
        levels = _mip_levels(picture.image)
        for level in levels:
            words.append(_packed(level))
            base.append(position)
            extent.append((level.shape[1], level.shape[0]))
            position += level.shape[0] * level.shape[1]
        segments.append(picture.segments.astype(np.float32).reshape(-1, 4))
        first.append(first[-1] + len(picture.segments))
        kind.append(picture.kind)
    if not kind:
        raise ValueError("expected at least one picture, got none")
    return Atlas(
        texels=torch.from_numpy(np.concatenate(words)),
        base=torch.tensor(base, dtype=torch.int64).view(-1, LEVELS),
        extent=torch.tensor(extent, dtype=torch.int64).view(-1, LEVELS, 2),
        segments=torch.from_numpy(np.concatenate(segments)),
        first=torch.tensor(first, dtype=torch.int64),
        kind=torch.tensor(kind, dtype=torch.int64),
    )


def _mip_levels(image: ndarray) -> list[ndarray]:
    import cv2

    levels = [image]
    for _ in range(LEVELS - 1):
        height, width = levels[-1].shape[:2]
        size = (max(1, width // 2), max(1, height // 2))
        levels.append(cv2.resize(levels[-1], size, interpolation=cv2.INTER_AREA))
    return levels


def _packed(image: ndarray) -> ndarray:
    rgba = np.empty((*image.shape[:2], 4), np.uint8)
    rgba[..., :3], rgba[..., 3] = image, 255
    return rgba.reshape(-1).view("<i4")

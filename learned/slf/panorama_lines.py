"""Straight lines of equirectangular panoramas: found on perspective cuts, joined on the sphere."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from learned.slf.atlas import PANORAMA
from learned.slf.pack import Annotated, read_rgb
from learned.slf.segments import AnnotationCfg, annotate

CUT_HALF_FIELD = np.radians(40.0)
_YAW_STEPS = 8
_PITCHES = np.radians([-58.0, -20.0, 20.0, 58.0])
_JOIN_OFFSET = np.radians(0.35)
_JOIN_GAP = np.radians(3.0)
_LONGEST_ARC = np.radians(150.0)
_ROUNDS = 3


def annotated_panorama(path: Path, *, width: int = 2048, kind: int = PANORAMA) -> Annotated:
    """Read a panorama, at most `width` pixels wide, and find its straight lines.

    Raises:
        ValueError: If the picture is not twice as wide as high.
    """
    import cv2

    image = read_rgb(path)
    if abs(image.shape[1] - 2 * image.shape[0]) > 2:
        expected = "expected an equirectangular panorama, twice as wide as high"
        raise ValueError(f"{expected}, got {image.shape[1]}x{image.shape[0]} in {path}")
    if image.shape[1] > width:
        image = cv2.resize(image, (width, width // 2), interpolation=cv2.INTER_AREA)
    return Annotated(image, panorama_segments(image), kind)


def panorama_segments(image: UInt8[ndarray, "h w 3"]) -> Float[ndarray, "n 4"]:
    """Ends (u1, v1, u2, v2) of great-circle arcs in pixels of the panorama, longest first."""
    arcs = np.concatenate([_cut_arcs(image, rotation) for rotation in _cut_rotations()])
    for _ in range(_ROUNDS):
        arcs = _joined(arcs)
    order = np.argsort(-_angles(arcs), kind="stable")
    return _to_pixels(arcs[order], image.shape[1], image.shape[0]).astype(np.float32)


def _cut_rotations() -> list[ndarray]:
    """Turns from cut to world that cover the sphere."""
    out = []
    for pitch in _PITCHES:
        for yaw in np.arange(_YAW_STEPS) * (2 * np.pi / _YAW_STEPS):
            c, s = np.cos(yaw), np.sin(yaw)
            p, q = np.cos(pitch), np.sin(pitch)
            out.append(
                np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ [[1, 0, 0], [0, p, q], [0, -q, p]]
            )
    return out


def _cut_arcs(image: ndarray, rotation: ndarray) -> ndarray:
    """Unit end points (n, 2, 3) of the segments on one perspective cut."""
    import cv2

    # as many pixels per radian in the middle as the panorama has, doubled for the detector
    focal = 2.0 * image.shape[1] / (2 * np.pi)
    size = int(2 * focal * np.tan(CUT_HALF_FIELD))
    grid = (np.arange(size) - (size - 1) / 2) / focal
    rays = np.stack([*np.meshgrid(grid, grid), np.ones((size, size))], -1) @ rotation.T
    u, v = _equirectangular(rays, image.shape[1], image.shape[0])
    wrapped = np.concatenate([image, image[:, :8]], axis=1)
    u = np.mod(u, image.shape[1]).astype(np.float32)
    cut = cv2.remap(
        wrapped, u, v.astype(np.float32), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    config = AnnotationCfg(min_length=0.06, min_fragment=0.03, max_offset_px=2.0, min_contrast=6.0)
    ends = annotate(cut, config).astype(float).reshape(-1, 2, 2)
    plane = (ends - (size - 1) / 2) / focal
    world = np.concatenate([plane, np.ones((len(ends), 2, 1))], axis=2) @ rotation.T
    return world / np.linalg.norm(world, axis=2, keepdims=True)


def _joined(arcs: ndarray) -> ndarray:
    """Join pieces of one great circle, the longest first."""
    arcs = arcs[np.argsort(-_angles(arcs), kind="stable")]
    normals = np.cross(arcs[:, 0], arcs[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    used = np.zeros(len(arcs), bool)
    out = []
    for i, (start, end) in enumerate(arcs):
        if used[i]:
            continue
        middle = (start + end) / np.linalg.norm(start + end)
        along = np.cross(normals[i], middle)
        off = np.abs(arcs @ normals[i]).max(axis=1)
        s = np.arctan2(arcs @ along, arcs @ middle)
        half = np.arctan2(end @ along, end @ middle)
        gap = np.maximum(s.min(axis=1) - half, -half - s.max(axis=1))
        near = (off < np.sin(_JOIN_OFFSET)) & (gap < _JOIN_GAP) & (normals @ normals[i] > 0.9)
        near &= ~used & (np.abs(s).max(axis=1) < np.pi / 2)
        near[i] = True
        used |= near
        low, high = s[near].min(), s[near].max()
        low, high = max(low, high - _LONGEST_ARC), min(high, low + _LONGEST_ARC)
        out.append([np.cos(t) * middle + np.sin(t) * along for t in (low, high)])
    return np.array(out).reshape(-1, 2, 3)


def _angles(arcs: ndarray) -> ndarray:
    return np.arccos(np.clip((arcs[:, 0] * arcs[:, 1]).sum(-1), -1, 1))


def _equirectangular(rays: ndarray, width: int, height: int) -> tuple[ndarray, ndarray]:
    """Pixels of world directions."""
    unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    u = (np.arctan2(unit[..., 0], unit[..., 2]) / (2 * np.pi) + 0.5) * width - 0.5
    v = (np.arcsin(np.clip(unit[..., 1], -1, 1)) / np.pi + 0.5) * height - 0.5
    return u, v


def _to_pixels(arcs: ndarray, width: int, height: int) -> ndarray:
    u, v = _equirectangular(arcs, width, height)
    return np.stack([u, v], axis=2).reshape(-1, 4)

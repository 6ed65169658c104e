"""Straight segments on undistorted photographs: the annotation that D-Wireframe is bent from.

A photograph without lens distortion shows straight edges as straight lines, so a line segment
detector is accurate there. Detections are joined where an edge was broken, and only long ones with
a steady gradient along them are kept. OpenCV is imported when a photograph is annotated, never
before.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

_SUPPORT_SAMPLES = 24
_MERGE_ROUNDS = 3


@dataclass(frozen=True)
class AnnotationCfg:
    """Thresholds of the annotation; lengths are shares of the picture's short side.

    Attributes:
        min_length: Shortest segment kept.
        min_fragment: Shortest detection that takes part in joining.
        max_gap: Largest gap bridged along a line, as a share of the short side.
        max_offset_px: Largest distance across between two pieces that are joined, in pixels.
        max_angle_deg: Largest difference of direction between two pieces that are joined.
        min_contrast: Least median grey-level step across the segment, in levels of 255.
        min_support: Least share of samples along the segment that show half that step.
        limit: Most segments kept a photograph, the longest first.
    """

    min_length: float = 0.075
    min_fragment: float = 0.03
    max_gap: float = 0.05
    max_offset_px: float = 1.3
    max_angle_deg: float = 2.0
    min_contrast: float = 7.0
    min_support: float = 0.7
    limit: int = 120


def annotate(
    image: UInt8[ndarray, "h w 3"], config: AnnotationCfg | None = None
) -> Float[ndarray, "n 4"]:
    """Find long straight edges of an undistorted photograph.

    Args:
        image: RGB photograph.
        config: Thresholds.

    Returns:
        Segments (u1, v1, u2, v2) in pixels, longest first, shape (n, 4), float32.
    """
    import cv2

    config = config or AnnotationCfg()
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    found = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(grey)[0]
    if found is None:
        return np.zeros((0, 4), np.float32)
    side = min(image.shape[:2])
    segments = found.reshape(-1, 4).astype(np.float64)
    segments = segments[_lengths(segments) >= config.min_fragment * side]
    for _ in range(_MERGE_ROUNDS):
        segments = _merged(segments, side, config)
    segments = segments[_lengths(segments) >= config.min_length * side]
    smooth = cv2.GaussianBlur(grey, (0, 0), 0.8).astype(np.float32)
    segments = segments[_is_supported(segments, smooth, config)]
    order = np.argsort(-_lengths(segments), kind="stable")[: config.limit]
    return segments[order].astype(np.float32)


def _lengths(segments: ndarray) -> ndarray:
    return np.hypot(segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1])


def _merged(segments: ndarray, side: int, config: AnnotationCfg) -> ndarray:
    """Join pieces of one line, the longest first; each piece is used once."""
    segments = segments[np.argsort(-_lengths(segments), kind="stable")]
    used = np.zeros(len(segments), bool)
    out = []
    for i, segment in enumerate(segments):
        if used[i]:
            continue
        joined = ~used & _continues(segment, segments, side, config)
        joined[i] = True
        used |= joined
        out.append(_span(segments[joined], segment))
    return np.array(out).reshape(-1, 4)


def _continues(segment: ndarray, others: ndarray, side: int, config: AnnotationCfg) -> ndarray:
    """Which of `others` lie on the line of `segment`, within the gap."""
    start, step = segment[:2], segment[2:] - segment[:2]
    length = np.hypot(*step)
    along, across = step / length, np.array([-step[1], step[0]]) / length
    ends = others.reshape(-1, 2, 2) - start
    distance = np.abs(ends @ across).max(axis=1)
    s = ends @ along
    gap = np.maximum(s.min(axis=1) - length, -s.max(axis=1))
    direction = (others[:, 2:] - others[:, :2]) / _lengths(others)[:, None]
    # LSD orders the end points by the side that is dark, so a sign change is another edge
    turned = direction @ along < np.cos(np.radians(config.max_angle_deg))
    return (distance <= config.max_offset_px) & (gap <= config.max_gap * side) & ~turned


def _span(pieces: ndarray, longest: ndarray) -> ndarray:
    """The segment through several pieces: least squares line, weighted by length."""
    if len(pieces) == 1:
        return pieces[0]
    points = pieces.reshape(-1, 2)
    weights = np.repeat(_lengths(pieces), 2)
    centre = np.average(points, axis=0, weights=weights)
    spread = (points - centre) * weights[:, None]
    along = np.linalg.svd(spread.T @ (points - centre))[0][:, 0]
    along *= np.sign(along @ (longest[2:] - longest[:2]))
    s = (points - centre) @ along
    return np.concatenate([centre + s.min() * along, centre + s.max() * along])


def _is_supported(segments: ndarray, grey: ndarray, config: AnnotationCfg) -> ndarray:
    """True where a grey-level step of one sign runs along the whole segment."""
    import cv2

    if len(segments) == 0:
        return np.zeros(0, bool)
    t = (np.arange(_SUPPORT_SAMPLES) + 0.5) / _SUPPORT_SAMPLES
    start, step = segments[:, None, :2], segments[:, None, 2:] - segments[:, None, :2]
    points = start + t[None, :, None] * step
    across = np.stack([-step[..., 1], step[..., 0]], -1) / _lengths(segments)[:, None, None]

    def sample(offset: float) -> ndarray:
        at = (points + offset * across).astype(np.float32)
        return cv2.remap(
            grey, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )

    contrast = sample(1.6) - sample(-1.6)
    middle = np.median(contrast, axis=1)
    steady = (contrast * np.sign(middle)[:, None] >= 0.5 * config.min_contrast).mean(axis=1)
    return (np.abs(middle) >= config.min_contrast) & (steady >= config.min_support)

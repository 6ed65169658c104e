"""The one thing that straight lines leave open: the scale of the rectified plane, and who fixes it.

(tan θ)' = s tan θ maps straight lines to straight lines, so a fit knows its lens up to s. All here
happens along that one direction, ∂camera/∂log s.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from classical.camera import KannalaBrandt
from classical.fit.observations import Observation
from classical.fit.prior import FREE, LOG_STRENGTH_DEVIATION
from classical.fit.quality import rectified_grid
from classical.fit.rounds import Known, Settled
from classical.fit.samples import CurveSamples
from classical.fit.straightness import straightness
from classical.fit.vanishing import (
    ScaleEstimate,
    VanishingConfig,
    rescaled,
    scale_from_directions,
)
from classical.lines.curve import REFERENCE_WIDTH

_M_U = 5  # of (k1..k5, m_u, m_v, u0, v0)
_STEP = 0.02
_HELD_DEVIATION = 0.01  # of log s
_END_DEVIATION = 0.2  # of the ends of a line across it, pixels of a picture 1280 wide


class FusedScale(NamedTuple):
    """A camera with its scale corrected, its covariance, and the weight of the correction."""

    camera: KannalaBrandt
    covariance: Float[np.ndarray, "9 9"]
    gain: float


def scale_tangent(camera: KannalaBrandt) -> Float[np.ndarray, " 9"]:
    """∂camera/∂log s of (tan θ)' = s tan θ, by central differences."""
    ahead, behind = (rescaled(camera, float(np.exp(sign * _STEP))) for sign in (1, -1))
    return (ahead.to_vector() - behind.to_vector()) / (2 * _STEP)


def scale_source(settled: Settled, known: Known) -> str:
    """What told the most about the scale of a fit, before vanishing points are asked."""
    tangent = scale_tangent(settled.camera)
    best, most = "prior", LOG_STRENGTH_DEVIATION**-2
    for observation in known.every:
        told = observation.near(settled.camera).precision_along(tangent)
        if told > most:
            best, most = observation.source, told
    return best


def scale_row(camera: KannalaBrandt) -> Float[np.ndarray, " 9"]:
    """∂(the relative size of the rectified picture)/∂camera; 1 along `scale_tangent`.

    The tangent is where the lens moves if only its scale does. This is how far the scale moves
    with any change of the lens, in those parts of its shape, too, that no curve tells.
    """
    positions, by_camera = rectified_grid(camera)
    outward = positions - positions.mean(axis=0)
    row = np.einsum("nd,ndj->j", outward, by_camera) / (outward**2).sum()
    row[_M_U] = 0.0
    return row


def scale_variance(camera: KannalaBrandt, covariance: Float[np.ndarray, "9 9"]) -> float:
    """Variance of log s, whatever else of the lens moves with it."""
    row = scale_row(camera)
    return float(row @ covariance @ row)


def held_scale(camera: KannalaBrandt) -> Observation:
    """The size of a camera's rectified picture, to hold a further fit to that cannot tell it."""
    row = scale_row(camera)[None]
    value = row @ camera.normalized().to_vector()
    return Observation("the scale so far", row, value, np.array([[_HELD_DEVIATION**2]]))


def vanishing_scale(
    camera: KannalaBrandt, samples: CurveSamples, tolerance: float, config: VanishingConfig
) -> ScaleEstimate | None:
    """Let the longest straight curves of one picture vote for the scale.

    Args:
        camera: The lens so far.
        samples: Points of the picture's curves.
        tolerance: RMS residual up to which a curve is straight, pixels.
        config: How to search.
    """
    scale = camera.width / REFERENCE_WIDTH
    few = samples.coarse(curves=config.most_lines, most=12)
    result = straightness(camera, few)
    good = few.curve_rms(result.residuals) <= tolerance
    lengths = few.lengths[good]
    # a line of length L and noise σ turns by about 2 √3 σ / L, and by as much more as L subtends
    deviations = 2 * np.sqrt(3) * _END_DEVIATION * scale / np.maximum(lengths, 1.0)
    return scale_from_directions(
        result.normals[good],
        lengths / camera.width,
        deviations,
        rng=np.random.default_rng(config.seed),
        config=config,
    )


def fused_scale(
    camera: KannalaBrandt,
    covariance: Float[np.ndarray, "9 9"],
    estimates: Sequence[ScaleEstimate],
) -> FusedScale | None:
    """The scale corrected by the estimates of several pictures; None without any.

    They count against what the fit says of its scale with all else held, which is surer than it
    should be, for an estimate may be wrong altogether: its scene has no orthogonal directions. How
    sure the result is follows from the fit's whole covariance and this gain.
    """
    if not estimates:
        return None
    precisions = np.array([estimate.deviation**-2 for estimate in estimates])
    scales = np.array([estimate.log_scale for estimate in estimates])
    tangent = scale_tangent(camera)
    free = covariance[np.ix_(FREE, FREE)]
    held = float(1 / (tangent[FREE] @ np.linalg.solve(free, tangent[FREE])))
    variance = float(1 / precisions.sum())
    gain = held / (held + variance)
    kept = np.eye(9) - gain * np.outer(tangent, scale_row(camera))
    log_scale = float(precisions @ scales / precisions.sum())
    return FusedScale(
        rescaled(camera, float(np.exp(gain * log_scale))),
        kept @ covariance @ kept.T + gain**2 * variance * np.outer(tangent, tangent),
        gain,
    )

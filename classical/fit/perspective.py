"""Is the picture straight already? A lens must earn its bend against a perspective one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from classical.camera import KannalaBrandt
from classical.fit.rounds import REFERENCE_WIDTH, Known
from classical.fit.samples import CurveSamples
from classical.fit.search import projection
from classical.fit.straightness import straightness

_FISHEYE = 0.9  # of an equidistant lens to compare with: 127° across
_SIGMA_RANGE = (0.2, 1.0)  # standard deviation of a sample, pixels of a picture 1280 wide
_STRENGTH = 2.0  # focal length in half widths, 53° across: straight lines do not tell it


@dataclass(frozen=True)
class PerspectiveConfig:
    """When a perspective lens is believed instead of a bent one.

    Attributes:
        least_gain: A bent lens must lower the robust cost of the curves by this much …
        doubtful_gain: … and by this much where a perspective lens leaves nearly all straight.
        nearly_all: Share of the curves' length that counts as nearly all.
        least_evidence: A common fisheye must raise the cost by this much, or the curves cannot
            tell straight from bent.
        redundancy: So many samples tell as much as one independent one.
    """

    least_gain: float = 0.5
    doubtful_gain: float = 4.0
    nearly_all: float = 0.95
    least_evidence: float = 4.0
    redundancy: float = 64.0


class Perspective(NamedTuple):
    """A perspective lens, and whether the curves speak for it or only not against it."""

    camera: KannalaBrandt
    proven: bool


def perspective_instead(
    camera: KannalaBrandt,
    samples: CurveSamples,
    known: Known,
    *,
    tolerance: float,
    config: PerspectiveConfig,
) -> Perspective | None:
    """A perspective lens if it makes the curves about as straight as the fitted one.

    Args:
        camera: The fitted lens.
        samples: Points of the curves.
        known: What is known beside them; a lens must earn its bend against that too.
        tolerance: RMS residual up to which a curve is straight, pixels.
        config: How much gain a bend must bring.

    Returns:
        r = f tan θ, as near as five coefficients come, or None where the bend is real.
    """
    width, height = camera.width, camera.height
    straight = projection(_STRENGTH, -1.0, width, height)
    flat = straightness(straight, samples).residuals
    kept = straightness(camera, samples).residuals
    sigma = _noise(samples, kept, width / REFERENCE_WIDTH)
    common = straightness(projection(_FISHEYE, 0.0, width, height), samples).residuals
    cost, bent, fisheye = (
        _robust(residuals / sigma) / config.redundancy for residuals in (flat, kept, common)
    )
    cost += 0.5 * known.surprise(straight)
    bent += 0.5 * known.surprise(camera)
    lengths = samples.lengths
    share = float(lengths[samples.curve_rms(flat) <= tolerance].sum() / lengths.sum())
    doubtful = cost - bent < config.doubtful_gain and share >= config.nearly_all
    if cost - bent >= config.least_gain and not doubtful:
        return None
    return Perspective(straight, fisheye - cost >= config.least_evidence)


def _noise(samples: CurveSamples, residuals: np.ndarray, scale: float) -> float:
    """Length-weighted median of the curves' RMS residuals, within bounds, pixels."""
    rms = samples.curve_rms(residuals)
    order = np.argsort(rms, kind="stable")
    length = np.cumsum(samples.lengths[order])
    middle = rms[order][np.searchsorted(length, 0.5 * length[-1])]
    return float(np.clip(middle, *(scale * np.array(_SIGMA_RANGE))))


def _robust(residuals: np.ndarray) -> float:
    """The Cauchy loss of the solver, residuals in standard deviations, scale 2."""
    return float((4 * np.log1p(residuals**2 / 4)).sum())

"""What is believed of a lens before its curves are seen: a Gaussian over the camera's vector.

The gauge m_u = width / 2 is fixed, so eight numbers are free: k1..k5, m_v, u0, v0. The fit moves in
the prior's own coordinates, camera = mean + L z with z ~ N(0, I): a unit step is one standard
deviation of belief, which conditions the problem however correlated the coefficients are, and the
prior's residuals are z itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from classical.camera import KannalaBrandt

FREE = np.array([0, 1, 2, 3, 4, 6, 7, 8])  # of (k1..k5, m_u, m_v, u0, v0)

# Ratios D_i = k_{i+1} / k1 of wide lenses. The mean and the first two deviations follow 2,244
# calibrated action cameras and the four classical projections (θ³ coefficient of 2 tan(θ/2),
# θ, 2 sin(θ/2), sin θ: +0.083, 0, −0.042, −0.167); the last two keep r(θ) tame past 90°.
_RATIO_MEAN = np.array([0.02, -0.005, 0.0, 0.0])
_RATIO_DEVIATION = np.array([0.10, 0.04, 0.012, 0.002])
LOG_STRENGTH_DEVIATION = 0.5  # of k1: fields of view from 60° to over 200°
_ASPECT_DEVIATION = 0.004  # square pixels …
_FREE_ASPECT_DEVIATION = 0.06  # … but for resampled pictures
_CENTRE_DEVIATION = 0.035  # principal point, half picture widths


@dataclass(frozen=True, eq=False)
class LensPrior:
    """A Gaussian belief about (k1..k5, m_u, m_v, u0, v0) in the gauge m_u = width / 2.

    Attributes:
        mean: Mean vector, shape (9,).
        covariance: Covariance, shape (9, 9); the row of m_u is ignored.
    """

    mean: Float[np.ndarray, " 9"]
    covariance: Float[np.ndarray, "9 9"]

    def __post_init__(self) -> None:
        if self.mean.shape != (9,) or self.covariance.shape != (9, 9):
            raise ValueError(
                "Expected a mean (9,) and a covariance (9, 9), "
                f"got {self.mean.shape} and {self.covariance.shape}."
            )
        if not (np.isfinite(self.mean).all() and np.isfinite(self.covariance).all()):
            raise ValueError("Expected a finite prior, got a NaN or an infinity.")

    @cached_property
    def factor(self) -> Float[np.ndarray, "9 8"]:
        """L with camera = mean + L z, shape (9, 8); its row of m_u is zero.

        Raises:
            ValueError: If the covariance of the free parameters is not positive definite.
        """
        free = self.covariance[np.ix_(FREE, FREE)]
        try:
            root = np.linalg.cholesky(free)
        except np.linalg.LinAlgError as error:
            raise ValueError("Expected a positive definite covariance.") from error
        out = np.zeros((9, len(FREE)))
        out[FREE] = root
        return out

    def encode(self, camera: KannalaBrandt) -> Float[np.ndarray, " 8"]:
        """The z of a camera: how many deviations it lies from the mean."""
        offset = camera.normalized().to_vector() - self.mean
        return np.linalg.solve(self.factor[FREE], offset[FREE])

    def decode(self, z: Float[np.ndarray, " 8"], width: int, height: int) -> KannalaBrandt:
        """The camera of z; ValueError if z leads to an impossible one (k1 ≤ 0, m_v ≤ 0)."""
        return KannalaBrandt.from_vector(self.mean + self.factor @ z, width, height)


def fused(beliefs: Sequence[LensPrior], *, most: float = 2.0) -> LensPrior:
    """One belief from many about one lens, the mean weighted by precision.

    Beliefs of one source err alike, so together they count for no more than `most` of them.

    Args:
        beliefs: At least one.
        most: Beliefs that count as independent.

    Raises:
        ValueError: If there is none.
    """
    if not beliefs:
        raise ValueError("Expected at least one belief, got none.")
    block = np.ix_(FREE, FREE)
    precisions = [np.linalg.inv(belief.covariance[block]) for belief in beliefs]
    together = np.linalg.inv(sum(precisions))
    mean = beliefs[0].mean.copy()
    pairs = zip(precisions, beliefs, strict=True)
    mean[FREE] = together @ sum(precision @ belief.mean[FREE] for precision, belief in pairs)
    covariance = np.zeros((9, 9))
    covariance[block] = together * max(1.0, len(beliefs) / most)
    return LensPrior(mean, covariance)


def generic_prior(
    strength: float, width: int, height: int, *, has_free_aspect: bool = False
) -> LensPrior:
    """What holds for lenses in general, near a given strength.

    The coefficients scale with k1, so the Gaussian is taken at k1 = `strength`; k1 itself stays
    nearly free. What it pins is the shape: a lens between stereographic and orthographic, its
    centre near the picture's, its pixels nearly square.

    Args:
        strength: k1 in half picture widths.
        width: Picture width in pixels.
        height: Picture height in pixels.
        has_free_aspect: Whether the pixels are known not to be square.
    """
    half = width / 2
    aspect = _FREE_ASPECT_DEVIATION if has_free_aspect else _ASPECT_DEVIATION
    mean = np.array(
        [
            strength,
            *(strength * _RATIO_MEAN),
            half,
            half,
            (width - 1) / 2,
            (height - 1) / 2,
        ]
    )
    deviation = np.array(
        [0.0, *(strength * _RATIO_DEVIATION), 1.0, half * aspect] + [half * _CENTRE_DEVIATION] * 2
    )
    along_strength = np.zeros(9)
    along_strength[:5] = mean[:5] * LOG_STRENGTH_DEVIATION
    covariance = np.diag(deviation**2) + np.outer(along_strength, along_strength)
    return LensPrior(mean, covariance)


def generic_surprise(ratios: Float[np.ndarray, " 4"], shift: Float[np.ndarray, " 2"]) -> float:
    """|z|² of a lens with square pixels under the `generic_prior` of its own strength.

    Args:
        ratios: k2..k5 over k1.
        shift: Principal point off the picture's middle, half picture widths.
    """
    shape = (ratios - _RATIO_MEAN) / _RATIO_DEVIATION
    centre = shift / _CENTRE_DEVIATION
    return float(shape @ shape + centre @ centre)

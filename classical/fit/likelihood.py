"""How likely curves are under lenses: what their bows lose, in a noise that is told once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from classical.camera import KannalaBrandt
from classical.fit.bends import BendConfig, Bends
from classical.fit.rounds import curve_shares
from classical.fit.samples import CurveSamples
from classical.fit.straightness import straightness

_LOSS_SCALE = 2.0  # deviations beyond which a bow loses weight (Cauchy)


def curve_costs(
    fitted: KannalaBrandt,
    others: Sequence[KannalaBrandt],
    samples: CurveSamples,
    *,
    tolerance: float,
    bend: BendConfig,
) -> list[float]:
    """Negative log likelihood of the curves' bows under lenses, robust as in the solver.

    Args:
        fitted: The lens that tells the deviation of bows in these pictures, the first of the
            result.
        others: Lenses to compare with it.
        samples: Points of the curves.
        tolerance: RMS residual at which a curve has lost most of its weight, pixels.
        bend: How far straight lines look bent.
    """
    bends = Bends.of(samples, fitted.width, bend)
    kept = straightness(fitted, samples).residuals
    deviation = bends.deviation(kept, curve_shares(samples, kept, tolerance))
    every = [kept, *(straightness(lens, samples).residuals for lens in others)]
    return [_cost(bends.bows(residuals) / deviation) for residuals in every]


def _cost(bows: Float[np.ndarray, " curves"]) -> float:
    return float(0.5 * (_LOSS_SCALE**2 * np.log1p((bows / _LOSS_SCALE) ** 2)).sum())

"""Another estimate of the whole lens, and how far the curves let it be believed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from classical.camera import KannalaBrandt
from classical.fit.observations import Observation, of_belief, of_belief_field
from classical.fit.prior import LensPrior


@dataclass(frozen=True, eq=False)
class Estimate:
    """What a network, say, makes of the lens, and how far its covariance is to be doubted.

    The curves tell how far: an estimate that leaves them as straight as they can be is one of those
    that are right, in what lines do not tell, too. The more they lose under it, the more the
    deviations of all it says are widened.

    Attributes:
        belief: The estimate.
        source: Who made it.
        doubts: Factors on its deviations, where the curves lose nothing and at most.
        field_doubt: The most for its field of view alone, which an estimate may know though it
            errs in the shape of the lens; None: it is no surer of that.
        unit: Loss of log likelihood at which the square of the doubt has doubled.
        centring: Deviation of principal points in half picture widths, for an estimate that takes
            lenses to be centred better than they are.
    """

    belief: LensPrior
    source: str
    doubts: tuple[float, float] = (1.0, 1.0)
    field_doubt: float | None = None
    unit: float = 1.0
    centring: float = 0.0

    def lens(self, width: int, height: int) -> KannalaBrandt:
        """The lens itself, for a picture of this size."""
        return self.belief.decode(np.zeros(8), width, height)

    def observations(self, loss: float = math.inf) -> list[Observation]:
        """What it says.

        Args:
            loss: Log likelihood that the curves lose under it against the lens they ask for.
        """
        least, most = self.doubts
        doubt = min(most, least * math.sqrt(1 + max(loss, 0.0) / self.unit))
        whole = of_belief(self.belief, self.source, doubt=doubt, centring=self.centring)
        if self.field_doubt is None:
            return [whole]
        field = min(doubt, self.field_doubt)
        return [of_belief_field(self.belief, self.source, doubt=field), whole]

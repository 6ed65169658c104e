"""Another estimate of the whole lens, and how far the curves let it be believed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from classical.camera import KannalaBrandt
from classical.fit.observations import Observation, of_belief, of_belief_field
from classical.fit.prior import LensPrior


@dataclass(frozen=True)
class Doubt:
    """How far the standard deviations of an estimate are widened before it is believed.

    The curves tell how far: an estimate that leaves them as straight as they can be is one of those
    that are right, in what lines do not tell, too. The more they lose under it, the more is it
    doubted in all that it says.

    Attributes:
        least: Factor where the curves lose nothing.
        most: Factor at most.
        field: The most for its field of view alone, which an estimate may know though it errs in
            the shape of the lens; None: it is no surer of that.
        unit: Loss of log likelihood at which the square of the factor has doubled.
        centring: Deviation of principal points in half picture widths, for an estimate that takes
            lenses to be centred better than they are.
    """

    least: float = 1.0
    most: float = 1.0
    field: float | None = None
    unit: float = 1.0
    centring: float = 0.0

    def factor(self, loss: float) -> float:
        """The factor where the curves lose so much log likelihood."""
        return min(self.most, self.least * math.sqrt(1 + max(loss, 0.0) / self.unit))


@dataclass(frozen=True, eq=False)
class Estimate:
    """What a network, say, makes of the lens.

    Attributes:
        belief: The estimate.
        source: Who made it.
        doubt: How far it is to be doubted.
    """

    belief: LensPrior
    source: str
    doubt: Doubt = Doubt()

    def lens(self, width: int, height: int) -> KannalaBrandt:
        """The lens itself, for a picture of this size."""
        return self.belief.decode(np.zeros(8), width, height)

    def observations(self, loss: float = math.inf) -> list[Observation]:
        """What it says.

        Args:
            loss: Log likelihood that the curves lose under it against the lens they ask for.
        """
        factor, field = self.doubt.factor(loss), self.doubt.field
        whole = of_belief(self.belief, self.source, doubt=factor, centring=self.doubt.centring)
        if field is None:
            return [whole]
        return [of_belief_field(self.belief, self.source, doubt=min(factor, field)), whole]

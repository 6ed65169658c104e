"""Tolerances and effort of the plumb-line fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from classical.fit.bends import BendConfig
from classical.fit.fitted import STRAIGHT_PX
from classical.fit.parallels import ParallelsConfig
from classical.fit.perspective import PerspectiveConfig
from classical.fit.samples import CurveSamples, sample_curves
from classical.fit.search import SearchConfig
from classical.fit.solve import SolverConfig
from classical.fit.vanishing import VanishingConfig
from classical.lines import Curve, TracingConfig
from classical.lines.curve import REFERENCE_WIDTH


@dataclass(frozen=True)
class FitConfig:
    """The plumb-line fit; lengths in pixels of a picture 1280 wide.

    Attributes:
        bend: How far straight lines look bent.
        tolerances: RMS residual at which a curve has lost most of its weight, one per round.
        inlier_tolerance: RMS residual up to which a curve is called straight.
        spacing: Distance between samples on a curve.
        max_curves: Longest curves used in each picture.
        joinings: How often pieces of one line are joined under the lens and the fit repeated …
        tracings: … and how often more, with lines followed beyond their ends, where the pictures
            are given.
        tracing: How far they are followed.
        perspective: When a picture is taken for straight already; None means never.
        slight_bend: A lens that moves the picture by less than this, pixels of a 320 frame, is
            none of those that another estimate is made to tell apart.
        parallels: How lines of one direction help the bends; None leaves the lens to the bends.
        vanishing: How orthogonal vanishing points fix the scale; None leaves it to the prior.
        search: The global start.
        solver: The local solver.
    """

    bend: BendConfig = field(default_factory=BendConfig)
    tolerances: tuple[float, ...] = (3.0, 1.5, 1.0, 1.0)
    inlier_tolerance: float = STRAIGHT_PX
    spacing: float = 14.0
    max_curves: int = 120
    joinings: int = 1
    tracings: int = 2
    tracing: TracingConfig = field(default_factory=TracingConfig)
    perspective: PerspectiveConfig | None = field(default_factory=PerspectiveConfig)
    slight_bend: float = 4.0
    parallels: ParallelsConfig | None = field(default_factory=ParallelsConfig)
    vanishing: VanishingConfig | None = field(default_factory=VanishingConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    solver: SolverConfig = field(default_factory=SolverConfig)

    def tolerance(self, width: int) -> float:
        """`inlier_tolerance` in a picture of that width."""
        return self.inlier_tolerance * width / REFERENCE_WIDTH

    @property
    def last(self) -> FitConfig:
        """The last round alone, for a lens that is known already."""
        return replace(self, tolerances=self.tolerances[-1:])

    def samples(
        self, curve_sets: Sequence[Sequence[Curve]], width: int, *, most: int | None = None
    ) -> CurveSamples:
        """Points of the longest curves of each picture, by default `max_curves`.

        Raises:
            ValueError: If there is no curve.
        """
        most = self.max_curves if most is None else most
        pool = [sorted(curves, key=lambda curve: -curve.length)[:most] for curves in curve_sets]
        return sample_curves(
            [curve for picture in pool for curve in picture],
            spacing=self.spacing * width / REFERENCE_WIDTH,
            pictures=np.repeat(np.arange(len(pool)), [len(picture) for picture in pool]),
        )

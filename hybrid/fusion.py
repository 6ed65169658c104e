"""The hybrid: what the networks see and what straight lines prove, in one fit.

Line perception says where lines are, beside the edges that the picture shows by itself; LaRecNet's
lens is a start and a belief; the straightness fit has the last word in all that lines tell.
Importing this module loads torch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from classical.fit import (
    Doubt,
    Estimate,
    FitConfig,
    LensPrior,
    ParallelsConfig,
    VanishingConfig,
    fit_lens,
)
from classical.lines import (
    Curve,
    centre_curves,
    curves_from_both,
    curves_from_heatmap,
    find_image_circle,
    find_rim,
)
from hybrid.config import RectifyConfig
from hybrid.estimators import estimate_from_fit, given_by_user, too_small
from hybrid.networks import network_belief
from hybrid.result import Calibration
from learned.predictor import Predictor

_NETWORK = "network"
_DOUBT = Doubt(least=1.5, most=8.0, field=4.0, unit=2.0, centring=0.0125)
Answer = TypeVar("Answer")


@dataclass(frozen=True)
class HybridConfig:
    """What takes part; the variants of the ablation switch it on one by one.

    Attributes:
        snaps: Curves of the heatmap lie on the picture's sub-pixel edges, not on its centre lines.
        adds_edges: Edges that the heatmap does not mark are curves too.
        follows: Lines are followed beyond the ends of their curves.
        believes: LaRecNet's lens is a belief beside a start.
        doubt: How far LaRecNet's lens is doubted: a network does worse on real pictures than on
            those it was trained on, and worst in the shape of the lens. It trained on lenses, too,
            that are centred exactly, and takes clean pictures to be of one; real principal points
            deviate by `centring`. Weights for pictures like their training set alone say
            themselves how far to doubt them: their card has a "doubt".
        has_parallels: Lines that point in one direction help the bends.
        has_vanishing: Orthogonal vanishing points help to fix the scale.
    """

    snaps: bool = True
    adds_edges: bool = True
    follows: bool = True
    believes: bool = True
    doubt: Doubt = _DOUBT
    has_parallels: bool = True
    has_vanishing: bool = True


_EDGES = HybridConfig(follows=False, has_parallels=False, has_vanishing=False)
VARIANTS = {
    "start": replace(_EDGES, snaps=False, adds_edges=False, believes=False),
    "prior": replace(_EDGES, snaps=False, adds_edges=False),
    "snapped": replace(_EDGES, adds_edges=False),
    "edges": _EDGES,
    "followed": replace(_EDGES, follows=True),
    "parallels": HybridConfig(has_vanishing=False),
    "full": HybridConfig(),
}
"""Each has one thing more than the one before: a fit from the network's start, its belief,
sub-pixel edges, edges of the picture's own, lines followed further, directions of lines, vanishing
points."""


class HybridEstimator:
    """Networks and straightness fit together; many pictures of one lens in one fit."""

    def __init__(self, config: RectifyConfig) -> None:
        self._config = config
        self._hybrid = VARIANTS[config.variant or "full"]
        self._predictor = Predictor.from_weights(config.weights)

    def __call__(self, pictures: Sequence[UInt8[ndarray, "h w 3"]]) -> Calibration:
        """One lens for all pictures."""
        height, width = pictures[0].shape[:2]
        failure = too_small(pictures)
        if failure is not None:
            return failure
        cfg, seed = self._hybrid, self._config.seed
        with ThreadPoolExecutor(max_workers=1) as networks:
            # the networks look while edges are found; threads=1 does one after the other
            submit = _at_once if self._config.threads == 1 else networks.submit
            heat = [submit(self._lineness, picture) for picture in pictures]
            lenses = [submit(self._predictor.lens, picture) for picture in pictures]
            circles = [find_image_circle(picture) for picture in pictures]
            curves = [self._curves(*pair) for pair in zip(pictures, heat, strict=True)]
            belief = network_belief([lens.result() for lens in lenses])
        heatmaps = tuple(each.result() for each in heat)
        observations = given_by_user(self._config, circles, width)
        estimate = self._believed(belief) if belief is not None and cfg.believes else None
        starts = []
        if belief is not None and not cfg.believes:
            starts.append(belief.decode(np.zeros(8), width, height))
        fit = fit_lens(
            curves,
            width,
            height,
            config=FitConfig(
                parallels=ParallelsConfig(seed=seed) if cfg.has_parallels else None,
                vanishing=VanishingConfig(seed=seed) if cfg.has_vanishing else None,
            ),
            circles=circles,
            observations=observations,
            estimate=estimate,
            starts=starts,
            rims=[find_rim(picture) for picture in pictures],
            pictures=pictures if cfg.follows else (),
        )
        return replace(estimate_from_fit(fit), heatmaps=heatmaps)

    def _believed(self, belief: LensPrior) -> Estimate:
        """LaRecNet's lens, and how far to believe it; see `HybridConfig`."""
        own = self._predictor.card.get("doubt")
        doubt = self._hybrid.doubt if own is None else Doubt(float(own), float(own))
        return Estimate(belief, _NETWORK, doubt)

    def _lineness(self, picture: UInt8[ndarray, "h w 3"]) -> Float[ndarray, "hh ww"]:
        return self._predictor.lines(picture).lineness

    def _curves(
        self, picture: UInt8[ndarray, "h w 3"], heatmap: Future[Float[ndarray, "hh ww"]]
    ) -> list[Curve]:
        """Edges of the picture, and curves of the heatmap that are not among them."""
        if not self._hybrid.snaps:
            return centre_curves(heatmap.result(), picture.shape[1], picture.shape[0])
        if not self._hybrid.adds_edges:
            return curves_from_heatmap(heatmap.result(), picture)
        return curves_from_both(heatmap.result, picture)


def _at_once(function: Callable[..., Answer], *arguments: object) -> Future[Answer]:
    """What an executor's `submit` gives, with the work done."""
    done: Future[Answer] = Future()
    done.set_result(function(*arguments))
    return done

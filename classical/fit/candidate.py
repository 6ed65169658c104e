"""What is made of a lens that the rounds settled on: left straight, scaled, taken to the rim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from classical.camera import KannalaBrandt
from classical.fit.config import FitConfig
from classical.fit.perspective import Perspective, bend_of, compared_with_perspective
from classical.fit.quality import TAIL, disagreement
from classical.fit.reach import FALLS_SHORT, within_reach
from classical.fit.rounds import Known
from classical.fit.scale import fused_scale, scale_tangent, vanishing_scale
from classical.lines import Curve, join_curves

STRAIGHT = "the lines are straight already"
UNTOLD = "the lines could not tell a fisheye from a straight picture; the lens is a guess"
_PERHAPS_STRAIGHT = "the lines look straight already, but they could not tell a fisheye"
_OPEN_SCALE = 0.5  # deviation of log focal length that straight lines leave to a straight picture


@dataclass(frozen=True, eq=False)
class Candidate:
    """A lens that the rounds settled on.

    Attributes:
        camera: The lens.
        covariance: Of its vector, shape (9, 9).
        scale_source: What told the most about its scale.
        note: Why it is no common fit, empty where it is one.
        error: The error to expect, pixels of a 320 frame, where the covariance does not tell it.
        perspective: What the curves say of a perspective lens instead, None where not asked.
    """

    camera: KannalaBrandt
    covariance: Float[np.ndarray, "9 9"]
    scale_source: str
    note: str = ""
    error: float | None = None
    perspective: Perspective | None = None


def unless_straight(
    best: Candidate,
    curve_sets: Sequence[Sequence[Curve]],
    joined: Sequence[Sequence[Curve]],
    known: Known,
    config: FitConfig,
) -> Candidate:
    """The perspective lens where it does as well; its scale is then open.

    Line perception was made to find bent lines and finds some in every picture, so a bend is not
    believed where the curves that the picture shows by itself speak for straight lines. Where no
    curve speaks, another estimate of the lens is the better guess: most pictures that come here
    are bent.
    """
    straight = _perspective(best.camera, joined, known, config)
    own = [[curve for curve in curves if not curve.is_hinted] for curves in curve_sets]
    if not straight.is_allowed and 0 < sum(map(len, own)) < sum(map(len, curve_sets)):
        straight = _own_if_straight(best.camera, own, known, config) or straight
    best = replace(best, perspective=straight)
    if not straight.is_allowed:
        return best
    if straight.is_untold and known.has_estimate:
        return replace(best, note=UNTOLD)
    camera = straight.camera
    tangent = scale_tangent(camera) * _OPEN_SCALE
    sure = np.diag([*(camera.k[0] * np.full(5, 1e-4)), 0.0, *(1e-4 * camera.m_u * np.ones(3))]) ** 2
    covariance = sure + np.outer(tangent, tangent)
    note = STRAIGHT if straight.is_proven else _PERHAPS_STRAIGHT
    error = disagreement(camera, best.camera) / TAIL  # at most what the bend would move
    return Candidate(camera, covariance, best.scale_source, note, error, straight)


def _own_if_straight(
    camera: KannalaBrandt, own: Sequence[Sequence[Curve]], known: Known, config: FitConfig
) -> Perspective | None:
    """What the picture's own curves say, joined, where they speak for a perspective lens."""
    # joined they only tell a bend better: pieces that tell one need not be
    if not _perspective(camera, own, known, config).is_allowed:
        return None
    alone = [join_curves(curves, camera) for curves in own]
    said = _perspective(camera, alone, known, config)
    return said if said.is_allowed and said.is_proven else None


def is_open(found: Candidate, config: FitConfig) -> bool:
    """Whether another estimate of the lens may be all that speaks for the bend of a candidate."""
    if found.note:
        return found.note == UNTOLD
    if is_slight(found, 2 * config.slight_bend):
        return True
    said, limits = found.perspective, config.perspective
    return said is not None and limits is not None and said.gain < limits.clear_gain


def is_better_alone(alone: Candidate, found: Candidate, config: FitConfig) -> bool:
    """Whether what the curves say by themselves counts, not what they say with an estimate.

    It does where they speak for a perspective lens, and where both are hardly bent: a network has
    learned from fisheyes and sees a wide one in every picture, and next to no lens is wide and
    almost straight, so it bends an almost straight picture by some pixels.
    """
    if alone.perspective is not None and alone.perspective.is_allowed:
        return not alone.perspective.is_untold
    slight = config.slight_bend
    return is_slight(alone, slight) and is_slight(found, 2 * slight)


def is_slight(found: Candidate, most: float) -> bool:
    """Whether a lens hardly bends its picture, by less than `most` pixels of a 320 frame."""
    return found.note == STRAIGHT or (not found.note and bend_of(found.camera) < most)


def with_scale(
    best: Candidate, curve_sets: Sequence[Sequence[Curve]], config: FitConfig
) -> Candidate:
    """Fuse the fit's scale with those of each picture's vanishing points by their variances."""
    assert config.vanishing is not None
    width = best.camera.width
    most = config.vanishing.most_lines
    sets = [config.samples([curves], width, most=most) for curves in curve_sets if curves]
    found = [
        vanishing_scale(best.camera, samples, config.tolerance(width), config.vanishing)
        for samples in sets
    ]
    fused = fused_scale(
        best.camera, best.covariance, [estimate for estimate in found if estimate is not None]
    )
    if fused is None:
        return best
    source = "vanishing points" if fused.gain > 0.5 else best.scale_source
    return replace(best, camera=fused.camera, covariance=fused.covariance, scale_source=source)


def to_rim(best: Candidate, rim: Float[np.ndarray, "n 2"]) -> Candidate:
    """The lens `within_reach` of the rim, or a word where none is near."""
    if best.note:
        return best
    found = within_reach(best.camera, best.covariance, rim)
    return replace(best, camera=found.camera, note="" if found.reaches else FALLS_SHORT)


def _perspective(
    camera: KannalaBrandt, curve_sets: Sequence[Sequence[Curve]], known: Known, config: FitConfig
) -> Perspective:
    """What these curves say of a perspective lens."""
    assert config.perspective is not None
    return compared_with_perspective(
        camera,
        config.samples(curve_sets, camera.width),
        known,
        tolerance=config.tolerance(camera.width),
        bend=config.bend,
        config=config.perspective,
    )

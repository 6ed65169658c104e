"""Bukhari & Dailey: division distortion from circular arcs in one picture.

F. Bukhari, M. N. Dailey, "Automatic Radial Distortion Estimation from a Single Image", Journal of
Mathematical Imaging and Vision 45 (2013).

What is ours, since the article's thresholds could not be had in full:

- Contours of at least 4 % of the longer side, a Gaussian of 1.2 px and 500 circles a stretch follow
  a published arc-based calibration system; t_d = 1 px, L_min = 40 px and 2,000 triples come from a
  trial of our own, as do the two contrasts of the edge detector.
- Edges and their links are those of `classical.lines` (sub-pixel maxima of the gradient, mutually
  best neighbours, so that contours end at junctions), with Canny's second threshold on contours.
- An arc whose whole contour is near one circle is taken without trials, since none could be longer.
- Straightness is the root mean square over 16 points of an arc, divided by its magnification, under
  0.5 px.
- Only the 120 longest arcs are used; pictures over 1280 px are reduced.
- With `centre="fixed"` every arc alone proposes λ, and the centre stays in the middle.
- Fewer than five agreeing arcs of 34 px + 3 % of the longer side, or less than 15 % of the length
  of all arcs, are a failed estimate: blurred noise has agreeing arcs too, but not as long.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, UInt8

from classical.baselines.bukhari.arcs import Arc, find_arcs, find_contours
from classical.baselines.bukhari.config import BukhariConfig
from classical.baselines.bukhari.refinement import Solution, refine
from classical.baselines.bukhari.sampling import (
    Frame,
    best_hypothesis,
    hypotheses,
    is_plausible,
    refit,
    sample_points,
    straightness,
)
from classical.baselines.picture import WorkingPicture, working_picture
from classical.camera import Division

CITATION = (
    "F. Bukhari, M. N. Dailey: Automatic Radial Distortion Estimation from a Single Image, Journal "
    "of Mathematical Imaging and Vision 45 (2013)"
)


@dataclass(frozen=True)
class BukhariResult:
    """The model, or why there is none, and what the method saw on the way.

    Contours and arcs are in the working picture; `working.to_picture` maps them back.

    Attributes:
        model: The distortion in pixels of the picture given; None if the estimate failed.
        status: "ok" or "failed".
        reason: The failure in words; empty if there is none.
        working: The grey picture at working size.
        contours: Linked edges.
        arcs: Arcs found, longest first.
        inlier: Arcs that agree with the model.
        sampled: (λ, x0, y0) of the best sample, in working pixels.
        rms: Root mean square distance of the agreeing arcs' points to their circles, working px.
    """

    model: Division | None
    status: Literal["ok", "failed"]
    reason: str
    working: WorkingPicture | None
    contours: list[Float[np.ndarray, "_ 2"]]
    arcs: list[Arc]
    inlier: Bool[np.ndarray, " m"]
    sampled: Float[np.ndarray, " 3"] | None = None
    rms: float = float("nan")

    def __bool__(self) -> bool:
        return self.model is not None

    def curves(self) -> list[Float[np.ndarray, "_ 2"]]:
        """Points of each arc in order, in pixels of the picture given; `inlier` goes with them."""
        points = [arc.points for arc in self.arcs]
        return points if self.working is None else [self.working.to_picture(p) for p in points]


def estimate(
    image: UInt8[np.ndarray, "h w 3"] | UInt8[np.ndarray, "h w"],
    *,
    config: BukhariConfig | None = None,
    rng: np.random.Generator | None = None,
) -> BukhariResult:
    """Estimate λ and the centre of distortion of one picture.

    Args:
        image: Grey or RGB picture, uint8.
        config: Parameters; None takes the defaults.
        rng: Source of the random trials; None seeds one from the config.

    Raises:
        ValueError: If `image` is not an 8-bit grey or RGB picture.
    """
    config = config or BukhariConfig()
    rng = np.random.default_rng(config.seed) if rng is None else rng
    working = working_picture(image, smallest=None, largest=config.largest_side)
    height, width = working.grey.shape
    contours = find_contours(working.grey, config=config)
    arcs = find_arcs(contours, config=config, rng=rng)
    found = estimate_from_arcs(arcs, width, height, config=config, rng=rng)
    found = replace(found, working=working, contours=contours)
    if found.model is None:
        return found
    centre = working.to_picture(np.array([[found.model.u0, found.model.v0]]))[0]
    lambda_ = found.model.lambda_ * working.scale**2
    model = Division(lambda_, float(centre[0]), float(centre[1]), working.width, working.height)
    return replace(found, model=model)


def estimate_from_arcs(
    arcs: list[Arc],
    width: int,
    height: int,
    *,
    config: BukhariConfig,
    rng: np.random.Generator,
) -> BukhariResult:
    """The same from arcs: sample triples, keep the best, fit again to its arcs, refine.

    Args:
        arcs: Arcs in a picture of this size.
        width: Picture width in pixels.
        height: Picture height in pixels.
        config: Parameters of the method.
        rng: Source of the random trials.
    """
    none = np.zeros(len(arcs), bool)
    failed = BukhariResult(None, "failed", "", None, [], arcs, none)
    if len(arcs) < config.least_arcs:
        return replace(failed, reason=f"Only {len(arcs)} circular arcs were found.")
    frame = Frame.of_picture(width, height)
    circles, lengths = frame.circles(arcs), np.array([arc.length for arc in arcs])
    samples = sample_points(arcs, frame, config.score_points)
    found = hypotheses(circles, frame, config=config, rng=rng)
    if not len(found):
        return replace(failed, reason="No triple of arcs gives a plausible lens.")
    best, inlier = best_hypothesis(found, samples, lengths, frame, config=config)
    again = refit(circles[inlier], lengths[inlier], frame, config=config) if inlier.any() else None
    if again is not None:  # kept only if it explains no less
        both = np.stack([best, again])
        best, inlier = best_hypothesis(both, samples, lengths, frame, config=config)
    failed = replace(failed, sampled=_in_pixels(best, frame), inlier=inlier)
    long = config.long_arc + config.long_arc_share * max(width, height)
    reason = _doubt(inlier, lengths, long, config)
    if reason:
        return replace(failed, reason=reason)
    solution = _refined(arcs, inlier, best, frame, config)
    inlier = np.asarray(
        straightness(solution.distortion[None], samples, frame)[0] < config.straight_distance
    )
    reason = _doubt(inlier, lengths, long, config)
    if reason or not is_plausible(solution.distortion[None], frame)[0]:
        return replace(failed, reason=reason or "The refined lens is not plausible.")
    lambda_, u0, v0 = _in_pixels(solution.distortion, frame)
    points = sum(len(arc.points) for arc, good in zip(arcs, failed.inlier, strict=True) if good)
    return replace(
        failed,
        model=Division(float(lambda_), float(u0), float(v0), width, height),
        status="ok",
        inlier=inlier,
        rms=float(np.sqrt(solution.cost / max(points, 1)) * frame.unit),
    )


def _refined(
    arcs: list[Arc],
    inlier: Bool[np.ndarray, " m"],
    start: Float[np.ndarray, " 3"],
    frame: Frame,
    config: BukhariConfig,
) -> Solution:
    """Levenberg–Marquardt on the points of the agreeing arcs, in the frame's coordinates."""
    kept = [arc.points for arc, good in zip(arcs, inlier, strict=True) if good]
    starts = np.cumsum([0] + [len(points) for points in kept[:-1]])
    points = (np.concatenate(kept) - frame.middle) / frame.unit
    return refine(points, starts, start, config=config)


def _doubt(inlier: np.ndarray, lengths: np.ndarray, long: float, config: BukhariConfig) -> str:
    """Why these agreeing arcs are too few to be believed; empty if they are not."""
    agreeing = int((inlier & (lengths >= long)).sum())
    if agreeing < config.least_arcs:
        return f"Only {agreeing} of {len(inlier)} arcs agree on a lens and are over {long:.0f} px."
    share = float(lengths[inlier].sum() / lengths.sum())
    if share < config.least_share:
        return f"Arcs that agree on a lens are only {100 * share:.0f} % of the length of all arcs."
    return ""


def _in_pixels(distortion: np.ndarray, frame: Frame) -> np.ndarray:
    """(λ, x0, y0) in pixels of the picture."""
    return np.array([distortion[0] / frame.unit**2, *(distortion[1:] * frame.unit + frame.middle)])

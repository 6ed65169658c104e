"""Whether lines are straight already, so that a perspective lens explains them as well.

A curve tells one thing here, the bow that a lens leaves of it, in standard deviations of the bow of
straight lines in this picture. Kerbs, curtains and branches are bent without any lens, and with a
few of them five coefficients always find some gain; what they find by chance is slight. So the
proof that a bend needs falls with its size: to leave a slight bend does little harm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from classical.camera import KannalaBrandt
from classical.fit.bends import BendConfig
from classical.fit.likelihood import curve_costs
from classical.fit.quality import disagreement
from classical.fit.rounds import Known
from classical.fit.samples import CurveSamples
from classical.fit.search import projection

_FISHEYE = 0.9  # of an equidistant lens to compare with: 127° across
_STRENGTH = 2.0  # focal length in half widths, 53° across: straight lines do not tell it


@dataclass(frozen=True)
class PerspectiveConfig:
    """When a perspective lens is believed instead of a bent one.

    Set on photographs as they are and bent by lenses of 30° to 115°.

    Attributes:
        least_gain: Gain in log likelihood that a bent lens must bring for its parameters.
        least_proof: Gain in log likelihood by a bent lens, times the distance in pixels of a 320
            frame by which it moves the picture, from which the bend is believed.
        least_evidence: A common fisheye must lose so much log likelihood against a perspective
            lens, or the curves cannot tell straight from bent.
        least_say: If it loses less than this, they say nothing either way.
        clear_gain: Gain in log likelihood from which a bend is the curves' own, whoever else says
            so; below, it is asked whether they would have come to it by themselves.
    """

    least_gain: float = 2.0
    least_proof: float = 6.0
    least_evidence: float = 12.5
    least_say: float = 7.0
    clear_gain: float = 5.0


class Perspective(NamedTuple):
    """A perspective lens beside a fitted one.

    Attributes:
        camera: The lens.
        gain: Gain in log likelihood that the fitted lens brings by its bend.
        is_allowed: Whether it makes the curves about as straight as the fitted one.
        is_proven: Whether the curves speak for it, then, or only not against it …
        is_untold: … or do not speak at all.
    """

    camera: KannalaBrandt
    gain: float
    is_allowed: bool
    is_proven: bool
    is_untold: bool


def compared_with_perspective(
    camera: KannalaBrandt,
    samples: CurveSamples,
    known: Known,
    *,
    tolerance: float,
    bend: BendConfig,
    config: PerspectiveConfig,
) -> Perspective:
    """What the curves say of a perspective lens, r = f tan θ as near as five coefficients come.

    Args:
        camera: The fitted lens.
        samples: Points of the curves.
        known: What is known beside them; what is sure speaks for or against a bend, too. Another
            estimate of the lens does not: it was made to find one, and finds one in every picture.
        tolerance: RMS residual at which a curve has lost most of its weight, pixels.
        bend: How far straight lines look bent.
        config: How much proof a bend must bring.
    """
    width, height = camera.width, camera.height
    straight = perspective_lens(width, height)
    others = [straight, projection(_FISHEYE, 0.0, width, height)]
    bent, flat, fisheye = curve_costs(camera, others, samples, tolerance=tolerance, bend=bend)
    gain = flat - bent + known.sure_cost(straight) - known.sure_cost(camera)
    moved = bend_of(camera)
    slight = gain * moved < config.least_proof  # False where they have nothing in common
    evidence = fisheye - flat
    return Perspective(
        straight,
        gain,
        is_allowed=gain < config.least_gain or slight,
        is_proven=evidence >= config.least_evidence,
        is_untold=evidence < config.least_say,
    )


def perspective_lens(width: int, height: int) -> KannalaBrandt:
    """The lens r = f tan θ, as near as five coefficients come, for a picture of this size."""
    return projection(_STRENGTH, -1.0, width, height)


def bend_of(camera: KannalaBrandt) -> float:
    """How far a lens moves its picture from a perspective one, pixels of a 320 frame; or NaN."""
    return disagreement(camera, perspective_lens(camera.width, camera.height))

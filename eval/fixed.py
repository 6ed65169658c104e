"""The best fixed lens: what one lens for all pictures can do, chosen with the truth in view."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from classical.camera import KannalaBrandt, radial_coefficients
from eval.cases import Case
from eval.metrics import distances, pixel_grid, rectified, within
from learned.slf.priors import PROJECTIONS

UNITS: dict[str, Callable[[int, int], float]] = {
    "half width": lambda width, height: width / 2,
    "half height": lambda width, height: height / 2,
    "half diagonal": lambda width, height: math.hypot(width, height) / 2,
}
"""What a lens can keep to in pictures of several sizes: pixels, by width and height."""

_FIELDS = range(60, 225, 5)  # degrees from end to end of the unit
_BEYOND = 1.7  # corners see so much more than the nearest edge
_WIDEST = np.radians(115.0)  # from the axis; orthographic-like radii grow to 120°
_SPACING = 8.0  # pixels of the frame between those compared


@dataclass(frozen=True)
class FixedLens:
    """One lens for pictures of any size, centred and with square pixels.

    Attributes:
        unit: Of the radii, a name in `UNITS`.
        k: k1..k5 in that unit.
    """

    unit: str
    k: tuple[float, ...]

    def camera(self, width: int, height: int) -> KannalaBrandt:
        """The lens in a picture of some size, in pixels."""
        scale = UNITS[self.unit](width, height) / (width / 2)
        return KannalaBrandt.centred(scale * np.array(self.k), width, height)


def best_fixed_lens(cases: Sequence[Case], theta_max: float) -> FixedLens:
    """The lens that has the least median aligned error when all pictures are given it.

    Candidates, in each unit, are the true lenses of the pictures without their principal points
    and aspects, and standard projections over a range of fields of view.

    Args:
        cases: Photographs with their true cameras.
        theta_max: True angle up to which pixels are compared, radians.
    """
    candidates = _candidates(cases)
    groups: dict[tuple[int, int], list[Case]] = defaultdict(list)
    for case in cases:
        groups[case.camera.width, case.camera.height].append(case)
    errors = [_errors(candidates, group, theta_max) for group in groups.values()]
    return candidates[int(np.argmin(np.median(np.concatenate(errors), axis=0)))]


def _errors(
    candidates: Sequence[FixedLens], cases: Sequence[Case], theta_max: float
) -> Float[ndarray, "n c"]:
    """Aligned error of each candidate on each picture; pictures of one size."""
    size = (cases[0].camera.width, cases[0].camera.height)
    points = pixel_grid(*size, spacing=_SPACING)
    seen = [within(case.camera, points, theta_max) for case in cases]
    targets = [rectified(c.camera, points[s], *size) for c, s in zip(cases, seen, strict=True)]
    errors = np.empty((len(cases), len(candidates)))
    for column, lens in enumerate(candidates):
        place = rectified(lens.camera(*size), points, *size)
        errors[:, column] = [
            distances(place[inside], target, aligned=True).mean()
            for inside, target in zip(seen, targets, strict=True)
        ]
    return errors


def _candidates(cases: Sequence[Case]) -> list[FixedLens]:
    """All candidates, each once; in one unit where pictures of one shape make all units alike."""
    shapes = {case.camera.width / case.camera.height for case in cases}
    units = list(UNITS) if len(shapes) > 1 else list(UNITS)[:1]
    return list(
        dict.fromkeys(
            FixedLens(unit, tuple(round(float(value), 6) for value in k))
            for unit in units
            for k in (*_true_lenses(cases, unit), *_standard_lenses())
        )
    )


def _true_lenses(cases: Sequence[Case], unit: str) -> Iterator[Float[ndarray, " 5"]]:
    for camera in (case.camera for case in cases):
        yield camera.k * camera.m_u / UNITS[unit](camera.width, camera.height)


def _standard_lenses() -> Iterator[Float[ndarray, " 5"]]:
    for projection in PROJECTIONS.values():
        for half in np.radians(_FIELDS) / 2:
            theta = np.linspace(0.0, min(_BEYOND * half, _WIDEST), 200)
            yield radial_coefficients(theta, projection(theta) / projection(half))

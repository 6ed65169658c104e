"""What a curve tells: how far it is bent, not each of its points.

Samples of one curve err together. On calibrated pictures the residual of a straight line is a
smooth bow and a smaller double bow, more so the longer the line, and only a little noise besides.
So the residuals of a curve are read as amplitudes of Legendre polynomials along it, from the second
on (the zeroth and first are the line itself), each with a standard deviation that grows with the
length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.sparse import csc_array

from classical.fit.samples import CurveSamples
from classical.lines.curve import REFERENCE_WIDTH

_FIRST = 2  # order of the bow


@dataclass(frozen=True)
class BendConfig:
    """How far straight lines look bent; lengths in pixels of a picture 1280 wide.

    Attributes:
        orders: Amplitudes a curve, from the bow on.
        reference: Length at which the deviation is that of the picture.
        shortest: Length below which it falls no further.
        growth: Power of the length with which the deviation grows.
        decay: Power of the order with which it falls.
        deviation_range: Least and greatest deviation of the bow at the reference length; in between
            it is measured in the picture.
    """

    orders: int = 4
    reference: float = 100.0
    shortest: float = 80.0
    growth: float = 0.6
    decay: float = 1.3
    deviation_range: tuple[float, float] = (0.1, 1.0)


@dataclass(frozen=True, eq=False)
class Bends:
    """Amplitudes of the curves' bends as linear functions of the samples' residuals.

    Attributes:
        functionals: Weight of each residual in each amplitude of its curve, shape (n, orders).
        shapes: Deviation of each amplitude relative to the picture's, shape (C, orders).
        samples: The samples.
        scale: Picture width over 1280.
        config: How far straight lines look bent.
    """

    functionals: Float[np.ndarray, "n orders"]
    shapes: Float[np.ndarray, "curves orders"]
    samples: CurveSamples
    scale: float
    config: BendConfig

    @classmethod
    def of(cls, samples: CurveSamples, width: int, config: BendConfig) -> Bends:
        """Bends of the curves of pictures so many pixels wide."""
        scale = width / REFERENCE_WIDTH
        lengths = np.maximum(samples.lengths / scale, config.shortest) / config.reference
        orders = np.arange(_FIRST, _FIRST + config.orders)
        shapes = lengths[:, None] ** config.growth * (_FIRST / orders) ** config.decay
        return cls(_functionals(samples, config.orders), shapes, samples, scale, config)

    def bows(self, residuals: Float[np.ndarray, " n"]) -> Float[np.ndarray, " curves"]:
        """Bow of each curve as it would be at the reference length in a picture 1280 wide."""
        bows = self.samples.curve_sums(self.functionals[:, 0] * residuals)
        return bows / (self.scale * self.shapes[:, 0])

    def deviation(
        self, residuals: Float[np.ndarray, " n"], shares: Float[np.ndarray, " curves"]
    ) -> float:
        """Standard deviation of the bow at the reference length, from the median of the curves.

        Args:
            residuals: Of the samples, pixels.
            shares: Weight of each curve.
        """
        relative = np.abs(self.bows(residuals))
        order = np.argsort(relative, kind="stable")
        weight = np.cumsum((self.samples.lengths * shares)[order])
        middle = relative[order][np.searchsorted(weight, 0.5 * weight[-1])]
        least, most = self.config.deviation_range
        return float(np.clip(1.4826 * middle, least, most))

    def operator(self, deviation: float, shares: Float[np.ndarray, " curves"]) -> csc_array:
        """Residuals (n,) to weighted amplitudes (C · orders,), curve by curve."""
        weights = np.sqrt(shares)[:, None] / (deviation * self.scale * self.shapes)
        owner, orders = self.samples.owner, self.config.orders
        values = self.functionals * weights[owner]
        rows = owner[:, None] * orders + np.arange(orders)
        starts = np.arange(len(owner) + 1) * orders
        shape = (self.samples.n_curves * orders, len(owner))
        return csc_array((values.ravel(), rows.ravel(), starts), shape=shape)


def _functionals(samples: CurveSamples, orders: int) -> Float[np.ndarray, "n orders"]:
    """Least-squares amplitudes of Legendre polynomials over the samples of each curve."""
    out = np.zeros((len(samples.points), orders))
    place = _along(samples)
    for count in np.unique(samples.counts):
        degree = min(_FIRST + orders - 1, count - 2)
        if degree < _FIRST:
            continue  # a curve of three samples tells no bend that noise could not make
        starts = samples.starts[samples.counts == count]
        index = starts[:, None] + np.arange(count)
        vander = np.polynomial.legendre.legvander(place[index], degree)
        inverse = np.linalg.pinv(vander)[:, _FIRST:]
        out[index[:, :, None], np.arange(inverse.shape[1])] = inverse.transpose(0, 2, 1)
    return out


def _along(samples: CurveSamples) -> Float[np.ndarray, " n"]:
    """Where each sample lies along its curve by length, from −1 to 1."""
    steps = np.hypot(
        np.diff(samples.u, prepend=samples.u[0]), np.diff(samples.v, prepend=samples.v[0])
    )
    steps[samples.starts] = 0.0
    path = np.cumsum(steps)
    first = path[samples.starts]
    total = np.append(path[samples.starts[1:] - 1], path[-1]) - first
    return 2 * (path - first[samples.owner]) / np.maximum(total, 1e-9)[samples.owner] - 1

"""Named distributions of lenses: `paper`, `wild` and `fisheye`.

All are drawn from a NumPy generator and have a log density over the camera vector, which a fit can
use as its prior. Lengths are half image widths throughout (gauge m_u = 1).

* `paper` follows the published D-Wireframe samples: centred, square pixels, k1 between 1.0 and 1.8,
  k2 / k1 mostly under 0.1 and at worst −0.44, half field 35° to 52° at the frame's edge.
* `wild` covers real wide lenses from 90° to over 180°: a mixture fitted to calibrated lenses
  (`fit_wild_prior.py`) and the four standard projections with perturbation, on full, letterboxed,
  full-circle and drum frames, with jitter of principal point and aspect.
* `fisheye` is the wide end of it: lenses of some 180° as in security, parking and robot cameras,
  whose circle the sensor mostly cuts above and below, and diagonal fisheyes without a circle.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from learned.slf.fit_wild_prior import log_normal
from learned.slf.lens_shape import (
    KNOTS,
    coefficients,
    first_angle,
    monotone_limit,
    shapes,
    slope,
)
from learned.slf.lenses import LensBatch, concatenated, frame_theta_max

_OVERSAMPLING = 4
_SMALLEST_RELATIVE_SLOPE = 0.08


@runtime_checkable
class LensPrior(Protocol):
    """A distribution of lenses."""

    @property
    def name(self) -> str:
        """What it is called."""
        ...

    def sample(self, rng: np.random.Generator, n: int) -> LensBatch:
        """Draw `n` lenses."""
        ...

    def log_density(self, vector: Float[ndarray, "n 9"]) -> Float[ndarray, " n"]:
        """Log density of camera vectors in the gauge m_u = 1, up to a constant."""
        ...


def lens_prior(name: str) -> LensPrior:
    """The prior of a name.

    Raises:
        ValueError: If there is none of that name.
    """
    known: dict[str, Callable[[], LensPrior]] = {
        "paper": PaperPrior,
        "wild": WildPrior,
        "fisheye": fisheye_prior,
    }
    if name not in known:
        raise ValueError(f"expected a lens prior among {sorted(known)}, got {name!r}")
    return known[name]()


def gauged(vector: Float[ndarray, "n 9"]) -> Float[ndarray, "n 9"]:
    """Camera vectors rescaled to m_u = 1; the lens is the same."""
    scale = vector[:, 5:6]
    return np.concatenate([vector[:, :5] * scale, vector[:, 5:7] / scale, vector[:, 7:]], axis=1)


@dataclass(frozen=True)
class PaperPrior:
    """Lenses like those of the paper's published D-Wireframe samples.

    Attributes:
        name: "paper".
        k1: Range of k1, uniform.
        edge: Range of the half field of view at the frame's edge, in radians.
        ratio_sigma: Standard deviations of k2/k1 (main part), k3/k1, k4/k1, k5/k1.
        tail: Weight, mean and standard deviation of the strong part of k2/k1.
        slack: Widths of the normals that stand for m_v = 1, u0 = v0 = 0 in `log_density`.
    """

    name: str = "paper"
    k1: tuple[float, float] = (1.0, 1.8)
    edge: tuple[float, float] = (np.radians(35.0), np.radians(52.0))
    ratio_sigma: tuple[float, float, float, float] = (0.06, 0.02, 0.006, 0.002)
    tail: tuple[float, float, float] = (0.12, -0.15, 0.13)
    slack: float = 0.004

    def sample(self, rng: np.random.Generator, n: int) -> LensBatch:
        """Draw `n` lenses."""
        return _accepted(lambda count: self._candidates(rng, count), n)

    def log_density(self, vector: Float[ndarray, "n 9"]) -> Float[ndarray, " n"]:
        """Log density of camera vectors, up to a constant; −inf outside the support.

        Args:
            vector: (k1..k5, m_u, m_v, u0, v0) in half widths.
        """
        lens = gauged(vector)
        k1 = lens[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = lens[:, 1:5] / k1[:, None]
            weight, mean, sigma = self.tail
            value = np.logaddexp(
                np.log(1 - weight) + _log_gauss(ratios[:, 0], 0.0, self.ratio_sigma[0]),
                np.log(weight) + _log_gauss(ratios[:, 0], mean, sigma),
            )
            for i in (1, 2, 3):
                value = value + _log_gauss(ratios[:, i], 0.0, self.ratio_sigma[i])
            value = value - 4 * np.log(np.abs(k1))
        for column, centre in ((6, 1.0), (7, 0.0), (8, 0.0)):
            value = value + _log_gauss(lens[:, column], centre, self.slack)
        inside = (k1 >= self.k1[0]) & (k1 <= self.k1[1]) & self._is_supported(lens[:, :5])
        return np.where(inside, value, -np.inf)

    def _candidates(self, rng: np.random.Generator, n: int) -> LensBatch:
        k1 = rng.uniform(*self.k1, n)
        weight, mean, sigma = self.tail
        is_tail = rng.random(n) < weight
        k2 = np.where(is_tail, rng.normal(mean, sigma, n), rng.normal(0, self.ratio_sigma[0], n))
        rest = rng.normal(0, 1, (n, 3)) * self.ratio_sigma[1:]
        k = k1[:, None] * np.concatenate([np.ones((n, 1)), k2[:, None], rest], axis=1)
        vector = np.concatenate([k, np.tile([1.0, 1.0, 0.0, 0.0], (n, 1))], axis=1)
        circle, height = np.full(n, np.inf), np.ones(n)
        lenses = LensBatch(vector, frame_theta_max(vector, circle, height), circle, height)
        return lenses[self._is_supported(k)]

    def _is_supported(self, k: ndarray) -> ndarray:
        edge = first_angle(k, np.ones(len(k)))
        with np.errstate(invalid="ignore"):
            return (edge >= self.edge[0]) & (edge <= self.edge[1])


@dataclass(frozen=True)
class Frame:
    """How a lens's image lies in the square frame.

    Attributes:
        rho: Image radius at which the field of the shape ends: one value or a range (uniform).
        is_circle: Whether the picture ends there (image circle) or the sensor cuts it before.
        half_height: Half height of the visible rectangle.
    """

    rho: tuple[float, float]
    is_circle: bool
    half_height: float

    def nodes(self, count: int = 9) -> ndarray:
        """Values of ρ that stand for the range, for integrating it out."""
        low, high = self.rho
        return (
            np.array([low])
            if low == high
            else low + (high - low) * (np.arange(count) + 0.5) / count
        )


def _full(aspect: float) -> Frame:
    """Square cut out of a sensor of that aspect, lens filling the sensor's corners."""
    rho = float(np.hypot(1.0, aspect))
    return Frame((rho, rho), False, 1.0)


def _letterbox(aspect: float) -> Frame:
    """Whole sensor of that aspect in a square frame with bars."""
    rho = float(np.hypot(1.0, 1.0 / aspect))
    return Frame((rho, rho), False, 1.0 / aspect)


FITTED_FRAMES = (
    (0.25, _full(16 / 9)),
    (0.2, _full(4 / 3)),
    (0.05, _full(1.0)),
    (0.25, _letterbox(16 / 9)),
    (0.2, _letterbox(4 / 3)),
    (0.05, _letterbox(3 / 2)),
)
STANDARD_FRAMES = (
    (0.12, _full(1.0), (1.25, 0.2)),
    (0.12, _full(4 / 3), (1.3, 0.2)),
    (0.12, _letterbox(4 / 3), (1.25, 0.22)),
    (0.08, _letterbox(16 / 9), (1.25, 0.22)),
    (0.22, Frame((0.72, 1.0), True, 1.0), (1.62, 0.11)),
    (0.14, Frame((1.0, 1.35), True, 1.0), (1.6, 0.13)),
    (0.12, Frame((0.78, 1.2), True, 0.75), (1.6, 0.13)),
    (0.08, Frame((0.7, 1.15), True, 0.5625), (1.58, 0.13)),
)
"""Weight, frame, mean and standard deviation of Θ in radians."""

FISHEYE_FRAMES = (
    (0.16, Frame((0.75, 1.25), True, 0.75), (1.62, 0.12)),
    (0.08, Frame((0.75, 1.2), True, 0.8), (1.62, 0.12)),
    (0.08, Frame((0.8, 1.3), True, 0.94), (1.62, 0.12)),
    (0.1, Frame((0.7, 1.2), True, 2 / 3), (1.62, 0.12)),
    (0.1, Frame((0.65, 1.2), True, 0.625), (1.62, 0.12)),
    (0.12, Frame((0.65, 1.2), True, 0.5625), (1.62, 0.12)),
    (0.1, Frame((0.7, 1.0), True, 1.0), (1.62, 0.12)),
    (0.08, Frame((1.0, 1.4), True, 1.0), (1.62, 0.12)),
    (0.08, _full(1.0), (1.5, 0.15)),
    (0.05, _letterbox(4 / 3), (1.5, 0.15)),
    (0.05, _letterbox(16 / 9), (1.5, 0.15)),
)
"""The same for the prior `fisheye`."""

PROJECTIONS: dict[str, Callable[[ndarray], ndarray]] = {
    "equidistant": lambda theta: theta,
    "equisolid": lambda theta: 2.0 * np.sin(theta / 2.0),
    "stereographic": lambda theta: 2.0 * np.tan(theta / 2.0),
    "orthographic-like": lambda theta: np.sin(theta / 2.0) + 0.5 * np.sin(theta),
}


@dataclass(frozen=True)
class WildPrior:
    """Real wide lenses: a fitted mixture and perturbed standard projections.

    Attributes:
        name: "wild".
        fitted_share: Weight of the mixture fitted to calibrated lenses.
        standard_frames: Frames and fields of the standard projections.
        projection_weights: Weights of the standard projections, in the order of `PROJECTIONS`.
        bend_sigma: Standard deviations of the perturbation a q² + b q⁴ of l(q), q = θ / Θ.
        field: Smallest and largest Θ in radians.
        wide_share: Weight of the wide part of the jitters.
        least_jitter: Least standard deviation of principal point and aspect.
        centre_factor: Widening of the principal point's wide part over the fitted lenses, which
            are action cameras and better centred than others.
        aspect_factor: The same for the aspect.
    """

    name: str = "wild"
    fitted_share: float = 0.42
    standard_frames: tuple[tuple[float, Frame, tuple[float, float]], ...] = STANDARD_FRAMES
    projection_weights: tuple[float, ...] = (0.35, 0.3, 0.15, 0.2)
    bend_sigma: tuple[float, float] = (0.05, 0.03)
    field: tuple[float, float] = (np.radians(42.0), np.radians(112.0))
    wide_share: float = 0.3
    least_jitter: float = 0.002
    centre_factor: float = 1.5
    aspect_factor: float = 4.0

    def sample(self, rng: np.random.Generator, n: int) -> LensBatch:
        """Draw `n` lenses."""
        return _accepted(lambda count: self._candidates(rng, count), n)

    def log_density(self, vector: Float[ndarray, "n 9"]) -> Float[ndarray, " n"]:
        """Log density of camera vectors, up to a constant; −inf outside the support.

        The frame is not known from a vector, so the end of the field ρ is integrated out.

        Args:
            vector: (k1..k5, m_u, m_v, u0, v0) in half widths.
        """
        lens = gauged(vector)
        parts = []
        for weight, frame, field in self._frames():
            for rho in frame.nodes():
                shape, log_volume = shapes(lens[:, :5], np.full(len(lens), rho))
                share = np.log(weight / len(frame.nodes()))
                parts.append(share + self._log_shape(shape, field) + log_volume)
        value = np.logaddexp.reduce(np.nan_to_num(parts, nan=-np.inf), axis=0)
        value = value + self._log_jitter(lens[:, 6] - 1.0, *self._aspect_sigma())
        for column in (7, 8):
            value = value + self._log_jitter(lens[:, column], *self._centre_sigma())
        return value

    def _frames(self) -> list[tuple[float, Frame, tuple[float, float] | None]]:
        rest = 1.0 - self.fitted_share
        every = [
            *((self.fitted_share * weight, frame, None) for weight, frame in FITTED_FRAMES),
            *((rest * weight, frame, field) for weight, frame, field in self.standard_frames),
        ]
        return [(weight, frame, field) for weight, frame, field in every if weight > 0]

    def _candidates(self, rng: np.random.Generator, n: int) -> LensBatch:
        frames = self._frames()
        chosen = rng.choice(len(frames), n, p=_normalised([w for w, _, _ in frames]))
        batches = []
        for i, (_, frame, field) in enumerate(frames):
            count = int((chosen == i).sum())
            if count:
                batches.append(self._on_frame(rng, count, frame, field))
        lenses = concatenated(batches)
        return lenses[rng.permutation(len(lenses))]

    def _on_frame(
        self, rng: np.random.Generator, n: int, frame: Frame, field: tuple[float, float] | None
    ) -> LensBatch:
        shape = self._fitted_shapes(rng, n) if field is None else self._standard(rng, n, field)
        rho = (
            rng.uniform(*frame.rho, n) if frame.rho[0] < frame.rho[1] else np.full(n, frame.rho[0])
        )
        k = coefficients(shape, rho)
        aspect = 1.0 + self._jitter(rng, n, *self._aspect_sigma())
        centre = [self._jitter(rng, n, *self._centre_sigma()) for _ in range(2)]
        vector = np.concatenate([k, np.stack([np.ones(n), aspect, *centre], 1)], axis=1)
        circle = rho if frame.is_circle else np.full(n, np.inf)
        height = np.full(n, frame.half_height)
        inside = (shape[:, 0] >= self.field[0]) & (shape[:, 0] <= self.field[1])
        theta_max = frame_theta_max(vector, circle, height)
        needed = np.minimum(shape[:, 0], theta_max) if frame.is_circle else shape[:, 0]
        rises = _rises_until(k, needed)
        wide = theta_max >= self.field[0]
        return LensBatch(vector, theta_max, circle, height)[inside & rises & wide]

    def _fitted_shapes(self, rng: np.random.Generator, n: int) -> ndarray:
        weights, means, covariances = _fitted_mixture()
        chosen = rng.choice(len(weights), n, p=weights)
        factors = np.linalg.cholesky(covariances)
        return means[chosen] + np.einsum("nij,nj->ni", factors[chosen], rng.normal(size=(n, 5)))

    def _standard(self, rng: np.random.Generator, n: int, field: tuple[float, float]) -> ndarray:
        theta = np.clip(rng.normal(*field, n), 0.3, self.field[1])
        chosen = rng.choice(len(PROJECTIONS), n, p=_normalised(self.projection_weights))
        means = np.stack([_standard_logs(f, theta) for f in PROJECTIONS.values()])
        logs = means[chosen, np.arange(n)]
        factor = np.linalg.cholesky(self._bend_covariance())
        logs = logs + rng.normal(size=(n, len(KNOTS))) @ factor.T
        return np.concatenate([theta[:, None], logs], axis=1)

    def _bend_covariance(self) -> ndarray:
        basis = np.stack([KNOTS**2, KNOTS**4]) * np.array(self.bend_sigma)[:, None]
        return basis.T @ basis + np.diag(np.array([2e-4, 5e-4, 1e-3, 2e-3]) ** 2)

    def _log_shape(self, shape: ndarray, field: tuple[float, float] | None) -> ndarray:
        theta = shape[:, 0]
        if field is None:
            weights, means, covariances = _fitted_mixture()
            parts = log_normal(shape[:, None], means, covariances) + np.log(weights)
            value = np.logaddexp.reduce(np.nan_to_num(parts, nan=-np.inf), axis=1)
        else:
            parts = []
            for weight, f in zip(self.projection_weights, PROJECTIONS.values(), strict=True):
                off = shape[:, None, 1:] - _standard_logs(f, theta)[:, None]
                covariance = self._bend_covariance()[None]
                parts.append(np.log(weight) + log_normal(off, np.zeros((1, 4)), covariance)[:, 0])
            known = np.nan_to_num(parts, nan=-np.inf)
            value = np.logaddexp.reduce(known, axis=0) + _log_gauss(theta, *field)
        with np.errstate(invalid="ignore"):
            inside = (theta >= self.field[0]) & (theta <= self.field[1])
        return np.where(inside, value, -np.inf)

    def _centre_sigma(self) -> tuple[float, float]:
        low, high = _statistics()["centre_sigma"]
        return max(low, self.least_jitter), max(high * self.centre_factor, self.least_jitter)

    def _aspect_sigma(self) -> tuple[float, float]:
        low, high = _statistics()["aspect_sigma"]
        return max(low, self.least_jitter), max(high * self.aspect_factor, self.least_jitter)

    def _jitter(self, rng: np.random.Generator, n: int, narrow: float, wide: float) -> ndarray:
        return rng.normal(size=n) * np.where(rng.random(n) < self.wide_share, wide, narrow)

    def _log_jitter(self, value: ndarray, narrow: float, wide: float) -> ndarray:
        return np.logaddexp(
            np.log(1 - self.wide_share) + _log_gauss(value, 0.0, narrow),
            np.log(self.wide_share) + _log_gauss(value, 0.0, wide),
        )


def fisheye_prior() -> WildPrior:
    """Lenses of about 180°, nearly equidistant as most that are calibrated.

    Their centres are as loose as those of cheap cameras.
    """
    return WildPrior(
        name="fisheye",
        fitted_share=0.0,
        standard_frames=FISHEYE_FRAMES,
        projection_weights=(0.55, 0.18, 0.2, 0.07),
        centre_factor=2.0,
    )


def _accepted(candidates: Callable[[int], LensBatch], n: int) -> LensBatch:
    """Collect candidates until there are `n`."""
    batches, have = [], 0
    while not batches or have < n:
        batches.append(candidates(_OVERSAMPLING * n + 8))
        have += len(batches[-1])
    return concatenated(batches)[:n]


def _rises_until(k: ndarray, theta: ndarray) -> ndarray:
    """True where r(θ) rises clearly up to the angle."""
    angles = theta[:, None] * np.linspace(0.0, 1.0, 41)
    least = slope(angles, k).min(axis=1)
    return (least > _SMALLEST_RELATIVE_SLOPE * k[:, 0]) & (monotone_limit(k) >= theta - 0.01)


def _standard_logs(projection: Callable[[ndarray], ndarray], theta: ndarray) -> ndarray:
    angles = theta[:, None] * KNOTS
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.log(projection(angles) / angles)


def _log_gauss(x: ndarray, mean: float, sigma: float) -> ndarray:
    return -0.5 * ((x - mean) / sigma) ** 2 - np.log(sigma * np.sqrt(2 * np.pi))


def _normalised(weights: list[float] | tuple[float, ...]) -> ndarray:
    return np.array(weights) / np.sum(weights)


@cache
def _statistics() -> dict:
    return json.loads(Path(__file__).with_name("wild_prior.json").read_text())


@cache
def _fitted_mixture() -> tuple[ndarray, ndarray, ndarray]:
    stored = _statistics()
    weights = _normalised(stored["weights"])
    return weights, np.array(stored["means"]), np.array(stored["covariances"])

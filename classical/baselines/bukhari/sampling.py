"""Distortion from the circles of a few arcs, by random sampling over arcs.

A straight line under x_u = c + (x − c) / (1 + λ r²) is seen as a circle, and c has the same power
1 / λ with respect to all of these: A (x0² + y0² − 1/λ) + B x0 + C y0 + D = 0, which is linear in
z = x0² + y0² − 1/λ, x0 and y0 (Bukhari & Dailey, JMIV 2013).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from classical.baselines.bukhari.arcs import Arc
from classical.baselines.bukhari.config import BukhariConfig

_CHUNK = 1 << 19  # point positions worked on together


@dataclass(frozen=True)
class Frame:
    """Coordinates in which the numbers are near one: about the picture's middle, in half-diagonals.

    Attributes:
        middle: Middle of the picture, px.
        unit: Half the diagonal, px.
        half_size: Half width and half height in units.
    """

    middle: Float[np.ndarray, " 2"]
    unit: float
    half_size: Float[np.ndarray, " 2"]

    @classmethod
    def of_picture(cls, width: int, height: int) -> Frame:
        """The frame of a picture of this size."""
        unit = float(np.hypot(width, height)) / 2
        return cls(
            np.array([width - 1.0, height - 1.0]) / 2, unit, np.array([width, height]) / 2 / unit
        )

    def circles(self, arcs: list[Arc]) -> Float[np.ndarray, "m 4"]:
        """Circles of the arcs in these coordinates, scaled to B² + C² − 4 A D = 1."""
        a, b, c, d = np.array([arc.circle for arc in arcs]).reshape(-1, 4).T
        u, v = self.middle
        return np.stack(
            [
                a * self.unit,
                b + 2 * a * u,
                c + 2 * a * v,
                (d + b * u + c * v + a * (u * u + v * v)) / self.unit,
            ],
            axis=1,
        )


def hypotheses(
    circles: Float[np.ndarray, "m 4"],
    frame: Frame,
    *,
    config: BukhariConfig,
    rng: np.random.Generator,
) -> Float[np.ndarray, "h 3"]:
    """Plausible (λ, x0, y0): from triples of arcs, or from single arcs if the centre is fixed."""
    if config.centre == "fixed":
        a, d = circles[:, 0], circles[:, 3]
        usable = np.abs(d) > 1e-6
        lambdas = a[usable] / d[usable]  # λ = A / P(c), at c = 0
        found = np.stack([lambdas, np.zeros_like(lambdas), np.zeros_like(lambdas)], axis=1)
    else:
        picks = rng.integers(0, len(circles), (config.triples, 3))
        distinct = (picks[:, 0] != picks[:, 1]) & (picks[:, 1] != picks[:, 2])
        picks = picks[distinct & (picks[:, 0] != picks[:, 2])]
        triples = circles[picks]
        sound = np.abs(np.linalg.det(triples[:, :, :3])) > 1e-9
        triples = triples[sound]
        solved = np.linalg.solve(triples[:, :, :3], -triples[:, :, 3:])[:, :, 0]
        found = from_power(solved)
    return found[is_plausible(found, frame)]


def from_power(solved: Float[np.ndarray, "h 3"]) -> Float[np.ndarray, "h 3"]:
    """(λ, x0, y0) of (z, x0, y0)."""
    z, x0, y0 = solved.T
    power = x0**2 + y0**2 - z
    power = np.where(np.abs(power) > 1e-12, power, 1e-12)
    return np.stack([1 / power, x0, y0], axis=1)


def is_plausible(found: Float[np.ndarray, "h 3"], frame: Frame) -> Bool[np.ndarray, " h"]:
    """Whether the centre lies in the picture and 1 + λ r² is positive in all of it."""
    centre = np.abs(found[:, 1:])
    inside = (centre <= frame.half_size).all(axis=1)
    farthest = ((centre + frame.half_size) ** 2).sum(axis=1)
    return np.asarray(inside & (1 + found[:, 0] * farthest > 1e-3))


def sample_points(arcs: list[Arc], frame: Frame, count: int) -> Float[np.ndarray, "m k 2"]:
    """Points spread along each arc, in the coordinates of the frame."""
    picks = [arc.points[np.linspace(0, len(arc.points) - 1, count).astype(int)] for arc in arcs]
    return (np.array(picks).reshape(-1, count, 2) - frame.middle) / frame.unit


def straightness(
    found: Float[np.ndarray, "h 3"], samples: Float[np.ndarray, "m k 2"], frame: Frame
) -> Float[np.ndarray, "h m"]:
    """Root mean square distance of each undistorted arc to its line, px.

    It is divided by the magnification of the arc (the ratio of its chords), so that a model that
    shrinks everything gains nothing.
    """
    out = np.empty((len(found), len(samples)))
    step = max(_CHUNK // samples[..., 0].size, 1)
    chord = np.linalg.norm(samples[:, -1] - samples[:, 0], axis=1)
    for start in range(0, len(found), step):
        part = found[start : start + step]
        offset = samples[None] - part[:, None, None, 1:]
        factor = 1 + part[:, None, None, 0] * (offset**2).sum(axis=-1)
        moved = offset / np.maximum(factor, 1e-6)[..., None]
        grown = np.linalg.norm(moved[:, :, -1] - moved[:, :, 0], axis=-1)
        moved = moved - moved.mean(axis=2, keepdims=True)
        xx, yy = (moved**2).mean(axis=2).transpose(2, 0, 1)
        xy = (moved[..., 0] * moved[..., 1]).mean(axis=2)
        least = np.maximum(0.5 * (xx + yy - np.hypot(xx - yy, 2 * xy)), 0.0)
        out[start : start + step] = np.sqrt(least) * chord / np.maximum(grown, 1e-12)
    return out * frame.unit


def best_hypothesis(
    found: Float[np.ndarray, "h 3"],
    samples: Float[np.ndarray, "m k 2"],
    lengths: Float[np.ndarray, " m"],
    frame: Frame,
    *,
    config: BukhariConfig,
) -> tuple[Float[np.ndarray, " 3"], Bool[np.ndarray, " m"]]:
    """The hypothesis under which the greatest length of arcs is straight, and these arcs."""
    straight = straightness(found, samples, frame) < config.straight_distance
    best = int(np.argmax(straight @ lengths))
    return found[best], np.asarray(straight[best])


def refit(
    circles: Float[np.ndarray, "m 4"],
    lengths: Float[np.ndarray, " m"],
    frame: Frame,
    *,
    config: BukhariConfig,
) -> Float[np.ndarray, " 3"] | None:
    """(λ, x0, y0) from all these circles by least squares, weighted by length; None if unsound."""
    weights = lengths[:, None]
    if config.centre == "fixed":
        # Σ w² (D λ − A)² over the arcs
        a, d = circles[:, 0] * lengths, circles[:, 3] * lengths
        if not (d @ d) > 0:
            return None
        found = np.array([[(a @ d) / (d @ d), 0.0, 0.0]])
    else:
        solved = np.linalg.lstsq(circles[:, :3] * weights, -circles[:, 3:] * weights, rcond=None)[0]
        found = from_power(solved[:, 0][None])
    return found[0] if is_plausible(found, frame)[0] else None

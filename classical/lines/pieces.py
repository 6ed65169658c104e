"""Pieces of points, one after another in one array: their ranges, lengths and polynomials.

A piece is fitted by low-order polynomials u(s), v(s) in its arc length. All pieces are fitted at
once: sums over pieces are taken by `np.add.reduceat` over rows of all points, one row a power of s,
and what is known of pieces is spread over their points by `np.repeat`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from jaxtyping import Float, Int
from numpy.polynomial import legendre

_REGULARISATION = 1e-9  # of Legendre coefficients; pieces of coinciding points need it


@dataclass(frozen=True, eq=False)
class ArcFit:
    """Polynomials through pieces of points; each quantity is worked out when it is asked for.

    Attributes:
        offsets: Piece p has the points offsets[p] to offsets[p + 1], shape (p + 1,).
    """

    offsets: Int[np.ndarray, " p1"]
    _parts: list[_Part]

    @cached_property
    def distance(self) -> Float[np.ndarray, " m"]:
        """Signed distance of each point across its polynomial."""
        return self._of_points(lambda fit: fit.distance)

    @cached_property
    def tangents(self) -> Float[np.ndarray, "m 2"]:
        """Unit tangents of the polynomial."""
        return self._of_points(lambda fit: fit.tangents).T

    @cached_property
    def curvature(self) -> Float[np.ndarray, " m"]:
        """Signed curvature of the polynomial, 1 / pixels."""
        return self._of_points(lambda fit: fit.curvature)

    @cached_property
    def spacing(self) -> Float[np.ndarray, " p"]:
        """Arc length that each point of a piece stands for, pixels."""
        return self._of_pieces(lambda fit: fit.spacing)

    @cached_property
    def rms(self) -> Float[np.ndarray, " p"]:
        """Root mean square distance of each piece."""
        return self._of_pieces(lambda fit: fit.rms)

    @cached_property
    def largest(self) -> Float[np.ndarray, " p"]:
        """Largest distance of each piece."""
        return self._of_pieces(lambda fit: fit.largest)

    @property
    def end_tangents(self) -> tuple[Float[np.ndarray, "p 2"], Float[np.ndarray, "p 2"]]:
        """Unit tangents at the first and at the last point of each piece."""
        first = self._of_pieces(lambda fit: fit.tangents_at(-1.0))
        last = self._of_pieces(lambda fit: fit.tangents_at(1.0))
        return first.T, last.T

    def _of_points(self, quantity: Callable[[_Polynomials], np.ndarray]) -> np.ndarray:
        return _gathered([(part.points, quantity(part.fit)) for part in self._parts])

    def _of_pieces(self, quantity: Callable[[_Polynomials], np.ndarray]) -> np.ndarray:
        return _gathered([(part.pieces, quantity(part.fit)) for part in self._parts])


@dataclass(frozen=True, eq=False)
class _Part:
    """Pieces fitted by polynomials of one degree, and which points and pieces these are."""

    fit: _Polynomials
    points: np.ndarray
    pieces: np.ndarray


@dataclass(frozen=True, eq=False)
class _Polynomials:
    """Polynomials of one degree; arrays have the points or pieces along their last axis."""

    offsets: np.ndarray
    centred: np.ndarray  # (2, m) points off the mean of their piece
    local: np.ndarray  # (m,) arc length, from -1 to 1 along each piece
    coefficients: np.ndarray  # (degree + 1, 2, p) of the powers of it
    spacing: np.ndarray  # (p,)

    @cached_property
    def _lengths(self) -> np.ndarray:
        return np.diff(self.offsets)

    @cached_property
    def _at_points(self) -> tuple[np.ndarray, np.ndarray]:
        """Values and derivatives (2, m) of the polynomials, both by one Horner scheme."""
        *lower, highest = self.coefficients
        slope = np.repeat(highest, self._lengths, axis=1)
        value = slope * self.local
        value += np.repeat(lower.pop(), self._lengths, axis=1)
        while lower:
            slope *= self.local
            slope += value
            value *= self.local
            value += np.repeat(lower.pop(), self._lengths, axis=1)
        return value, slope

    @cached_property
    def _speed(self) -> np.ndarray:
        return np.maximum(_length(self._at_points[1]), 1e-9)

    @cached_property
    def distance(self) -> np.ndarray:
        value, slope = self._at_points
        gap = self.centred - value
        return _cross(slope, gap) / self._speed

    @property
    def tangents(self) -> np.ndarray:
        return self._at_points[1] / self._speed

    @property
    def curvature(self) -> np.ndarray:
        powers = np.arange(2, len(self.coefficients))
        coefficients = (powers * (powers - 1))[:, None, None] * self.coefficients[2:]
        if not len(coefficients):
            return np.zeros(len(self.local))
        second = np.repeat(coefficients[-1], self._lengths, axis=1)
        for lower in coefficients[-2::-1]:
            second *= self.local
            second += np.repeat(lower, self._lengths, axis=1)
        return _cross(self._at_points[1], second) / (self._speed * self._speed * self._speed)

    @property
    def rms(self) -> np.ndarray:
        squares = np.add.reduceat(self.distance * self.distance, self.offsets[:-1])
        return np.sqrt(squares / np.maximum(self._lengths - len(self.coefficients), 1))

    @property
    def largest(self) -> np.ndarray:
        return np.maximum.reduceat(np.abs(self.distance), self.offsets[:-1])

    def tangents_at(self, local: float) -> np.ndarray:
        """Unit tangents (2, p) at one place along the pieces."""
        powers = np.arange(1, len(self.coefficients))
        weights = powers * local ** (powers - 1)
        slope = (weights[:, None, None] * self.coefficients[1:]).sum(axis=0)
        return slope / np.maximum(_length(slope), 1e-9)


def fit_arcs(
    points: Float[np.ndarray, "m 2"], offsets: Int[np.ndarray, " p1"], *, degree: int
) -> ArcFit:
    """Fit each piece by a polynomial in its arc length, all at once.

    Args:
        points: Points in order along pieces of at least degree + 1 points, shape (m, 2).
        offsets: Piece p is points[offsets[p] : offsets[p + 1]], shape (p + 1,).
        degree: Degree of the polynomials u(s), v(s), at least 1.
    """
    everything = _Part(
        _fitted(points, offsets, degree), np.arange(len(points)), np.arange(len(offsets) - 1)
    )
    return ArcFit(offsets, [everything])


def fit_by_length(points: Float[np.ndarray, "m 2"], offsets: Int[np.ndarray, " p1"]) -> ArcFit:
    """Fit each piece by the polynomial that its number of points allows; see `fit_arcs`."""
    degrees = polynomial_degrees(np.diff(offsets))
    parts = []
    for degree in np.unique(degrees).tolist():
        pieces = np.flatnonzero(degrees == degree)
        selected, local = gather_ranges(offsets[pieces], offsets[pieces + 1])
        parts.append(_Part(_fitted(points.take(selected, axis=0), local, degree), selected, pieces))
    return ArcFit(offsets, parts)


def polynomial_degrees(lengths: np.ndarray) -> np.ndarray:
    """Degree of the polynomial for pieces of so many points."""
    return np.where(lengths < 24, 2, np.where(lengths < 120, 3, 5))


def arc_length(points: np.ndarray, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Arc length from the start of each piece at each point, and of each piece as a whole."""
    u, v = points.T
    running = np.zeros(len(points))
    running[1:] = _length((u[1:] - u[:-1], v[1:] - v[:-1]))
    running[offsets[:-1]] = 0.0
    np.cumsum(running, out=running)
    position = running - np.repeat(running[offsets[:-1]], offsets[1:] - offsets[:-1])
    return position, position[offsets[1:] - 1]


def gather_ranges(starts: np.ndarray, stops: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of all ranges one after another, and the offsets of the ranges in them."""
    lengths = stops - starts
    offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    selected = np.arange(offsets[-1]) + np.repeat(starts - offsets[:-1], lengths)
    return selected, offsets


def ranked(
    values: Float[np.ndarray, " m"], offsets: Int[np.ndarray, " p1"], rank: Int[np.ndarray, " p"]
) -> Float[np.ndarray, " p"]:
    """The value of each piece that so many of its values come before when they are sorted."""
    ranges = zip(offsets[:-1].tolist(), offsets[1:].tolist(), rank.tolist(), strict=True)
    return np.array([np.partition(values[a:b], k)[k] for a, b, k in ranges])


def _fitted(points: np.ndarray, offsets: np.ndarray, degree: int) -> _Polynomials:
    """Least squares by the normal equations, in powers of the arc length."""
    first, lengths = offsets[:-1], np.diff(offsets)
    centred = np.array(points.T, order="C")
    position, total = arc_length(centred.T, offsets)
    local = position * np.repeat(2 / np.maximum(total, 1e-9), lengths)
    local -= 1.0
    centred -= np.repeat(np.add.reduceat(centred, first, axis=1) / lengths, lengths, axis=1)
    sums = np.empty((2 * degree + 1, len(first)))  # of the powers over each piece
    right = np.zeros((degree + 1, 2, len(first)))  # of power 0: centred points sum to zero
    sums[0] = lengths
    power = np.ones(len(local))
    for order in range(1, 2 * degree + 1):
        power *= local
        sums[order] = np.add.reduceat(power, first)
        if order <= degree:
            right[order] = np.add.reduceat(centred * power, first, axis=1)
    orders = np.arange(degree + 1)
    normal = sums[orders[:, None] + orders]
    normal += _penalty(degree)[:, :, None] * lengths
    spacing = total / np.maximum(lengths - 1, 1)
    return _Polynomials(offsets, centred, local, _solved(normal, right), spacing)


@cache
def _penalty(degree: int) -> np.ndarray:
    """The sum of squared Legendre coefficients as a form of those of the powers."""
    legendre_of_powers = np.array(
        [
            np.pad(legendre.poly2leg(np.eye(degree + 1)[order][: order + 1]), (0, degree - order))
            for order in range(degree + 1)
        ]
    )
    return _REGULARISATION * legendre_of_powers @ legendre_of_powers.T


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve many positive definite systems (n, n, p) for (n, k, p), in place, by elimination."""
    size = len(matrix)
    for pivot in range(size - 1):
        factor = matrix[pivot + 1 :, pivot] / matrix[pivot, pivot]
        matrix[pivot + 1 :, pivot + 1 :] -= factor[:, None] * matrix[pivot, pivot + 1 :]
        right[pivot + 1 :] -= factor[:, None] * right[pivot]
    for row in range(size - 1, -1, -1):
        right[row] /= matrix[row, row]
        right[:row] -= matrix[:row, row, None] * right[row]
    return right


def _gathered(parts: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """One array of what its parts hold at their places, along the last axis."""
    if len(parts) == 1:
        return parts[0][1]
    shape = parts[0][1].shape[:-1] if parts else ()
    out = np.zeros((*shape, sum(len(places) for places, _ in parts)))
    for places, values in parts:
        out[..., places] = values
    return out


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[0] * b[1] - a[1] * b[0]


def _length(vectors: np.ndarray | tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Lengths of vectors, by their two rows."""
    return np.sqrt(vectors[0] * vectors[0] + vectors[1] * vectors[1])

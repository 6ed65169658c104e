"""How far points lie from their lines under given distortion, fast enough for a refinement."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int


class LineEnergy:
    """Σ over lines Σ over points of the squared distance in the undistorted plane, px².

    The lines are fitted anew (total least squares) at each evaluation: only the distortion counts.
    """

    def __init__(self, points: Float[np.ndarray, "n 2"], labels: Int[np.ndarray, " n"]) -> None:
        """Keep the points that belong to a line, line after line.

        Args:
            points: Distorted edge points, px.
            labels: Line of each point, −1 for none.
        """
        order = np.argsort(labels, kind="stable")
        order = order[int((labels < 0).sum()) :]
        self.points = np.ascontiguousarray(points[order].T)
        grouped = labels[order]
        self.starts = np.flatnonzero(np.diff(grouped, prepend=-1))
        self.sizes = np.diff(np.append(self.starts, len(grouped))).astype(np.float64)
        self._products = np.empty((5, len(grouped)))

    def __len__(self) -> int:
        return self.points.shape[1]

    def __call__(self, k1: float, k2: float, centre: tuple[float, float]) -> float:
        """The energy of x / (1 + k1 r² + k2 r⁴) about a centre; infinite where that breaks."""
        if not len(self):
            return 0.0
        x, y = self.points[0] - centre[0], self.points[1] - centre[1]
        squared = x * x + y * y
        factor = 1.0 + squared * (k1 + k2 * squared)
        if factor.min() <= 1e-9:
            return np.inf
        table = self._products
        np.divide(1.0, factor, out=factor)
        np.multiply(x, factor, out=table[0])
        np.multiply(y, factor, out=table[1])
        np.multiply(table[0], table[0], out=table[2])
        np.multiply(table[0], table[1], out=table[3])
        np.multiply(table[1], table[1], out=table[4])
        sums = np.add.reduceat(table, self.starts, axis=1)
        xx = sums[2] - sums[0] ** 2 / self.sizes
        xy = sums[3] - sums[0] * sums[1] / self.sizes
        yy = sums[4] - sums[1] ** 2 / self.sizes
        return float(np.maximum(0.5 * (xx + yy - np.hypot(xx - yy, 2 * xy)), 0.0).sum())

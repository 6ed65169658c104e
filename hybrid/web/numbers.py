"""The lens in numbers with their standard deviations, and how far to trust it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from classical.camera import KannalaBrandt
from hybrid.result import Calibration


@dataclass(frozen=True)
class Number:
    """A figure of the lens.

    Attributes:
        name: What it is, in OpenCV's terms where there are such.
        value: The figure.
        deviation: Its standard deviation; None where the method does not say.
        unit: "px", "°" or nothing.
    """

    name: str
    value: float
    deviation: float | None = None
    unit: str = ""

    def text(self) -> str:
        """The value, rounded to what its deviation tells."""
        digits = 5 if self.unit == "" else 1
        if self.deviation is not None and self.deviation > 0:
            digits = max(0, min(6, 1 - math.floor(math.log10(self.deviation))))
        value = round(self.value, digits) + 0.0  # no negative zero
        return f"{value:.{digits}f}".replace("-", "−") + self._suffix()

    def deviation_text(self) -> str:
        """The deviation with two figures, or a dash where it is not known."""
        if self.deviation is None:
            return "–"
        if self.deviation < 5e-7:
            return "exact"
        digits = max(0, min(6, 1 - math.floor(math.log10(self.deviation))))
        return f"± {self.deviation:.{digits}f}{self._suffix()}"

    def _suffix(self) -> str:
        return {"": "", "°": "°"}.get(self.unit, f" {self.unit}")


def lens_numbers(camera: KannalaBrandt, covariance: Float[np.ndarray, "9 9"]) -> list[Number]:
    """Field of view, K and D of `cv2.fisheye`, with deviations to first order.

    Args:
        camera: The lens.
        covariance: Of its vector, shape (9, 9); all zero means that it is not known.
    """
    known = bool(covariance.any())
    K, D = camera.to_opencv()
    names = ["fx", "fy", "cx", "cy", *(f"D{i}" for i in range(1, 5))]
    values = [K[0, 0], K[1, 1], K[0, 2], K[1, 2], *D]
    units = ["px"] * 4 + [""] * 4
    deviations = _deviations(_opencv_jacobian(camera), covariance)
    view, gradient, seen = _view_across(camera)
    numbers = [
        Number(name, float(value), float(deviation) if known else None, unit)
        for name, value, deviation, unit in zip(names, values, deviations, units, strict=True)
    ]
    if seen:
        spread = float(_deviations(gradient[None], covariance)[0]) if known else None
        numbers.insert(0, Number("field of view across", view, spread, "°"))
    return numbers


def trust_lines(found: Calibration) -> list[tuple[str, str]]:
    """What tells how far to trust the lens: pairs of a name and words."""
    quality = found.quality
    lines = []
    if quality.n_curves:
        lines.append(("straight curves", f"{quality.n_inliers} of {quality.n_curves}"))
    if math.isfinite(quality.rms_px):
        lines.append(("off straight", f"{quality.rms_px:.2f} px rms"))
    if math.isfinite(quality.predicted_error_px):
        lines.append(("expected error", f"{quality.predicted_error_px:.1f} px of a 320 px frame"))
    if quality.scale_source:
        spread = quality.scale_deviation
        surely = (
            f", ±\N{NO-BREAK SPACE}{100 * spread:.0f}\N{NO-BREAK SPACE}%"
            if math.isfinite(spread)
            else ""
        )
        lines.append(("focal length from", quality.scale_source + surely))
    return lines


def _opencv_jacobian(camera: KannalaBrandt) -> Float[np.ndarray, "8 9"]:
    """∂(fx, fy, cx, cy, D1..D4) / ∂(k1..k5, m_u, m_v, u0, v0)."""
    k1 = camera.k[0]
    jacobian = np.zeros((8, 9))
    jacobian[0, [0, 5]] = camera.m_u, k1
    jacobian[1, [0, 6]] = camera.m_v, k1
    jacobian[2, 7] = jacobian[3, 8] = 1.0
    jacobian[4:, 0] = -camera.k[1:] / k1**2
    jacobian[[4, 5, 6, 7], [1, 2, 3, 4]] = 1 / k1
    return jacobian


def _deviations(
    jacobian: Float[np.ndarray, "n 9"], covariance: Float[np.ndarray, "9 9"]
) -> Float[np.ndarray, " n"]:
    return np.sqrt(np.maximum(np.sum((jacobian @ covariance) * jacobian, axis=1), 0.0))


def _view_across(camera: KannalaBrandt) -> tuple[float, Float[np.ndarray, " 9"], bool]:
    """Degrees between the middles of left and right edge, their gradient, whether both are seen."""
    edges = np.array([[-0.5, camera.v0], [camera.width - 0.5, camera.v0]])
    jacobian = camera.unproject_jacobian(edges)
    x, z = jacobian.rays[:, 0], jacobian.rays[:, 2]
    sign = np.array([-1.0, 1.0])  # of x at the left and the right edge
    view = float(np.degrees(np.sum(np.arctan2(sign * x, z))))
    by_x, by_z = sign * z, -sign * x
    gradient = np.sum(
        by_x[:, None] * jacobian.by_parameters[:, 0] + by_z[:, None] * jacobian.by_parameters[:, 2],
        axis=0,
    )
    return view, np.degrees(gradient), bool(jacobian.valid.all())

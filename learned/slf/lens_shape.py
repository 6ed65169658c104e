"""Lenses described by their field and the shape of their curve, and back to coefficients.

A lens that reaches radius ρ at angle Θ is written x = (Θ, l1, l2, l3, l4), where
l_j = log(r(q_j Θ) / (k1 q_j Θ)) says how far the curve has left the equidistant line at the share
q_j of the field. Real lenses form compact clouds in x, whereas raw coefficients k_i trade off
against each other over orders of magnitude.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray

KNOTS = np.array([0.4, 0.65, 0.85, 1.0])
_POWERS = np.array([1, 3, 5, 7, 9])
_ANGLE_NODES = 361
_LARGEST_ANGLE = np.pi


def radius(theta: Float[ndarray, "#n m"], k: Float[ndarray, "n 5"]) -> Float[ndarray, "n m"]:
    """r(θ) = Σ k_i θ^(2i−1), one lens a row."""
    return _even_series(theta, k) * theta


def slope(theta: Float[ndarray, "#n m"], k: Float[ndarray, "n 5"]) -> Float[ndarray, "n m"]:
    """dr/dθ, one lens a row."""
    return _even_series(theta, k * _POWERS)


def _even_series(theta: ndarray, k: ndarray) -> ndarray:
    """Σ k_i θ^(2i−2) by Horner's rule."""
    square = theta * theta
    value = square * k[:, 4:5]
    for i in (3, 2, 1):
        value = (value + k[:, i : i + 1]) * square
    return value + k[:, :1]


def coefficients(shape: Float[ndarray, "n 5"], rho: Float[ndarray, " n"]) -> Float[ndarray, "n 5"]:
    """Coefficients k1..k5 of lenses given by their shape.

    Args:
        shape: (Θ in radians, l1..l4) per lens.
        rho: Image radius at Θ, in the unit wanted for k.

    Returns:
        The polynomial through the four knots; exact, because r / (k1 θ) − 1 has four terms.
    """
    field, logs = shape[:, 0], shape[:, 1:]
    angles = field[:, None] * KNOTS
    basis = angles[..., None] ** np.array([2, 4, 6, 8])
    ratios = np.linalg.solve(basis, np.expm1(logs)[..., None])[..., 0]
    k1 = rho / (field * np.exp(logs[:, 3]))
    return k1[:, None] * np.concatenate([np.ones((len(k1), 1)), ratios], axis=1)


def shapes(
    k: Float[ndarray, "n 5"], rho: Float[ndarray, " n"]
) -> tuple[Float[ndarray, "n 5"], Float[ndarray, " n"]]:
    """Shape of lenses given by their coefficients; the inverse of `coefficients`.

    Args:
        k: Coefficients, in the unit of `rho`.
        rho: Image radius at which the field ends.

    Returns:
        shape: (Θ, l1..l4) per lens; NaN where the rising branch never reaches `rho`.
        log_volume: log |∂shape / ∂k|, for changing variables of a density.
    """
    field = first_angle(k, rho)
    angles = field[:, None] * KNOTS
    r, dr = radius(angles, k), slope(angles, k)
    with np.errstate(invalid="ignore", divide="ignore"):
        logs = np.log(r / (k[:, :1] * angles))
        field_by_k = -(field[:, None] ** _POWERS) / dr[:, 3:]
        by_k = angles[..., None] ** _POWERS / r[..., None]
        by_k[:, :, 0] -= 1.0 / k[:, :1]
        by_field = dr * KNOTS / r - 1.0 / field[:, None]
        by_k = by_k + by_field[..., None] * field_by_k[:, None, :]
    jacobian = np.concatenate([field_by_k[:, None, :], by_k], axis=1)
    jacobian[~np.isfinite(jacobian).all(axis=(1, 2))] = np.eye(5)
    return np.concatenate([field[:, None], logs], axis=1), np.linalg.slogdet(jacobian)[1]


def monotone_limit(k: Float[ndarray, "n 5"]) -> Float[ndarray, " n"]:
    """Largest angle up to which r rises, to half a degree, at most π."""
    theta = np.linspace(0.0, _LARGEST_ANGLE, _ANGLE_NODES)
    falls = slope(theta[None], k) <= 0.0
    first = np.where(falls.any(axis=1), falls.argmax(axis=1), len(theta)) - 1
    return theta[np.maximum(first, 0)]


def first_angle(k: Float[ndarray, "n 5"], rho: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
    """Angle at which the rising branch reaches `rho`; NaN where it never does."""
    theta = np.linspace(0.0, _LARGEST_ANGLE, _ANGLE_NODES)
    r = radius(theta[None], k)
    rising = theta <= monotone_limit(k)[:, None]
    reached = (r >= rho[:, None]) & rising
    first = np.maximum(reached.argmax(axis=1), 1)
    rows = np.arange(len(k))
    angle = theta[first - 1] + (theta[1] - theta[0]) * np.clip(
        (rho - r[rows, first - 1]) / np.maximum(r[rows, first] - r[rows, first - 1], 1e-12), 0, 1
    )
    for _ in range(2):
        rise = slope(angle[:, None], k)[:, 0]
        angle = angle - (radius(angle[:, None], k)[:, 0] - rho) / np.maximum(rise, 1e-9)
    return np.where(reached.any(axis=1), angle, np.nan)

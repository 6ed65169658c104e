"""The Kannala–Brandt polynomial in torch, for batches of lenses.

r(θ) = Σ k_i θ^(2i−1), i = 1..5 (Kannala & Brandt, PAMI 2006, eq. 6). Every function takes one lens
per batch row, works on any device and precision, and is differentiable in its arguments.
"""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

N_TERMS = 5
_LIMIT_NODES = 361
_INVERSE_NODES = 193
_NEWTON_STEPS = 3
_SMALLEST_SLOPE = 1e-6


def radius(theta: Float[Tensor, "b ..."], k: Float[Tensor, "b 5"]) -> Float[Tensor, "b ..."]:
    """Image radius of rays at angle `theta` from the axis.

    Args:
        theta: Incident angles in radians, one row of any shape per lens.
        k: Coefficients k1..k5 per lens; the unit of the result is theirs (half image widths).

    Returns:
        r(θ), shape of `theta`.
    """
    square = theta * theta
    value = _column(k, 4, theta)
    for i in (3, 2, 1, 0):
        value = value * square + _column(k, i, theta)
    return value * theta


def radius_derivative(
    theta: Float[Tensor, "b ..."], k: Float[Tensor, "b 5"]
) -> Float[Tensor, "b ..."]:
    """Derivative dr/dθ = Σ (2i − 1) k_i θ^(2i−2).

    Args:
        theta: Incident angles in radians, one row of any shape per lens.
        k: Coefficients k1..k5 per lens.

    Returns:
        dr/dθ in units of k per radian, shape of `theta`.
    """
    square = theta * theta
    value = 9.0 * _column(k, 4, theta)
    for i in (3, 2, 1, 0):
        value = value * square + (2 * i + 1) * _column(k, i, theta)
    return value


def monotone_limit(k: Float[Tensor, "b 5"], *, upper: float = math.pi) -> Float[Tensor, " b"]:
    """Largest angle up to which r(θ) rises strictly, at most `upper`.

    The first sign change of dr/dθ on a grid of half a degree, refined by a secant step.

    Args:
        k: Coefficients k1..k5 per lens.
        upper: Largest angle looked at, in radians.

    Returns:
        The angle in radians per lens; 0 where r falls from the start.
    """
    nodes = torch.linspace(0.0, upper, _LIMIT_NODES, dtype=k.dtype, device=k.device)
    slope = radius_derivative(nodes.expand(k.shape[0], -1), k.detach())
    falls = slope <= 0.0
    first = torch.argmax(falls.to(torch.int8), dim=1)
    before = (first - 1).clamp_min(0)
    low, high = (
        slope.gather(1, before[:, None])[:, 0],
        slope.gather(1, first[:, None])[:, 0],
    )
    share = low / (low - high).clamp_min(1e-12)
    crossing = nodes[before] + share.clamp(0.0, 1.0) * (nodes[first] - nodes[before])
    return torch.where(falls.any(dim=1), crossing, torch.full_like(crossing, upper))


def theta_from_radius(
    r: Float[Tensor, "b ..."],
    k: Float[Tensor, "b 5"],
    theta_max: Float[Tensor, " b"],
) -> tuple[Float[Tensor, "b ..."], Bool[Tensor, "b ..."]]:
    """Invert r(θ) on [0, `theta_max`]; the inverse of `radius`.

    A table of the rising branch gives the bracket, Newton steps kept inside it give the root. The
    last step alone is recorded for autograd: with dr/dθ held constant it has the exact derivative
    of the implicit function with respect to both r and k.

    Args:
        r: Image radii in units of k, one row of any shape per lens, not negative.
        k: Coefficients k1..k5 per lens.
        theta_max: Largest angle per lens, within `monotone_limit`.

    Returns:
        theta: Angles in radians, shape of `r`; `theta_max` beyond the image circle.
        valid: True where the radius lies inside the image circle, shape of `r`.
    """
    shape = r.shape
    flat = r.reshape(shape[0], -1)
    with torch.no_grad():
        start, low, high, edge = _bracket(flat, k, theta_max)
        root = start
        for _ in range(_NEWTON_STEPS):
            slope = radius_derivative(root, k).clamp_min(_SMALLEST_SLOPE)
            root = root - (radius(root, k) - flat) / slope
            root = torch.minimum(torch.maximum(root, low), high)
        slope = radius_derivative(root, k).clamp_min(_SMALLEST_SLOPE)
        valid = flat <= edge
    theta = root - torch.where(valid, radius(root, k) - flat, torch.zeros_like(flat)) / slope
    return theta.reshape(shape), valid.reshape(shape)


def _bracket(r: Tensor, k: Tensor, theta_max: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Start angle, lower and upper bound for each radius, and the circle's radius per lens."""
    unit = torch.linspace(0.0, 1.0, _INVERSE_NODES, dtype=r.dtype, device=r.device)
    nodes = theta_max.detach().to(r.dtype)[:, None] * unit
    table = torch.cummax(radius(nodes, k), dim=1).values.contiguous()
    edge = table[:, -1:]
    right = torch.searchsorted(table, torch.minimum(r, edge).contiguous())
    right = right.clamp(1, _INVERSE_NODES - 1)
    low, high = nodes.gather(1, right - 1), nodes.gather(1, right)
    r_low, r_high = table.gather(1, right - 1), table.gather(1, right)
    share = ((r - r_low) / (r_high - r_low).clamp_min(1e-12)).clamp(0.0, 1.0)
    return low + share * (high - low), low, high, edge


def _column(k: Tensor, i: int, like: Tensor) -> Tensor:
    """Coefficient i per lens, shaped to broadcast against rows of angles."""
    return k[:, i].reshape(-1, *([1] * (like.ndim - 1)))

"""Robust nonlinear least squares with a Gaussian prior, on SciPy's trust-region solver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

_IMPOSSIBLE = 1e3  # residual of a parameter vector that is no camera; such a step is rejected
Residuals = Callable[[np.ndarray], np.ndarray]


class Solution(NamedTuple):
    """Where the solver stopped.

    Attributes:
        value: Parameters, shape (p,).
        converged: Whether a tolerance was met before the steps ran out.
        cost: Half the robust sum of squares, the prior's included.
        n_steps: Evaluations of the residuals.
        information: JᵀWJ at `value`, robust weights W and the prior included, shape (p, p).
    """

    value: Float[np.ndarray, " p"]
    converged: bool
    cost: float
    n_steps: int
    information: Float[np.ndarray, "p p"]


@dataclass(frozen=True)
class SolverConfig:
    """When to stop, and what counts as an outlying residual.

    Attributes:
        loss_scale: Residuals beyond this many standard deviations lose weight (Cauchy).
        redundancy: So many residuals tell as much as one independent one: edges of one thing
            share their errors, so the data must not count each of them against the prior.
        tolerance: Relative change of cost, parameters and gradient at which to stop.
        max_steps: Most evaluations.
    """

    loss_scale: float = 2.0
    redundancy: float = 4.0
    tolerance: float = 1e-4
    max_steps: int = 30


def solve(
    residuals: Residuals,
    jacobian: Residuals,
    start: Float[np.ndarray, " p"],
    *,
    config: SolverConfig = SolverConfig(),
) -> Solution:
    """Minimise Σ ρ(residuals(z)²) / redundancy + |z|² from `start`.

    Args:
        residuals: z to residuals in standard deviations, shape (n,), with one n for all z; raises
            ValueError where z means nothing.
        jacobian: z to ∂residuals/∂z, shape (n, p).
        start: First z, shape (p,), where the residuals exist; z ~ N(0, I) is the prior.
        config: When to stop.

    Returns:
        The solution; a step that raises the cost is never taken.
    """
    n, p = len(residuals(start)), len(start)

    def with_prior(z: np.ndarray) -> np.ndarray:
        try:
            return np.concatenate([residuals(z), z])
        except ValueError:
            return np.full(n + p, _IMPOSSIBLE)

    def with_prior_jacobian(z: np.ndarray) -> np.ndarray:
        return np.concatenate([jacobian(z), np.eye(p)])

    def loss(squared: np.ndarray) -> np.ndarray:
        rho = np.stack([squared, np.ones(n + p), np.zeros(n + p)])
        ratio = 1 + squared[:n] / config.loss_scale**2
        rho[:, :n] = (
            config.loss_scale**2 * np.log(ratio),
            1 / ratio,
            -1 / (config.loss_scale * ratio) ** 2,
        )
        rho[:, :n] /= config.redundancy
        return rho

    result = least_squares(
        with_prior,
        start,
        jac=with_prior_jacobian,  # pyright: ignore[reportArgumentType]
        loss=loss,  # pyright: ignore[reportArgumentType]
        ftol=config.tolerance,
        xtol=config.tolerance,
        gtol=config.tolerance * 1e-3,
        max_nfev=config.max_steps,
    )
    final = with_prior(result.x)
    weights = loss(final**2)[1]
    J = with_prior_jacobian(result.x)
    information = J.T @ (J * weights[:, None])
    return Solution(result.x, result.status > 0, result.cost, result.nfev, information)

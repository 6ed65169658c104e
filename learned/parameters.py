"""Coordinates in which the lens is regressed.

k1..k5 of real lenses are so strongly correlated that an error of 10 % in one, made good by the
others, moves no pixel. `Parameters` holds an affine map k = mean + factor · z: the identity for the
paper's preset (regression of k in half widths), a whitening of the training prior for the compact
one, where z has unit covariance and its first five values stand for k1..k5 as before.
"""

from __future__ import annotations

from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

N_PARAMETERS = 9
# the gauge m_u = 1 is not estimated
FREE = (0, 1, 2, 3, 4, 6, 7, 8)
N_FREE = len(FREE)
_MEAN = (1.2, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0)
_SMALLEST_SPREAD = 1e-3


class Parameters(nn.Module):
    """The affine map between z and k; buffers, so it travels with the weights."""

    mean: Tensor
    factor: Tensor
    inverse: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("mean", torch.tensor(_MEAN))
        self.register_buffer("factor", torch.eye(N_PARAMETERS))
        self.register_buffer("inverse", torch.eye(N_PARAMETERS))

    @torch.no_grad()
    def whiten(self, samples: Float[Tensor, "n 9"]) -> None:
        """Set the map so that `samples` of k have zero mean and unit covariance in z.

        k1..k5 are whitened together (lower Cholesky factor, so z1 is k1 up to scale); the others
        one by one, with a smallest spread of 0.001 half widths, which the gauge m_u = 1 meets.
        """
        exact = samples.double()
        mean = exact.mean(0)
        centred = exact - mean
        factor = torch.diag(exact.std(0).clamp_min(_SMALLEST_SPREAD))
        block = centred[:, :5].T @ centred[:, :5] / len(exact)
        ridge = 1e-9 * torch.eye(5, dtype=torch.float64)
        factor[:5, :5] = torch.linalg.cholesky(block + ridge)
        self.mean.copy_(mean)
        self.factor.copy_(factor)
        self.inverse.copy_(torch.linalg.inv(factor))

    def decode(self, z: Float[Tensor, "b 9"]) -> Float[Tensor, "b 9"]:
        """Coordinates to k; m_u is its gauge value."""
        with torch.autocast(z.device.type, enabled=False):  # eight bits of k are too few
            k = self.mean + z.float() @ self.factor.T
        return torch.cat([k[:, :5], self.mean[5].expand(k.shape[0], 1), k[:, 6:]], 1)

    def encode(self, k: Float[Tensor, "b 9"]) -> Float[Tensor, "b 9"]:
        """K to coordinates; the inverse of `decode` in the gauge."""
        return (k - self.mean) @ self.inverse.T

    def covariance(self, cholesky: Float[Tensor, "b 8 8"]) -> Float[Tensor, "b 9 9"]:
        """Covariance of k from the factor of the precision of the free coordinates."""
        exact = cholesky.double()
        small = torch.cholesky_inverse(exact)
        free = torch.tensor(FREE, device=cholesky.device)
        factor = self.factor.double()[:, free]
        spread = factor @ small @ factor.T
        return cast(Tensor, 0.5 * (spread + spread.transpose(1, 2)))

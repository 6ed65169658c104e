"""What the data engine hands to a network."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class SlfBatch:
    """Samples of synthetic line-rich fisheye pictures.

    Attributes:
        image: RGB in [0, 1].
        line_map: min(length, 255) / 255 of a bent line within 1 px of it, else 0; the length is the
            visible bent length in pixels of `image` (paper, line map with clipped lengths).
        k: (k1..k5, m_u, m_v, u0, v0) in half image widths: m / (W/2) and
            (u0 − (W−1)/2) / (W/2), (v0 − (H−1)/2) / (W/2); the gauge is m_u / (W/2) = 1.
        rectified: The clean fisheye picture rectified with `k`: pinhole f = W/2, principal point at
            the centre, black where the fisheye picture has nothing; or an integral factor smaller.
        theta_max: Largest incident angle that the lens images, in radians.
        seen: What line perception sees in the picture, lineness and heatmap, where it is known
            beforehand.
    """

    image: Float[Tensor, "b 3 h w"]
    line_map: Float[Tensor, "b 1 h w"]
    k: Float[Tensor, "b 9"]
    rectified: Float[Tensor, "b 3 hr wr"]
    theta_max: Float[Tensor, " b"]
    seen: Float[Tensor, "b 2 h w"] | None = None

    def __len__(self) -> int:
        """Number of samples."""
        return self.image.shape[0]

    def to(self, device: torch.device | str, *, non_blocking: bool = False) -> "SlfBatch":
        """The same batch on another device."""
        there = {n: v for n, v in vars(self).items() if v is not None}
        return SlfBatch(**{n: v.to(device, non_blocking=non_blocking) for n, v in there.items()})

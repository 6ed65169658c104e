"""Use every synthesised batch several times, mirrored: half of a CPU's time is making data."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from learned.slf.batch import SlfBatch

_MIRRORS = (
    (),
    (3,),
    (2, 3),
    (2,),
)  # none, left-right, half turn, top-bottom (dimensions of b c h w)


def mirrored(batch: SlfBatch, dims: tuple[int, ...]) -> SlfBatch:
    """The batch with its pictures flipped along `dims` (2: top-bottom, 3: left-right).

    A flip of a frame centred on (0, 0) turns the sign of the principal point; the rest of the lens
    is radial and stays.
    """
    sign = torch.ones_like(batch.k)
    sign[:, 7] = -1.0 if 3 in dims else 1.0
    sign[:, 8] = -1.0 if 2 in dims else 1.0

    def flip(picture: Tensor) -> Tensor:
        return picture.flip(dims) if dims else picture

    return SlfBatch(
        image=flip(batch.image),
        line_map=flip(batch.line_map),
        k=batch.k * sign,
        rectified=flip(batch.rectified),
        theta_max=batch.theta_max,
    )


class Echoed:
    """A source of batches that gives each batch of another source `times` times, mirrored.

    Batch i still depends on i only.

    Args:
        source: Makes batch i from its number.
        times: 1 to 4.
    """

    def __init__(self, source: Callable[[int], SlfBatch], times: int) -> None:
        if not 1 <= times <= len(_MIRRORS):
            raise ValueError(f"expected 1 to {len(_MIRRORS)} echoes, got {times}")
        self.source = source
        self.times = times
        self._last: tuple[int, SlfBatch] | None = None

    def __call__(self, number: int) -> SlfBatch:
        """Batch `number`."""
        origin, echo = divmod(number, self.times)
        if self._last is None or self._last[0] != origin:
            self._last = (origin, self.source(origin))
        return mirrored(self._last[1], _MIRRORS[echo])

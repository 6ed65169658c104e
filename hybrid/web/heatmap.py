"""Where the network sees lines, for the methods that ask it."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8

if TYPE_CHECKING:
    from learned.predictor import Predictor

_ASK_THE_NETWORK = ("hybrid", "learned")


def heatmap_of(
    preview: UInt8[np.ndarray, "h w 3"], method: str
) -> Float[np.ndarray, "rows columns"] | None:
    """How sure the network is of a line at each place, 0 to 1; None if the method asks no network.

    Args:
        preview: The picture, of any size.
        method: A name of `hybrid.methods`.
    """
    if method not in _ASK_THE_NETWORK:
        return None
    return _predictor().lines(preview).lineness


@lru_cache(maxsize=1)
def _predictor() -> Predictor:
    from learned.predictor import Predictor  # torch loads here, not with the page

    return Predictor.from_weights()

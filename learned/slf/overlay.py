"""Text burnt into pictures: dates, times and counters as cameras and recorders write them."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

# 5x7 dot-matrix digits and marks, one hexadecimal row of five bits per scan line
_GLYPHS = {
    "0": (0x0E, 0x11, 0x13, 0x15, 0x19, 0x11, 0x0E),
    "1": (0x04, 0x0C, 0x04, 0x04, 0x04, 0x04, 0x0E),
    "2": (0x0E, 0x11, 0x01, 0x02, 0x04, 0x08, 0x1F),
    "3": (0x1F, 0x02, 0x04, 0x02, 0x01, 0x11, 0x0E),
    "4": (0x02, 0x06, 0x0A, 0x12, 0x1F, 0x02, 0x02),
    "5": (0x1F, 0x10, 0x1E, 0x01, 0x01, 0x11, 0x0E),
    "6": (0x06, 0x08, 0x10, 0x1E, 0x11, 0x11, 0x0E),
    "7": (0x1F, 0x01, 0x02, 0x04, 0x08, 0x08, 0x08),
    "8": (0x0E, 0x11, 0x11, 0x0E, 0x11, 0x11, 0x0E),
    "9": (0x0E, 0x11, 0x11, 0x0F, 0x01, 0x02, 0x0C),
    ":": (0x00, 0x0C, 0x0C, 0x00, 0x0C, 0x0C, 0x00),
    "-": (0x00, 0x00, 0x00, 0x1F, 0x00, 0x00, 0x00),
    "/": (0x01, 0x01, 0x02, 0x04, 0x08, 0x10, 0x10),
    "C": (0x0E, 0x11, 0x10, 0x10, 0x10, 0x11, 0x0E),
    "A": (0x0E, 0x11, 0x11, 0x1F, 0x11, 0x11, 0x11),
    "M": (0x11, 0x1B, 0x15, 0x15, 0x11, 0x11, 0x11),
    "H": (0x11, 0x11, 0x11, 0x1F, 0x11, 0x11, 0x11),
    "R": (0x1E, 0x11, 0x11, 0x1E, 0x14, 0x12, 0x11),
    "E": (0x1F, 0x10, 0x10, 0x1E, 0x10, 0x10, 0x1F),
    " ": (0x00,) * 7,
}


def draw_overlays(
    image: Float[Tensor, "b 3 h w"], rng: np.random.Generator, *, share: float
) -> Float[Tensor, "b 3 h w"]:
    """Burn a line of text into some of the pictures.

    Args:
        image: Pictures in [0, 1]; changed in place.
        rng: Source of randomness.
        share: Share of pictures with text.
    """
    height, width = image.shape[2:]
    for row in np.nonzero(rng.random(len(image)) < share)[0]:
        text = text_bitmap(_caption(rng), scale=int(rng.integers(1, 3)))[:height, :width]
        top = int(rng.integers(0, height - text.shape[0] + 1))
        if rng.random() < 0.8:
            top = int(rng.choice([4, max(4, height - text.shape[0] - 4)]))
        top = max(0, min(top, height - text.shape[0]))
        left = int(rng.integers(0, width - text.shape[1] + 1))
        ink = torch.as_tensor(text, device=image.device)
        value = float(rng.choice([0.0, 0.85, 1.0], p=[0.15, 0.35, 0.5]))
        image[row, :, top : top + text.shape[0], left : left + text.shape[1]].masked_fill_(
            ink, value
        )
    return image


def text_bitmap(text: str, *, scale: int) -> np.ndarray:
    """Text as a boolean picture, letters five by seven dots of `scale` pixels."""
    bits = np.array(
        [[[row >> b & 1 for b in (4, 3, 2, 1, 0, 7)] for row in _GLYPHS[c]] for c in text]
    )
    flat = bits.transpose(1, 0, 2).reshape(7, -1).astype(bool)
    return flat.repeat(scale, 0).repeat(scale, 1)


def _caption(rng: np.random.Generator) -> str:
    d = rng.integers(0, 10, 14)
    date = f"20{d[0] % 3}{d[1]}-{d[2] % 2}{d[3]}-{d[4] % 3}{d[5]}"
    time = f"{d[6] % 2}{d[7]}:{d[8] % 6}{d[9]}:{d[10] % 6}{d[11]}"
    forms = (f"{date} {time}", time, f"CAM {d[12]}{d[13]}", f"REC {time}", f"CH{d[12]} {date}")
    return forms[int(rng.integers(0, len(forms)))]

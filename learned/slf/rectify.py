"""The rectified ground truth: a clean fisheye picture seen through the protocol's pinhole."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from learned.polynomial import radius
from learned.slf.optics import Optics


def rectified(image: Float[Tensor, "b 3 h w"], lens: Optics) -> Float[Tensor, "b 3 h w"]:
    """Rectify with the true lens: pinhole f = W/2, principal point at the centre, black outside.

    Args:
        image: Clean fisheye pictures.
        lens: Their lenses.
    """
    size = lens.size
    index = torch.arange(size, dtype=image.dtype, device=image.device)
    plane = (index - (size - 1) / 2) / (size / 2)
    x, y = plane[None, None, :], plane[None, :, None]
    across = torch.sqrt(x * x + y * y)
    theta = torch.atan(across).expand(len(lens), -1, -1)
    scale = radius(theta, lens.vector[:, :5]) / across.clamp_min(1e-9)
    view = (-1, 1, 1)
    u = scale * x * lens.vector[:, 5].view(view) + lens.vector[:, 7].view(view)
    v = scale * y * lens.vector[:, 6].view(view) + lens.vector[:, 8].view(view)
    # in half widths the frame's pixels span [−1, 1]: grid_sample without aligned corners
    out = functional.grid_sample(image, torch.stack([u, v], -1), align_corners=False)
    return out * (theta <= lens.theta_max.view(view))[:, None]

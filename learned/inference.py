"""Networks as they are run: batch norms folded into convolutions."""

from __future__ import annotations

from copy import deepcopy
from itertools import pairwise
from typing import TypeVar

from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_weights

from learned.pyramid import PyramidBranch, PyramidResidual

Network = TypeVar("Network", bound=nn.Module)


def folded(network: Network) -> Network:
    """A copy for inference that gives the same to the rounding of a float, and sooner.

    After training a batch norm is a scale and a shift of each channel, which the convolution before
    it can hold (Jacob et al., CVPR 2018, section 3.2): one pass over memory less for each.

    Args:
        network: Of convolutions and batch norms in sequence, and pyramid residual modules; it is
            not changed.

    Returns:
        In evaluation mode, identities in place of batch norms; not to be trained or saved.
    """
    copy = deepcopy(network).eval()
    for module in list(copy.modules()):
        if isinstance(module, PyramidResidual):
            _fold_pyramid(module)
        elif isinstance(module, nn.Sequential):
            _fold_sequence(module)
    return copy


def _fold_sequence(layers: nn.Sequential) -> None:
    for i, (conv, norm) in enumerate(pairwise(list(layers))):
        if isinstance(conv, nn.Conv2d | nn.ConvTranspose2d) and isinstance(norm, nn.BatchNorm2d):
            _fold(conv, norm)
            layers[i + 1] = nn.Identity()


def _fold_pyramid(module: PyramidResidual) -> None:
    """The norm of a sum: each summand is scaled, and one of them takes the shift."""
    norm, last = module.merge[0], module.norm
    assert isinstance(norm, nn.BatchNorm2d)
    assert isinstance(last, nn.BatchNorm2d)
    _fold(module.main, norm)
    for branch in module.branches:
        assert isinstance(branch, PyramidBranch)
        _fold(branch.widen, norm)
        branch.widen.bias = None
    module.merge[0] = nn.Identity()
    _fold(module.expand, last)
    module.norm = nn.Identity()


def _fold(conv: nn.Conv2d | nn.ConvTranspose2d, norm: nn.BatchNorm2d) -> None:
    assert norm.running_mean is not None
    assert norm.running_var is not None
    conv.weight, conv.bias = fuse_conv_bn_weights(
        conv.weight,
        conv.bias,
        norm.running_mean,
        norm.running_var,
        norm.eps,
        norm.weight,
        norm.bias,
        transpose=isinstance(conv, nn.ConvTranspose2d),
    )

"""The losses of LaRecNet and, where stated, our own variants that train faster.

Xue et al., "Loss Functions and Uncertainty Regularizer"; the equations are named by their labels.
All losses are means over the batch.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

OMEGA = (0.1, 0.1, 0.5, 1.0, 1.0, 0.1, 0.1, 0.1, 0.1)
_SMALLEST_SQUARE = 1e-8  # half widths squared: a distance of zero has a gradient, too
# black borders have no error: unclamped, U_A falls to 0 there and drowns every other gradient
_SMALLEST_UNCERTAINTY = 0.1


@dataclass(frozen=True)
class LossCfg:
    """Every constant of the phase-two loss; the defaults are the paper's.

    Attributes:
        para: λ_para of Eq. loss.
        geo: λ_geo of Eq. loss (the ablation without L_geo sets 0).
        geo_scale: L_geo of a picture counts as s·log(1 + L_geo / s) with this s in half widths
            (ours; 0 = as it is, the paper).
        shape: Weight of the shape loss (ours; 0 = none). The scale of a picture is often nowhere
            in it, and its error drowns in L_geo what lines do tell.
        shape_scale: s of the shape loss, as `geo_scale` of L_geo.
        projection: Weight of the projection loss (ours; 0 = none). On the rectified plane nothing
            is told of a lens beyond some 65°, and a field of view taken for too wide costs more
            than one taken for too narrow; on the fisheye picture neither is so.
        projection_scale: s of the projection loss, as `geo_scale` of L_geo.
        pix: λ_pix of Eq. loss (the ablation without L_pix sets 0).
        fused: λ_fus of Eq. p_loss.
        glob: λ_glo of Eq. p_loss.
        local: λ_loc of Eq. p_loss.
        omega: ω of Eq. global, for k1..k5, m_u, m_v, u0, v0.
        line_weight: λ_m of L_geo.
        nll: Weight of the negative log-likelihood of the covariance head (ours; 0 = none).
        huber: Error from which the parameter losses grow linearly (ours; 0 = never, the paper).
            Whitened coordinates have heavy tails, and one odd lens must not rule a batch.
    """

    para: float = 1.0
    geo: float = 100.0
    geo_scale: float = 0.0
    shape: float = 0.0
    shape_scale: float = 0.0
    projection: float = 0.0
    projection_scale: float = 0.0
    pix: float = 1.0
    fused: float = 2.0
    glob: float = 1.0
    local: float = 1.0
    omega: tuple[float, ...] = OMEGA
    line_weight: float = 2.0
    nll: float = 0.0
    huber: float = 0.0


def line_loss(
    predicted: Float[Tensor, "b 1 h w"],
    target: Float[Tensor, "b 1 h w"],
    *,
    positive: Bool[Tensor, "b 1 h w"] | None = None,
    reduce: bool = True,
) -> Float[Tensor, ""]:
    """L_line, Eq. line_loss: squared errors, each side weighted by the other side's share.

    Args:
        predicted: Heatmap L̂_f.
        target: Heatmap L_f.
        positive: Ω⁺, by default where `target` > 0.
        reduce: Divide by |Ω|. The paper's sum grows with the picture; its learning rate of 0.001
            only makes sense with the mean.

    Returns:
        The loss, a mean over the batch.
    """
    positive = target > 0 if positive is None else positive
    error = (predicted - target).square().flatten(1)
    inside = positive.flatten(1).to(error.dtype)
    size = error.shape[1]
    share = inside.sum(1) / size
    loss = (1 - share) * (error * inside).sum(1) + share * (error * (1 - inside)).sum(1)
    return (loss / size if reduce else loss).mean()


def ridge_target(line_map: Float[Tensor, "b 1 h w"]) -> Float[Tensor, "b 1 h w"]:
    """Soft lineness: the three-pixel band of Eq. line-map, blurred by [1 2 1]/4 both ways.

    Its crest lies on the line with sub-pixel symmetry, which a flat band has not.
    """
    tap = torch.tensor([0.25, 0.5, 0.25], dtype=line_map.dtype, device=line_map.device)
    band = (line_map > 0).to(line_map.dtype)
    across = functional.conv2d(band, tap.view(1, 1, 1, 3), padding=(0, 1))
    return functional.conv2d(across, tap.view(1, 1, 3, 1), padding=(1, 0))


def lineness_loss(
    raw: Float[Tensor, "b 2 h w"],
    line_map: Float[Tensor, "b 1 h w"],
    *,
    line_weight: float = 4.0,
    length_weight: float = 1.0,
) -> Float[Tensor, ""]:
    """Our faster stand-in for L_line: cross entropy for line or not, l1 for the length.

    The paper's l2 on lengths hardly sees short lines and spends itself on the length of long ones.
    Cross entropy on the ridge localises first; the length is asked for on lines only.

    Args:
        raw: Logit of lineness and length / 255.
        line_map: Eq. line-map, min(length, 255) / 255.
        line_weight: Weight of a pixel on a line against one off any line.
        length_weight: Weight of the length term.

    Returns:
        The loss, a mean over the batch.
    """
    target = ridge_target(line_map)
    entropy = functional.binary_cross_entropy_with_logits(raw[:, :1], target, reduction="none")
    loss = (entropy * (1.0 + (line_weight - 1.0) * target)).mean()
    inside = (line_map > 0).to(raw.dtype)
    length = ((raw[:, 1:] - line_map).abs() * inside).sum() / inside.sum().clamp_min(1.0)
    return loss + length_weight * 0.2 * length


def parameter_loss(
    predicted: Float[Tensor, "b n"],
    target: Float[Tensor, "b n"],
    omega: Float[Tensor, " n"],
    *,
    huber: float = 0.0,
) -> Float[Tensor, ""]:
    """L_glo and L_fus, Eq. global: weighted squared error of the parameters, over n."""
    return _squared(omega * (predicted - target), huber).mean(1).mean()


def local_loss(
    predicted: Float[Tensor, "b 5 5"],
    target: Float[Tensor, "b 5"],
    omega: Float[Tensor, " 5"],
    *,
    huber: float = 0.0,
) -> Float[Tensor, ""]:
    """L_loc, Eq. local: the same over the five regions' k1..k5, divided by 25."""
    error = _squared(omega * (predicted - target[:, None]), huber)
    return error.sum((1, 2)).mean() / 25.0


def _squared(error: Tensor, huber: float) -> Tensor:
    """Squares, going on as a line from `huber`."""
    if huber == 0.0:
        return error.square()
    zero = torch.zeros_like(error)
    return 2.0 * functional.huber_loss(error, zero, reduction="none", delta=huber)


def geometric_loss(
    predicted: Float[Tensor, "b n 2"],
    target: Float[Tensor, "b n 2"],
    on_line: Bool[Tensor, "b n"],
    valid: Bool[Tensor, "b n"],
    *,
    line_weight: float,
    scale: float = 0.0,
) -> Float[Tensor, ""]:
    """L_geo over Eq. struct loss: l1 distance of rectified positions, lines counted λ_m times.

    Args:
        predicted: T⁻¹(p_f; k̂), in half widths.
        target: T⁻¹(p_f; k_G), in half widths.
        on_line: Ω⁺.
        valid: Pixels that count: inside both lenses' limit of angle.
        line_weight: λ_m.
        scale: s of `LossCfg.geo_scale`.

    Returns:
        The loss; the mean over pictures of the mean over all pixels of Ω that count.
    """
    weight = torch.where(on_line, line_weight, 1.0) * valid
    distance = (predicted - target).abs().sum(-1)
    each = (distance * weight).sum(1) / valid.sum(1).clamp_min(1)
    return _logarithmic(each, scale).mean()


def shape_loss(
    predicted: Float[Tensor, "b n 2"],
    target: Float[Tensor, "b n 2"],
    valid: Bool[Tensor, "b n"],
    *,
    scale: float = 0.0,
) -> Float[Tensor, ""]:
    """Our L_geo without what straight lines leave open: the mean of `aligned_distances`.

    Args:
        predicted: T⁻¹(p_f; k̂), in half widths.
        target: T⁻¹(p_f; k_G), in half widths.
        valid: Pixels that count.
        scale: s of `LossCfg.shape_scale`.
    """
    return _logarithmic(aligned_distances(predicted, target, valid), scale).mean()


def projection_loss(
    predicted: Float[Tensor, "b n 2"],
    target: Float[Tensor, "b n 2"],
    valid: Bool[Tensor, "b n"],
    *,
    scale: float = 0.0,
) -> Float[Tensor, ""]:
    """Ours: how far from its pixel k̂ images the true ray of a pixel, out to the rim.

    Args:
        predicted: Where k̂ images the rays, in half widths.
        target: The pixels, in half widths.
        valid: Pixels that count: those the picture shows.
        scale: s of `LossCfg.projection_scale`.
    """
    return _logarithmic(_mean_distances(predicted, target, valid), scale).mean()


def aligned_distances(
    predicted: Float[Tensor, "b n 2"], target: Float[Tensor, "b n 2"], valid: Bool[Tensor, "b n"]
) -> Float[Tensor, " b"]:
    """Mean distance per picture after the scale and shift of `predicted` that fit best.

    Both lenses look the same way up, so the best similarity of the aligned error needs no rotation.

    Args:
        predicted: Rectified positions, in any unit.
        target: True ones.
        valid: Points that count.
    """
    weight = valid.to(target.dtype)[..., None]
    count = weight.sum(1, keepdim=True).clamp_min(1.0)
    here, there = (
        (points - (points * weight).sum(1, keepdim=True) / count) * weight
        for points in (predicted, target)
    )
    scale = (here * there).sum((1, 2)) / here.square().sum((1, 2)).clamp_min(_SMALLEST_SQUARE)
    return _mean_distances(scale[:, None, None] * here, there, valid)


def _mean_distances(
    predicted: Float[Tensor, "b n 2"], target: Float[Tensor, "b n 2"], valid: Bool[Tensor, "b n"]
) -> Float[Tensor, " b"]:
    """Mean distance per picture of the points that count."""
    squares = (predicted - target).square().sum(-1)
    distance = (squares + _SMALLEST_SQUARE).sqrt() * valid
    return distance.sum(1) / valid.sum(1).clamp_min(1)


def _logarithmic(loss: Tensor, scale: float) -> Tensor:
    """Losses that count by their logarithm from about `scale` on; 0 leaves them as they are."""
    return scale * torch.log1p(loss / scale) if scale else loss


def pixel_loss(
    rectified: Float[Tensor, "b 3 h w"],
    target: Float[Tensor, "b 3 h w"],
    uncertainty: Float[Tensor, "b 1 h w"] | None,
) -> Float[Tensor, ""]:
    """L_pix with attentive uncertainty: |I_r − I_G| / U_A + log U_A, U_A clamped first."""
    error = (rectified - target).abs().mean(1, keepdim=True)
    if uncertainty is None:
        return error.mean()
    clamped = uncertainty.clamp_min(_SMALLEST_UNCERTAINTY)
    return (error / clamped + clamped.log()).mean()


def gaussian_nll(
    error: Float[Tensor, "b n"], cholesky: Float[Tensor, "b n n"]
) -> Float[Tensor, ""]:
    """Negative log-likelihood of `error` under covariance (L Lᵀ)⁻¹, without its constant.

    Args:
        error: Truth minus estimate, in whitened coordinates.
        cholesky: Lower factor L of the precision matrix, positive diagonal.

    Returns:
        The loss, a mean over batch and coordinates.
    """
    scaled = torch.einsum("bij,bi->bj", cholesky, error)
    log_diagonal = torch.diagonal(cholesky, dim1=1, dim2=2).log()
    return (0.5 * scaled.square() - log_diagonal).mean()

"""The phases of training: what each network's loss and report are on a batch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import UInt8
from numpy import ndarray
from torch import Tensor, nn
from torch.nn import functional

from learned.dlp import DlpCfg, DlpOutput, LinePerception
from learned.larecnet import LaRecNet, LarecnetOutput
from learned.losses import (
    LossCfg,
    aligned_distances,
    gaussian_nll,
    geometric_loss,
    line_loss,
    lineness_loss,
    local_loss,
    parameter_loss,
    pixel_loss,
    projection_loss,
    shape_loss,
)
from learned.parameters import FREE
from learned.presets import Preset
from learned.rectification import pixel_grid, rectify_images, reprojected, undistort
from learned.rong import RongNet, division_parameter
from learned.slf.batch import SlfBatch

_SIDE_WEIGHT = 0.5
# RPE is asked for up to 60 degrees; a little more, so that the edge of that disc is no edge here
_THETA_COUNTED = math.radians(65.0)
_THETA_RPE = math.radians(60.0)
_RPE_STRIDE = 4
_HALF_FRAME = 160.0  # pixels; errors are told in those of a frame of 320
# whitened errors beyond this are of lenses so odd that a Gaussian says nothing about them
_TAIL = 4.0
Report = tuple[dict[str, float], dict[str, UInt8[ndarray, "h w 3"]]]


class PerceptionPhase:
    """Phase one: line perception alone, with supervision at every stack."""

    def __init__(self, cfg: DlpCfg) -> None:
        self.cfg = cfg

    def loss(self, module: nn.Module, batch: SlfBatch) -> tuple[Tensor, dict[str, Tensor]]:
        """L_line at the head and, at half its weight, at the earlier stacks."""
        image = batch.image.contiguous(memory_format=torch.channels_last)
        out: DlpOutput = module(image)
        main = self._loss(out.raw, batch.line_map)
        side = [self._loss(raw, batch.line_map) for raw in out.side]
        total = main + _SIDE_WEIGHT * sum(side, torch.zeros_like(main))
        return total, {"line": main}

    def _loss(self, raw: Tensor, line_map: Tensor) -> Tensor:
        if raw.shape[-1] != line_map.shape[-1]:
            line_map = functional.max_pool2d(line_map, line_map.shape[-1] // raw.shape[-1])
        if self.cfg.target == "length":
            return line_loss(raw.float(), line_map)
        return lineness_loss(raw.float(), line_map)

    @torch.no_grad()
    def report(self, module: nn.Module, batches: Sequence[SlfBatch]) -> Report:
        """Precision, recall and F of detection (two pixels of slack), and a sheet of heatmaps."""
        assert isinstance(module, LinePerception)
        hits = np.zeros(4)
        total = 0.0
        rows = []
        for batch in batches:
            out = module(batch.image.contiguous(memory_format=torch.channels_last))
            sure = module.lineness(out.raw)
            total += float(self._loss(out.raw, batch.line_map)) / len(batches)
            hits += detection_counts(sure > 0.5, batch.line_map > 0)
            grey = [batch.line_map, sure, module.heatmap(out.raw)]
            rows.append(_columns([batch.image, *(g.expand(-1, 3, -1, -1) for g in grey)]))
        precision, recall = hits[0] / max(1.0, hits[1]), hits[2] / max(1.0, hits[3])
        f = 2 * precision * recall / max(1e-9, precision + recall)
        scalars = {"line": total, "precision": precision, "recall": recall, "f": f}
        return scalars, {"heatmaps": np.concatenate(rows[:4])}


class RectificationPhase:
    """Phase two: everything but line perception, by Eq. loss."""

    def __init__(self, preset: Preset) -> None:
        self.cfg: LossCfg = preset.loss
        self.stride = preset.geo_stride

    def loss(self, module: nn.Module, batch: SlfBatch) -> tuple[Tensor, dict[str, Tensor]]:
        """λ_para L_para + λ_geo L_geo + λ_pix L_pix; ours: shape, projection, spread."""
        image = batch.image.contiguous(memory_format=torch.channels_last)
        out: LarecnetOutput = module(image, seen=batch.seen, rectify=self.cfg.pix > 0)
        net = _inner(module)
        parts = {"para": self._parameters(net, out, batch)}
        total = self.cfg.para * parts["para"]
        if self.cfg.geo or self.cfg.shape or self.cfg.projection:
            geometry = self._geometry(out.k, batch)
            parts |= geometry
            total = total + sum(getattr(self.cfg, name) * part for name, part in geometry.items())
        if self.cfg.pix:
            parts["pix"] = self._pixels(out, batch, net.cfg.pixel_stride)
            total = total + self.cfg.pix * parts["pix"]
        if self.cfg.nll and out.estimate.cholesky is not None:
            truth = net.parameters_of_lens.encode(batch.k)
            error = (truth - out.estimate.fused.detach())[:, FREE].clamp(-_TAIL, _TAIL)
            parts["nll"] = gaussian_nll(error, out.estimate.cholesky)
            total = total + self.cfg.nll * parts["nll"]
        errors = reprojection_errors(out.k.detach(), batch)
        return total, parts | {"rpe": errors.rpe.mean(), "aligned": errors.aligned.mean()}

    def _parameters(self, net: LaRecNet, out: LarecnetOutput, batch: SlfBatch) -> Tensor:
        """L_para, Eq. p_loss, in the coordinates of the preset."""
        target = net.parameters_of_lens.encode(batch.k)
        omega = torch.tensor(self.cfg.omega, device=target.device)
        glob = parameter_loss(out.estimate.glob, target, omega, huber=self.cfg.huber)
        if out.estimate.local is None:
            return (self.cfg.fused + self.cfg.glob) * glob
        return (
            self.cfg.fused * parameter_loss(out.estimate.fused, target, omega, huber=self.cfg.huber)
            + self.cfg.glob * glob
            + self.cfg.local
            * local_loss(out.estimate.local, target[:, :5], omega[:5], huber=self.cfg.huber)
        )

    def _geometry(self, k: Tensor, batch: SlfBatch) -> dict[str, Tensor]:
        """Losses on every `stride`-th pixel, by weight; a cell with a line counts as Ω⁺."""
        height, width = batch.image.shape[-2:]
        points = pixel_grid(height, width, stride=self.stride, device=k.device)
        points = points.expand(len(k), -1, -1)
        target, theta = undistort(points, batch.k)
        predicted, _ = undistort(points, k)
        lines = (
            functional.max_pool2d(batch.line_map, self.stride)
            if self.stride > 1
            else batch.line_map
        )
        shown = theta <= batch.theta_max[:, None]
        valid = shown & (theta <= _THETA_COUNTED)
        geo = geometric_loss(
            predicted,
            target,
            lines.flatten(1) > 0,
            valid,
            line_weight=self.cfg.line_weight,
            scale=self.cfg.geo_scale,
        )
        return {
            "geo": geo,
            "shape": shape_loss(predicted, target, valid, scale=self.cfg.shape_scale),
            "projection": projection_loss(
                reprojected(points, theta, batch.k, k),
                points,
                shown,
                scale=self.cfg.projection_scale,
            ),
        }

    def _pixels(self, out: LarecnetOutput, batch: SlfBatch, stride: int) -> Tensor:
        assert out.rectified is not None
        target = batch.rectified
        if target.shape[-1] == batch.image.shape[-1] and stride > 1:
            target = functional.avg_pool2d(target, stride)
        return pixel_loss(out.rectified, target, out.uncertainty)

    @torch.no_grad()
    def report(self, module: nn.Module, batches: Sequence[SlfBatch]) -> Report:
        """Errors and PSNR of the rectified pictures, interval coverage, and a sheet."""
        net = _inner(module)
        errors, aligned, psnr, distances, rows = [], [], [], [], []
        for batch in batches:
            out: LarecnetOutput = net(batch.image.contiguous(memory_format=torch.channels_last))
            rectified = rectify_images(batch.image, out.k)
            each = reprojection_errors(out.k, batch)
            errors.append(each.rpe)
            aligned.append(each.aligned)
            mse = (rectified - batch.rectified).square().mean((1, 2, 3))
            psnr.append(-10.0 * torch.log10(mse.clamp_min(1e-10)))
            if out.estimate.cholesky is not None:
                truth = net.parameters_of_lens.encode(batch.k)
                error = (truth - out.estimate.fused)[:, FREE]
                scaled = torch.einsum("bij,bi->bj", out.estimate.cholesky, error)
                distances.append(scaled.square().sum(1))
            rows.append(_columns([batch.image, rectified, batch.rectified]))
        rpe = torch.cat(errors)
        scalars = {
            "rpe_mean": float(rpe.mean()),
            "rpe_median": float(rpe.median()),
            "aligned_median": float(torch.cat(aligned).median()),
            "psnr": float(torch.cat(psnr).mean()),
        }
        if distances:
            scalars["mahalanobis2_mean"] = float(torch.cat(distances).mean())
        return scalars, {"rectified": np.concatenate(rows[:3])}


class DivisionPhase:
    """The baseline of Rong et al.: cross entropy over the classes of λ."""

    def loss(self, module: nn.Module, batch: SlfBatch) -> tuple[Tensor, dict[str, Tensor]]:
        """Cross entropy against soft labels around the best division parameter of the lens."""
        logits = module(batch.image.contiguous(memory_format=torch.channels_last)).float()
        net = module if isinstance(module, RongNet) else module.module
        assert isinstance(net, RongNet)
        truth = division_parameter(batch.k)
        loss = -(net.labels(truth) * functional.log_softmax(logits, 1)).sum(1).mean()
        error = (net.estimate(logits.detach()) - truth).abs().mean()
        return loss, {"lambda_error": error}

    @torch.no_grad()
    def report(self, module: nn.Module, batches: Sequence[SlfBatch]) -> Report:
        """Mean absolute error of λ."""
        assert isinstance(module, RongNet)
        errors = [
            (module.estimate(module(b.image)) - division_parameter(b.k)).abs() for b in batches
        ]
        return {"lambda_error": float(torch.cat(errors).mean())}, {}


class Errors(NamedTuple):
    """Mean errors per picture in pixels of the 320 frame, over pixels up to 60 degrees.

    Attributes:
        rpe: Reprojection errors, shape (b,).
        aligned: What is left of them after the best scale and shift, shape (b,).
    """

    rpe: Tensor
    aligned: Tensor


def reprojection_errors(k: Tensor, batch: SlfBatch) -> Errors:
    """How far lenses k, shape (b, 9), are from those of the batch."""
    height, width = batch.image.shape[-2:]
    points = pixel_grid(height, width, stride=_RPE_STRIDE, device=k.device).expand(len(k), -1, -1)
    target, theta = undistort(points, batch.k)
    predicted, _ = undistort(points, k)
    valid = theta <= batch.theta_max.clamp(max=_THETA_RPE)[:, None]
    distance = (predicted - target).square().sum(-1).sqrt()
    rpe = (distance * valid).sum(1) / valid.sum(1).clamp_min(1)
    aligned = aligned_distances(predicted, target, valid)
    return Errors(rpe * _HALF_FRAME, aligned * _HALF_FRAME)


def _inner(module: nn.Module) -> LaRecNet:
    """The network inside what `accelerate` may have put around it."""
    net = module if isinstance(module, LaRecNet) else module.module
    assert isinstance(net, LaRecNet)
    return net


def _columns(rows: list[Tensor], *, limit: int = 4) -> ndarray:
    """Pictures side by side, one row per list entry, as 8-bit RGB."""
    strips = [torch.cat(list(row[:limit].float().cpu()), dim=2) for row in rows]
    picture = torch.cat(strips, dim=1).permute(1, 2, 0)  # h w 3
    return (picture.clamp(0, 1) * 255).round().to(torch.uint8).numpy()


def detection_counts(found: Tensor, true: Tensor, *, slack: int = 2) -> ndarray:
    """Counts for precision and recall: hits and size of `found`, then of `true`."""
    near_true = functional.max_pool2d(true.float(), 2 * slack + 1, 1, slack) > 0
    near_found = functional.max_pool2d(found.float(), 2 * slack + 1, 1, slack) > 0
    return np.array(
        [
            float((found & near_true).sum()),
            float(found.sum()),
            float((true & near_found).sum()),
            float(true.sum()),
        ]
    )

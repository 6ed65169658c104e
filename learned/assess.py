"""Figures for the model card, and the honesty of the predicted covariance."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from learned.dlp import LinePerception
from learned.larecnet import LaRecNet
from learned.letterbox import resized
from learned.mirror import mean_estimate
from learned.parameters import FREE
from learned.phases import detection_counts, reprojection_errors
from learned.rectification import rectify_images
from learned.rong import RongNet
from learned.slf.atlas import load_atlas
from learned.slf.batch import SlfBatch
from learned.slf.stream import SlfStream, StreamCfg
from learned.weights import save_weights

BATCH = 8
"""Samples a batch, here and in the reports of a training; samples depend on it."""

VALIDATION_SIZE = 320
"""Side of their frame in pixels, whatever the network's own."""

TEMPERATURE_BATCHES = 24
"""Batches by which the temperature is fitted."""

VALIDATIONS = {
    "D-Wireframe validation, prior paper, clean": StreamCfg(
        scenes=(1.0, 0.0, 0.0, 0.0), photometry=None
    ),
    "mixed validation, priors paper and wild, camera effects": StreamCfg(),
}
"""Samples that every LaRecNet is scored on, whatever it was trained on, by their name in cards."""

_NORMAL_90 = 1.6449  # half width of the 90 % interval of a normal, in standard deviations
_VALIDATION_SEED, _TEMPERATURE_SEED = 20_001, 777


@dataclass(frozen=True)
class Assessment:
    """What a LaRecNet does on samples with a known lens.

    Attributes:
        rpe: Mean RPE per sample, in pixels of the 320 frame, over θ ≤ 60°.
        aligned: The same after the best scale and shift.
        psnr: Of the rectified picture against the ground truth, per sample, black kept, in dB.
        scores: Errors of the free parameters over their predicted standard deviations; empty where
            the weights predict none.
        counts: Hits and sizes of detection; see `detection_counts`.
    """

    rpe: Float[Tensor, " n"]
    aligned: Float[Tensor, " n"]
    psnr: Float[Tensor, " n"]
    scores: Float[Tensor, "m 8"]
    counts: Float[Tensor, " 4"]

    def summary(self) -> dict[str, float]:
        """The figures of the model card."""
        hit, found, seen, true = (float(c) for c in self.counts)
        precision, recall = hit / max(1.0, found), seen / max(1.0, true)
        out = {
            "rpe_mean_px": float(self.rpe.mean()),
            "rpe_median_px": float(self.rpe.median()),
            "rpe_p90_px": float(self.rpe.quantile(0.9)),
            "aligned_median_px": float(self.aligned.median()),
            "aligned_p90_px": float(self.aligned.quantile(0.9)),
            "psnr_db": float(self.psnr.mean()),
            "line_f": 2 * precision * recall / max(1e-9, precision + recall),
            "samples": float(len(self.rpe)),
        }
        if len(self.scores):
            inside = (self.scores.abs() <= _NORMAL_90).float().mean(0)
            out["held_90"] = float(inside.mean())
            out["held_90_lowest"] = float(inside.min())
            out["held_90_highest"] = float(inside.max())
        return out


@torch.inference_mode()
def assess(network: LaRecNet, batches: Iterable[SlfBatch]) -> Assessment:
    """Run a network over batches with ground truth.

    The lens is estimated as for users, in the network's own frame and from four mirror images; all
    else is done at the batches' size.

    Args:
        network: In evaluation mode.
        batches: Samples with rectified pictures.
    """
    rpe, aligned, psnr, scores = [], [], [], []
    counts = torch.zeros(4, dtype=torch.float64)
    for batch in batches:
        image = resized(batch.image, network.cfg.frame, network.cfg.frame)
        out = mean_estimate(network, image.contiguous(memory_format=torch.channels_last))
        errors = reprojection_errors(out.k, batch)
        rpe.append(errors.rpe)
        aligned.append(errors.aligned)
        mse = (rectify_images(batch.image, out.k) - batch.rectified).square().mean((1, 2, 3))
        psnr.append(-10.0 * torch.log10(mse.clamp_min(1e-10)))
        if out.covariance is not None:
            sigma = torch.diagonal(out.covariance, dim1=1, dim2=2).sqrt()[:, FREE]
            scores.append((batch.k - out.k)[:, FREE] / sigma)
        if out.seen is not None:
            sure = network.dlp.lineness(network.dlp(batch.image).raw)
            counts += torch.from_numpy(detection_counts(sure > 0.5, batch.line_map > 0))
    spread = torch.cat(scores) if scores else torch.zeros(0, len(FREE))
    rpe, aligned, psnr = (torch.cat(each).float() for each in (rpe, aligned, psnr))
    return Assessment(rpe, aligned, psnr, spread.float(), counts.float())


def fit_temperature(network: LaRecNet, batches: Iterable[SlfBatch]) -> float:
    """Scale the predicted spread so that 90 % intervals hold, over all free parameters together.

    Args:
        network: Its calibration's `temperature` is set.
        batches: Samples that are no test data.

    Returns:
        The factor by which standard deviations were multiplied.
    """
    found = assess(network, batches)
    if not len(found.scores):
        return 1.0
    # as many parameters hold too often as too seldom: the median of their own factors
    factor = float((found.scores.abs().quantile(0.9, dim=0) / _NORMAL_90).median())
    network.calibration.temperature.mul_(factor)
    return factor


def validation_batches(
    pack: Path, count: int, size: int, data: StreamCfg, *, device: str = "cpu"
) -> Iterator[SlfBatch]:
    """Samples of a validation pack, the same whenever they are asked for.

    Args:
        pack: Pictures that were not trained on.
        count: Batches of `BATCH`.
        size: Side of the square frame in pixels.
        data: Mixture of scenes and lenses.
        device: Where the samples are made.

    Raises:
        ValueError: If the pack has no pictures for any of the scenes.
    """
    stream = SlfStream(load_atlas(pack).to(device), _VALIDATION_SEED, BATCH, size, data)
    return (stream.batch(index) for index in range(count))


def temperature_batches(pack: Path, size: int, data: StreamCfg) -> Iterator[SlfBatch]:
    """Samples for `fit_temperature`.

    Args:
        pack: Pictures of the training.
        size: Side of the square frame in pixels, that of the training.
        data: Mixture of the training.

    Raises:
        ValueError: If the pack has no pictures for any of the scenes.
    """
    stream = SlfStream(load_atlas(pack), _TEMPERATURE_SEED, BATCH, size, data)
    return (stream.batch(index) for index in range(TEMPERATURE_BATCHES))


def write_scored(
    path: Path,
    network: LaRecNet | LinePerception | RongNet,
    card: dict[str, Any],
    scores: dict[str, Any],
) -> None:
    """Write weights with a card that tells these scores, and the temperature they hold with.

    Args:
        path: `….safetensors`, see `save_weights`; all may read it.
        network: The scored network.
        card: What else is known; entries but scores and temperature stay as they are.
        scores: Figures, or named sets of them.
    """
    told = {**card, "scores": scores}
    if isinstance(network, LaRecNet) and network.cfg.calibration.covariance:
        told["temperature"] = round(float(network.calibration.temperature), 4)
    save_weights(path, network, told)


_ROWS = (
    ("RPE, mean (px)", "rpe_mean_px", ".2f"),
    ("RPE, median (px)", "rpe_median_px", ".2f"),
    ("RPE, 90th percentile (px)", "rpe_p90_px", ".2f"),
    ("aligned error, median (px)", "aligned_median_px", ".2f"),
    ("aligned error, 90th percentile (px)", "aligned_p90_px", ".2f"),
    ("PSNR (dB)", "psnr_db", ".2f"),
    ("F of the heatmap's lines", "line_f", ".3f"),
    ("90 % intervals that hold", "held_90", ".3f"),
    ("  least held parameter", "held_90_lowest", ".3f"),
    ("  most held parameter", "held_90_highest", ".3f"),
    ("samples", "samples", ".0f"),
)


def scores_text(scores: dict[str, dict[str, float]]) -> str:
    """Scores as a table of text: a row a figure, a column a set; a dash where there is none."""
    head = [name.partition(",")[0] for name in scores]
    width = max(len(title) for title, _, _ in _ROWS)
    lines = [" " * width + "".join(f"  {title}" for title in head)]
    for title, key, form in _ROWS:
        cells = [
            f"{format(found[key], form) if key in found else '–':>{len(name) + 2}}"
            for found, name in zip(scores.values(), head, strict=True)
        ]
        lines.append(f"{title:<{width}}" + "".join(cells))
    return "\n".join(lines)

"""Loop two: score what lies on disk, by all protocols."""

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray
from threadpoolctl import threadpool_limits

from classical.camera import KannalaBrandt
from classical.files import atomic_path
from eval.cases import Case, read_picture
from eval.folder import RunFolder
from eval.frame import (
    Resampled,
    Similarity,
    best_similarity,
    frame_size,
    rectify_labels,
    rectify_picture,
    resample_labels,
    resample_picture,
    source_maps,
    to_frame_size,
)
from eval.images import psnr, ssim
from eval.lines import draw_line_map, grid_lines, match_line_maps, straightness
from eval.methods import Method
from eval.metrics import (
    Lens,
    angles,
    compared_pixels,
    distances,
    focal_error,
    polar_angle,
    rectified,
)
from eval.prediction import Estimate, Prediction
from learned.pool import ordered_map

SCORE_VERSION = 1
"""Raised whenever a metric changes; older scores are then made again."""


@dataclass(frozen=True)
class Truth:
    """What is known about one photograph, in the size of the 320 px frame."""

    case: Case
    theta_max: float

    @cached_property
    def camera(self) -> KannalaBrandt:
        """The true camera of the shrunken photograph."""
        return self.case.camera.resized(
            *frame_size(self.case.camera.width, self.case.camera.height)
        )

    @cached_property
    def photo(self) -> UInt8[ndarray, "h w 3"]:
        """The photograph, 320 px wide."""
        picture = read_picture(self.case.picture)
        camera = self.case.camera
        if picture.shape[:2] != (camera.height, camera.width):
            raise ValueError(
                f"expected {camera.width}x{camera.height} pixels in {self.case.picture}, "
                f"got {picture.shape[1]}x{picture.shape[0]}"
            )
        return to_frame_size(picture)

    @cached_property
    def straight(self) -> UInt8[ndarray, "h w 3"]:
        """The true rectified picture: the rendered one, else that of the true camera."""
        if self.case.straight is None:
            return rectify_picture(self.photo, self.camera)
        return to_frame_size(read_picture(self.case.straight))

    @cached_property
    def points(self) -> Float[ndarray, "n 2"]:
        """The pixels on which lenses are compared."""
        size = (self.camera.width, self.camera.height)
        return compared_pixels(self.camera, *size, theta_max=self.theta_max)

    @cached_property
    def places(self) -> Float[ndarray, "n 2"]:
        """Where the truth sends these pixels in the frame."""
        return rectified(self.camera, self.points, self.camera.width, self.camera.height)

    @cached_property
    def curves(self) -> list[Float[ndarray, "_ 2"]]:
        """The marked lines, 320 px wide; else none."""
        old, new = self.case.camera, self.camera
        scale = np.array([new.width / old.width, new.height / old.height])
        return [(np.asarray(curve) + 0.5) * scale - 0.5 for curve in self.case.curves]

    @cached_property
    def line_map(self) -> UInt8[ndarray, "h w"]:
        """The paper's map L_f of the marked lines."""
        return draw_line_map(self.curves, self.camera.width, self.camera.height)

    @cached_property
    def straight_line_map(self) -> UInt8[ndarray, "h w"]:
        """L_f rectified by the true camera, the paper's ground truth."""
        return rectify_labels(self.line_map, self.camera)

    @cached_property
    def plumb_lines(self) -> list[Float[ndarray, "_ 2"]]:
        """The marked lines, or a grid of lines where none are marked."""
        return self.curves or grid_lines(self.camera, theta_max=self.theta_max)

    @cached_property
    def kept(self) -> list[Bool[ndarray, " _"]]:
        """For each point of the plumb lines, whether it is compared."""
        masks = []
        for curve in self.plumb_lines:
            rays, valid = self.camera.unproject(curve)
            # a hair of slack: the ends of grid lines lie on the limit itself
            masks.append(valid & (polar_angle(rays) <= self.theta_max + 1e-6))
        return masks


def score_suite(
    cases: Sequence[Case],
    theta_max: float,
    methods: Sequence[Method],
    folder: RunFolder,
    *,
    workers: int = 1,
    cluster: str | None = None,
) -> Iterator[tuple[int, int]]:
    """Score all answers of a folder; those whose score is up to date are not scored again.

    Args:
        cases: The photographs.
        theta_max: True angle up to which pixels are compared, radians.
        methods: The methods to score; each has its answer on each photograph.
        folder: Where answers are and scores go.
        workers: Processes.
        cluster: Address of a Ray cluster to use instead, see `ordered_map`.

    Yields:
        (done, total) after each photograph.
    """
    score = partial(score_case, theta_max, [method.tag for method in methods], folder)
    yield 0, len(cases)
    for done, _ in enumerate(ordered_map(score, cases, workers=workers, cluster=cluster), start=1):
        yield done, len(cases)


def score_case(theta_max: float, tags: Sequence[str], folder: RunFolder, case: Case) -> None:
    """Score the answers on one photograph that have no score yet, into one file."""
    target = folder.score(case.name)
    saved = _saved_scores(target)
    digests = {tag: _digest(folder.prediction(tag, case.name)) for tag in tags}
    stale = [tag for tag in tags if saved.get(tag, {}).get("digest") != digests[tag]]
    if not stale:
        return
    truth = Truth(case, theta_max)
    with threadpool_limits(1):  # sums keep their bits, whatever the number of workers
        for tag in stale:
            prediction = Prediction.load(folder.prediction(tag, case.name))
            saved[tag] = {"digest": digests[tag], **score_prediction(prediction, truth)}
    record = {"version": SCORE_VERSION, "methods": saved}
    with atomic_path(target) as temporary:
        temporary.write_text(json.dumps(record), encoding="utf-8")


def score_prediction(prediction: Prediction, truth: Truth) -> dict[str, Any]:
    """All scores of one answer as plain values.

    A failure is scored as the photograph left alone, in every metric.

    Returns:
        `paper` and `aligned` (psnr, ssim, rpe and the line counts), `straightness`, `focal_error`
        in per cent (`None` without a camera), `angular_error` in degrees, and what the method said
        of itself.
    """
    camera = truth.camera
    size = {"width": camera.width, "height": camera.height}
    lens = _in_frame(prediction.camera, camera)
    place = rectified(lens, truth.points, **size)
    similarity = best_similarity(place, truth.places)
    angle = angles(lens, camera, truth.points, **size).mean()
    plain, aligned = (
        float(distances(place, truth.places, aligned=choice).mean()) for choice in (False, True)
    )
    return {
        "paper": {"rpe": plain, **_pictures(lens, truth, None)},
        "aligned": {"rpe": aligned, **_pictures(lens, truth, similarity)},
        "straightness": straightness(
            lens, truth.plumb_lines, **size, similarity=similarity, keep=truth.kept
        ),
        "angular_error": float(np.degrees(angle)),
        "focal_error": None if lens is None else focal_error(lens, camera),
        "scale": similarity.scale,
        "seconds": prediction.seconds,
        "status": prediction.status,
        "reason": prediction.reason,
        "predicted_error_px": _plain(prediction.predicted_error_px),
        "n_curves": len(prediction.curves),
    }


def _pictures(
    lens: Lens | None, truth: Truth, similarity: Similarity | None
) -> dict[str, float | list[int] | int]:
    """What is measured on rectified pictures and line maps, plain or after a similarity."""
    size = (truth.camera.width, truth.camera.height)
    maps = source_maps(lens, *size, similarity=similarity)
    picture = resample_picture(truth.photo, maps)
    scores: dict[str, float | list[int] | int] = {
        "psnr": psnr(picture, truth.straight),
        "ssim": ssim(picture, truth.straight),
    }
    if truth.curves:
        found = resample_labels(truth.line_map, maps)
        counts = match_line_maps(found, truth.straight_line_map)
        scores["matched"] = counts.matched.tolist()
        scores["found"] = counts.found.tolist()
        scores["true"] = counts.true
        scores["f"] = counts.f_score
    return scores


def _in_frame(estimate: Estimate | None, camera: KannalaBrandt) -> Resampled | None:
    """The estimated camera as seen in the photograph at 320 px."""
    if estimate is None:
        return None
    size = np.array([camera.width, camera.height], dtype=np.float64)
    return Resampled(estimate, size / [estimate.width, estimate.height])


def _saved_scores(path: Path) -> dict[str, Any]:
    """Scores of an earlier run; none if there is no file or a metric has changed since."""
    if not path.is_file():
        return {}
    record = json.loads(path.read_text(encoding="utf-8"))
    return record["methods"] if record["version"] == SCORE_VERSION else {}


def _digest(path: Path) -> str:
    if not path.is_file():
        raise ValueError(f"expected an answer in {path}: run all methods first")
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def _plain(value: float) -> float | None:
    return value if np.isfinite(value) else None

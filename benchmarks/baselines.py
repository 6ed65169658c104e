"""Figures of the classical baselines: against reference outputs, and on bent photographs.

    python -m benchmarks.baselines reference FOLDER   # reference.json beside its pictures
    python -m benchmarks.baselines warps FOLDER       # perspective photographs to bend

`reference` compares with answers of the authors' own programs: displacement at mid-radius, aligned
error in px of a 320 px frame, and seconds. `warps` bends photographs to 320x320 with odd-polynomial
lenses that see 37° to 50° at the frame's edge and reports the aligned error of each method.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np

from classical.baselines import aleman_flores, bukhari

SIZE = 320
FOCAL = 160.0
Estimate = Callable[[np.ndarray], Any]


def methods() -> dict[str, Estimate]:
    """The configurations compared, by the name under which they are reported."""

    def flores(variant: aleman_flores.Variant, angle: float) -> Estimate:
        config = aleman_flores.AlemanFloresConfig.for_variant(variant, angle_max_deg=angle)
        return lambda image: aleman_flores.estimate(image, config=config)

    return {
        "2014_angle10_lines30": flores("2014", 10.0),
        "2014_angle2_lines30": flores("2014", 2.0),
        "2016": flores("2016", 10.0),
        "bukhari-free": lambda image: bukhari.estimate(
            image, config=bukhari.BukhariConfig(centre="free")
        ),
        "bukhari-fixed": lambda image: bukhari.estimate(
            image, config=bukhari.BukhariConfig(centre="fixed")
        ),
    }


def read(file: Path) -> np.ndarray:
    """An RGB picture from disk."""
    image = cv2.imread(str(file))
    if image is None:
        raise click.ClickException(f"{file} is not a picture.")
    return np.ascontiguousarray(image[..., ::-1])


def aligned_error(truth: np.ndarray, estimate: np.ndarray) -> float:
    """Mean distance after the best similarity of `estimate` onto `truth`, both (n, 2)."""
    a = truth[:, 0] + 1j * truth[:, 1]
    b = estimate[:, 0] + 1j * estimate[:, 1]
    a, b = a - a.mean(), b - b.mean()
    return float(np.abs(a - np.vdot(b, a) / np.vdot(b, b).real * b).mean())


def grid(width: int, height: int) -> np.ndarray:
    """About 1,200 pixels spread over the frame, shape (n, 2)."""
    u, v = np.meshgrid(np.linspace(0, width - 1, 40), np.linspace(0, height - 1, 30))
    return np.stack([u.ravel(), v.ravel()], axis=1)


def divided(points: np.ndarray, answer: dict[str, float]) -> np.ndarray:
    """Points undistorted by a reference answer."""
    offset = points - np.array([answer["cx"], answer["cy"]])
    squared = (offset**2).sum(axis=1, keepdims=True)
    return offset / (1 + answer["k1"] * squared + answer["k2"] * squared**2)


def true_positions(entry: dict[str, Any], points: np.ndarray) -> np.ndarray:
    """Undistorted positions of the pixels of a reference picture."""
    width, height = entry["size"]
    corner = np.hypot(width, height) / 2
    if "equidistant" in entry.get("note", ""):
        offset = points - np.array([width / 2, height / 2])
        radius = np.hypot(*offset.T)[:, None]
        focal = corner / np.deg2rad(65)
        return offset * focal * np.tan(radius / focal) / np.maximum(radius, 1e-9)
    p = entry["true_p"]
    k = -p / (corner**2 * (1 + p))
    return divided(points, {"cx": width / 2, "cy": height / 2, "k1": k, "k2": 0.0})


def displacement(k1: float, k2: float, radius: float) -> float:
    """How far the model moves a point at the radius outwards, px."""
    return radius / (1 + k1 * radius**2 + k2 * radius**4) - radius


def timed(estimate: Estimate, image: np.ndarray, repeats: int) -> tuple[Any, float, float]:
    """Result, least wall-clock and least CPU seconds of some repeats."""
    wall = cpu = np.inf
    result = None
    for _ in range(repeats):
        start, start_cpu = time.perf_counter(), time.process_time()
        result = estimate(image)
        wall = min(wall, time.perf_counter() - start)
        cpu = min(cpu, time.process_time() - start_cpu)
    return result, wall, cpu


def coefficients(model: Any) -> tuple[float, float]:
    """(k1, k2) of either division model."""
    return getattr(model, "k1", getattr(model, "lambda_", 0.0)), getattr(model, "k2", 0.0)


@click.group()
def main() -> None:
    """Measure the classical baselines."""


@main.command()
@click.argument("folder", type=click.Path(exists=True, path_type=Path))
@click.option("--repeats", default=3, help="Runs a picture; the fastest counts.")
def reference(folder: Path, repeats: int) -> None:
    """Compare with the answers of the authors' programs on the same files."""
    table: dict[str, list[list[float]]] = {}
    for entry in json.loads((folder / "reference.json").read_text()):
        image = read(folder / entry["image"])
        width, height = entry["size"]
        points = grid(width, height)
        truth = true_positions(entry, points)
        to_frame = SIZE / max(width, height)
        middle = np.hypot(width, height) / 4
        for name, estimate in methods().items():
            theirs = entry.get(f"authors_{name}")
            result, wall, cpu = timed(estimate, image, repeats)
            line = f"{entry['image'][:28]:28} {name:21} {wall:5.2f} s {cpu:5.2f} CPU s"
            if result.model is None:
                click.echo(f"{line}  failed: {result.reason}")
                continue
            ours = aligned_error(truth, result.model.undistort(points)[0]) * to_frame
            line += f"  error {ours:5.2f} px"
            if theirs:
                other = aligned_error(truth, divided(points, theirs)) * to_frame
                ratio = displacement(*coefficients(result.model), middle) / displacement(
                    theirs["k1"], theirs["k2"], middle
                )
                line += f" (authors {other:5.2f} px, {theirs['seconds']:.2f} s)"
                line += f"  mid-radius {100 * (ratio - 1):+.2f} %"
                table.setdefault(name, []).append(
                    [ours, other, theirs["seconds"] / wall, theirs["seconds"] / cpu]
                )
            click.echo(line)
    for name, rows in table.items():
        ours, other, wall, cpu = np.median(rows, axis=0)
        click.echo(
            f"{name}: median error {ours:.2f} px (authors {other:.2f}); {wall:.1f} times their "
            f"speed by the clock, {cpu:.1f} by CPU time (median)"
        )


def lens(rng: np.random.Generator) -> np.ndarray:
    """Coefficients (k1 … k5) of r(θ), in half-widths: 37°–50° at the edge, growing to 80°."""
    while True:
        edge = np.deg2rad(rng.uniform(37, 50))
        k = np.array([1.0, rng.uniform(-0.1, 0.1), *rng.uniform(-0.01, 0.01, 3)])
        k /= k @ edge ** np.arange(1, 10, 2)
        theta = np.linspace(0, np.deg2rad(80), 400)
        slope = (k * np.arange(1, 10, 2)) @ theta ** np.arange(0, 10, 2)[:, None]
        if slope.min() > 0:
            return k


def straightened(points: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Pinhole positions (f = 160 px, about 0) of pixels of a bent 320x320 picture."""
    offset = (points - (SIZE - 1) / 2) / (SIZE / 2)
    radius = np.hypot(*offset.T)
    theta = np.linspace(0, np.deg2rad(80), 4000)
    angle = np.interp(radius, k @ theta ** np.arange(1, 10, 2)[:, None], theta)
    return offset * (FOCAL * np.tan(angle) / np.maximum(radius, 1e-9))[:, None]


def bent(photograph: np.ndarray, k: np.ndarray) -> np.ndarray:
    """A 320x320 warp of the middle square of a photograph, seen with f = 160 px of 320."""
    side = min(photograph.shape[:2])
    top, left = (photograph.shape[0] - side) // 2, (photograph.shape[1] - side) // 2
    square = photograph[top : top + side, left : left + side]
    over = 2  # supersampled, then averaged
    u, v = np.meshgrid(np.arange(SIZE * over), np.arange(SIZE * over))
    points = (np.stack([u.ravel(), v.ravel()], axis=1) + 0.5) / over - 0.5
    source = straightened(points, k) * (side / SIZE) + (side - 1) / 2
    maps = source.reshape(SIZE * over, SIZE * over, 2).astype(np.float32)
    large = cv2.remap(square, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR)
    return cv2.resize(large, (SIZE, SIZE), interpolation=cv2.INTER_AREA)


@main.command()
@click.argument("folder", type=click.Path(exists=True, path_type=Path))
@click.option("--count", default=60, help="Photographs, spread over the folder.")
@click.option("--seed", default=0)
@click.option("--only", default="", help="Methods whose name contains this.")
def warps(folder: Path, count: int, seed: int, only: str) -> None:
    """Aligned error on 320x320 warps of photographs; failures count as the picture left alone."""
    rng = np.random.default_rng(seed)
    files = sorted(folder.glob("*.jpg"))
    files = [files[i] for i in np.linspace(0, len(files) - 1, count).astype(int)]
    points = grid(SIZE, SIZE)
    errors: dict[str, list[float]] = {}
    seconds: dict[str, list[float]] = {}
    failed: dict[str, int] = {}
    chosen = {name: estimate for name, estimate in methods().items() if only in name}
    for file in files:
        k = lens(rng)
        image = bent(read(file), k)
        truth = straightened(points, k)
        errors.setdefault("left alone", []).append(aligned_error(truth, points))
        for name, estimate in chosen.items():
            result, wall, _ = timed(estimate, image, 1)
            moved = points if result.model is None else result.model.undistort(points)[0]
            errors.setdefault(name, []).append(aligned_error(truth, moved))
            seconds.setdefault(name, []).append(wall)
            failed[name] = failed.get(name, 0) + (result.model is None)
    for name, values in errors.items():
        click.echo(
            f"{name:21} median {np.median(values):6.2f} px  90 % {np.percentile(values, 90):6.2f}"
            f"  failed {failed.get(name, 0):2d} of {count}"
            f"  {np.median(seconds.get(name, [0])):.2f} s"
        )


if __name__ == "__main__":
    main()

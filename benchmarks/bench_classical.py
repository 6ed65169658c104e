"""Time of the classical method and its stages, on the example picture at three sizes.

    python benchmarks/bench_classical.py [--repeats N] [PICTURE ...]

Prints the median of the repeats in seconds, and each stage as a share of the whole.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from classical.fit import fit_lens
from classical.lines import Curve, curves_from_image
from classical.warp import pinhole_target, remap, undistort_maps
from hybrid import RectifyConfig, read_picture, rectify

EXAMPLE = Path(__file__).parents[1] / "examples" / "room.jpg"
SIZES = ((320, 240), (1280, 960), (4000, 3000))
FIT_CURVES = 60


def median_seconds(work: Callable[[], object], repeats: int) -> float:
    """Median wall time of some runs after one that warms up."""
    work()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds))


def longest(curves: list[Curve], count: int) -> list[Curve]:
    """The longest curves."""
    return sorted(curves, key=lambda curve: -curve.length)[:count]


def measure(image: np.ndarray, repeats: int) -> None:
    """One row a stage for one picture."""
    height, width = image.shape[:2]
    curves = curves_from_image(image)
    some = longest(curves, FIT_CURVES)
    camera = fit_lens([curves], width, height).camera
    if camera is None:
        print(f"{width}x{height}: no lens")
        return
    maps = undistort_maps(camera, pinhole_target(camera))
    config = RectifyConfig(method="classical")
    stages = {
        "rectify, whole": lambda: rectify(image, config, throw=False),
        "curves": lambda: curves_from_image(image),
        f"fit, all {len(curves)} curves": lambda: fit_lens([curves], width, height),
        f"fit, {len(some)} curves": lambda: fit_lens([some], width, height),
        "remap": lambda: remap(image, maps),
        "bare cv2.remap": lambda: cv2.remap(image, maps.u, maps.v, cv2.INTER_LINEAR),
    }
    whole = None
    for name, work in stages.items():
        seconds = median_seconds(work, repeats)
        whole = whole or seconds
        print(f"{width}x{height}  {name:24s} {seconds:8.3f} s  {seconds / whole:5.0%}")


def main() -> None:
    """Read the arguments and measure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("pictures", nargs="*", type=Path)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    if options.pictures:
        for path in options.pictures:
            measure(read_picture(path).pixels, options.repeats)
        return
    example = read_picture(EXAMPLE).pixels
    for width, height in SIZES:
        small = width < example.shape[1]
        way = cv2.INTER_AREA if small else cv2.INTER_CUBIC
        measure(cv2.resize(example, (width, height), interpolation=way), options.repeats)


if __name__ == "__main__":
    main()

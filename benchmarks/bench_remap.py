"""How long our remap takes beside a bare `cv2.remap` of the same size, in one run.

python benchmarks/bench_remap.py [--width 1280 --height 960 --rounds 60]

The two are timed in turn, so that a busy machine slows both alike; the ratio is of the medians.
"""

import argparse
import math
import time
from collections.abc import Callable

import cv2
import numpy as np

from classical.camera import KannalaBrandt
from classical.warp import pinhole_target, remap, undistort_maps


def seconds(call: Callable[[], object]) -> float:
    """Wall-clock time of one call."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def compare(image: np.ndarray, fov: float, balance: float, n_rounds: int) -> str:
    """One line of the table."""
    height, width = image.shape[:2]
    k = np.array([1 / math.radians(fov / 2), 0.0, 0.0, 0.0, 0.0])
    camera = KannalaBrandt.centred(k, width, height)
    maps = undistort_maps(camera, pinhole_target(camera, balance=balance))
    calls = (
        lambda: cv2.remap(image, maps.u, maps.v, cv2.INTER_LINEAR),
        lambda: remap(image, maps, antialias=False),
        lambda: remap(image, maps),
    )
    for call in calls:
        call()
    times = np.array([[seconds(call) for call in calls] for _ in range(n_rounds)])
    bare, plain, smooth = np.median(times, axis=0)
    kind = f"{image.dtype} {'x'.join(map(str, image.shape[2:])) or 'grey'}"
    return (
        f"{fov:4.0f}° balance {balance:3.1f}  {kind:10s}  scale up to {maps.scale.max():4.2f}  "
        f"bare {bare * 1e3:6.2f} ms  ours x{plain / bare:4.2f}  "
        f"with anti-aliasing x{smooth / bare:4.2f}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--width", type=int, default=1280)
    parser.add_argument("--height", type=int, default=960)
    parser.add_argument("--rounds", type=int, default=60)
    options = parser.parse_args()
    shape = (options.height, options.width)
    colour = np.random.default_rng(0).integers(0, 256, (*shape, 3), dtype=np.uint8)
    for fov, balance in ((90, 0.0), (120, 0.0), (160, 0.0), (120, 0.5), (120, 1.0)):
        print(compare(colour, fov, balance, options.rounds))
    print(compare(np.ascontiguousarray(colour[..., 0]), 120, 0.0, options.rounds))
    print(compare(colour.astype(np.uint16) * 257, 120, 0.0, options.rounds))
    for balance in (0.0, 0.5, 1.0):
        print(compare(colour.astype(np.float32) / 255, 120, balance, options.rounds))


if __name__ == "__main__":
    main()

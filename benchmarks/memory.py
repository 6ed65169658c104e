"""Memory of one process over many pictures, and of a batch over many more.

    python -m benchmarks.memory [--pictures 1000] [--method classical]

Pictures of 320x240 of a wall with bars are read, rectified and written one after the other; the
resident memory is told along the way. Flat means that the last figure is that of the first hundred.
"""

import argparse
import gc
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import psutil

from classical.camera import KannalaBrandt
from hybrid import Picture, Rectifier, RectifyConfig, read_picture, write_picture

SIZE = (320, 240)
LENS = KannalaBrandt.centred(np.array([0.95, -0.06, 0.004, 0.0, 0.0]), *SIZE)
ROWS = 10  # of the table


def view(seed: int) -> np.ndarray:
    """Dark bars on a wall, seen from somewhere."""
    u, v = np.meshgrid(np.arange(2 * SIZE[0]) / 2 - 0.25, np.arange(2 * SIZE[1]) / 2 - 0.25)
    x, y, z = LENS.unproject(np.stack([u.ravel(), v.ravel()], axis=1))[0].T
    rng = np.random.default_rng(seed)
    turn, slant = rng.uniform(-0.4, 0.4), rng.uniform(-0.3, 0.3)
    x, z = x * np.cos(turn) + z * np.sin(turn), z * np.cos(turn) - x * np.sin(turn)
    x, y = x / np.maximum(z, 1e-2), y / np.maximum(z, 1e-2)
    bars = (((x + slant * y) / 0.5 + rng.random()) % 1 < 0.25) | ((y / 0.4) % 1 < 0.2)
    grey = np.where(bars, 60.0, 190.0).astype(np.float32).reshape(u.shape)
    small = cv2.resize(grey, SIZE, interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(np.rint(small).astype(np.uint8), cv2.COLOR_GRAY2RGB)


def main() -> None:
    """Rectify and tell."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=int, default=1000)
    parser.add_argument("--method", default=RectifyConfig.method)
    options = parser.parse_args()
    process = psutil.Process()
    rectifier = Rectifier(RectifyConfig(method=options.method))
    statuses: dict[str, int] = {}
    print("pictures   resident MB   processor s a picture")
    with tempfile.TemporaryDirectory() as folder:
        start = time.process_time()
        for i in range(options.pictures):
            source, out = Path(folder) / f"{i % 20}.jpg", Path(folder) / f"{i % 20}.out.jpg"
            write_picture(source, Picture(view(i)))
            picture = read_picture(source)
            result = rectifier.rectify(picture.pixels, throw=False)
            write_picture(out, Picture(result.image, picture.icc, picture.exif))
            statuses[result.status] = statuses.get(result.status, 0) + 1
            if (i + 1) % max(1, options.pictures // ROWS) == 0:
                gc.collect()
                resident = process.memory_info().rss / 2**20
                each = (time.process_time() - start) / (i + 1)
                print(f"{i + 1:8d} {resident:13.1f} {each:14.3f}", flush=True)
    print(statuses)


if __name__ == "__main__":
    main()

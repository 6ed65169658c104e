"""Processor time a frame of each stage of `straightlens video`, on a made-up film of 1920x1080.

    python -m benchmarks.video [--frames 60] [--film FILE]

Processor time is told, not wall time, so that other work on the machine disturbs it less; the three
stages run side by side, so on two idle cores a frame takes about half of their sum.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import av
import cv2
import numpy as np

from classical.camera import KannalaBrandt
from classical.warp import remap, undistort_maps
from hybrid.config import RectifyConfig
from hybrid.pipeline import straight_target
from hybrid.video import Encoding, Film
from hybrid.video.warp import FrameWarp
from hybrid.video.write import FilmWriter

SIZE = (1920, 1080)
LENS = KannalaBrandt.centred(np.array([0.78, 0.01, -0.02, 0.002, 0.0]), *SIZE)
PRESETS = ("ultrafast", "superfast", "veryfast", "medium")


@contextmanager
def processor_time(what: str, n_frames: int) -> Iterator[None]:
    """Print the processor time a frame that the block took."""
    start = time.process_time()
    yield
    each = (time.process_time() - start) / n_frames
    print(f"{what:28s} {1e3 * each:7.1f} ms   {1 / each:7.1f} frames a second and core")


def make_film(path: Path, n_frames: int) -> None:
    """Soft random texture that drifts."""
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 255, (40, 80, 3), np.uint8)
    texture = cv2.resize(coarse, (2 * SIZE[0], SIZE[1]), interpolation=cv2.INTER_CUBIC).astype(
        np.uint8
    )
    with av.open(str(path), "w") as out:
        video = out.add_stream("libx264", rate=30, options={"crf": "18", "preset": "veryfast"})
        video.width, video.height = SIZE
        for i in range(n_frames):
            picture = np.ascontiguousarray(texture[:, 4 * i : 4 * i + SIZE[0]])
            out.mux(video.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        out.mux(video.encode(None))


def main() -> None:
    """Time each stage alone."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--film", type=Path, help="a film of 1920x1080 instead of the made-up one")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        source = options.film or Path(folder) / "film.mp4"
        if options.film is None:
            make_film(source, options.frames)
        with Film(source) as film:
            stages(film, Path(folder), options.frames)


def stages(film: Film, folder: Path, most: int) -> None:
    """Decode, warp by planes and by RGB, encode by several presets."""
    with processor_time("decode", most):
        frames = [frame for frame, _ in zip(film.frames(), range(most), strict=False)]
    config = RectifyConfig()
    target = straight_target(LENS, config)
    warp = FrameWarp(film.display, LENS, target, film.pixel_format, config)
    warp(frames[0])  # makes the plans
    with processor_time("warp (planes)", len(frames)):
        straight = [warp(frame) for frame in frames]
    maps = undistort_maps(LENS, target)
    with processor_time("warp (through RGB)", len(frames)):
        for frame in frames:
            picture = remap(film.picture(frame), maps).astype(np.uint8, copy=False)
            av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(format="yuv420p")
    for preset in PRESETS:
        encoding = Encoding(preset=preset)
        out = folder / f"{preset}.mp4"
        with (
            FilmWriter(out, film, SIZE, film.pixel_format, encoding) as writer,
            processor_time(f"encode ({preset})", len(frames)),
        ):
            for frame in straight:
                writer.frame(frame)
            writer.finish()


if __name__ == "__main__":
    main()

"""A whole film straightened: decoding, warping and encoding side by side."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from classical.camera import KannalaBrandt
from classical.files import atomic_path
from hybrid.config import RectifyConfig
from hybrid.pipeline import Rectifier, fitted_camera, opencv_threads, straight_target
from hybrid.result import Calibration
from hybrid.video.choose import chosen_frames
from hybrid.video.source import Film, film_errors
from hybrid.video.warp import FrameWarp
from hybrid.video.write import Encoding, FilmWriter

Item = TypeVar("Item")
Result = TypeVar("Result")
_AHEAD = 6  # items that may wait between two stages, so that memory stays flat
_STAGES = ("decode", "warp", "encode")


@dataclass(frozen=True)
class FilmReport:
    """What was done.

    Attributes:
        n_frames: Frames written.
        n_broken: Packets that could not be decoded and were left out.
        seconds: Wall time from the first frame to the finished file.
        busy: Seconds in which each of decode, warp and encode was at work; they overlap.
    """

    n_frames: int
    n_broken: int
    seconds: float
    busy: dict[str, float]

    @property
    def rate(self) -> float:
        """Frames a second."""
        return self.n_frames / max(self.seconds, 1e-9)


def calibrate_film(
    source: str | os.PathLike[str], rectifier: Rectifier
) -> tuple[Calibration, list[float]]:
    """Find the lens of a film from frames chosen by `chosen_frames`.

    Args:
        source: The film.
        rectifier: Who finds it.

    Returns:
        The lens of the upright frames, and the seconds at which those frames lie.

    Raises:
        FileNotFoundError: If there is no such film.
        ValueError: If it is no film.
    """
    with Film(source) as film:
        times, pictures = zip(*chosen_frames(film), strict=True)
    return rectifier.calibrate(pictures), list(times)


def rectify_film(
    source: str | os.PathLike[str],
    out: str | os.PathLike[str],
    camera: KannalaBrandt,
    *,
    config: RectifyConfig = RectifyConfig(),
    encoding: Encoding = Encoding(),
    progress: Callable[[int, int | None], None] | None = None,
) -> FilmReport:
    """Straighten every frame of a film; sound is copied, times are kept, frames are upright.

    Args:
        source: The film.
        out: The film to write, whole or not at all; its suffix chooses the container.
        camera: The lens of the upright frames; it may be of the same film at another resolution.
        config: The frame of the straight film, interpolation and smoothing.
        encoding: How it is encoded.
        progress: Called with the frames done and their number, if that is known.

    Raises:
        FileNotFoundError: If there is no such film.
        ValueError: If it is no film, the camera is of another, or it cannot be encoded so.
        OSError: If the file cannot be written.
    """
    with (
        opencv_threads(config.threads),
        Film(source) as film,
        film_errors(out),
        atomic_path(out) as temporary,
    ):
        camera = fitted_camera(camera, *film.display.size)
        target = straight_target(camera, _even(config, film.display.size))
        warp = FrameWarp(film.display, camera, target, film.pixel_format, config)
        busy: dict[str, float] = dict.fromkeys(_STAGES, 0.0)
        start = time.perf_counter()
        size = target.width, target.height
        with FilmWriter(temporary, film, size, film.pixel_format, encoding) as writer:
            n_frames = _run(film, warp, writer, busy, progress)
        return FilmReport(n_frames, film.n_broken, time.perf_counter() - start, busy)


def _even(config: RectifyConfig, size: tuple[int, int]) -> RectifyConfig:
    """A config whose size, where it is not said, is the film's without an odd row or column."""
    if config.size is not None:
        return config
    width, height = (max(2, side - side % 2) for side in size)
    return replace(config, size=(width, height))


def _run(
    film: Film,
    warp: FrameWarp,
    writer: FilmWriter,
    busy: dict[str, float],
    progress: Callable[[int, int | None], None] | None,
) -> int:
    """Pass every item through the three stages; decoding and encoding have a thread each."""
    n_frames = 0
    waiting: deque[Future[None]] = deque()
    with ThreadPoolExecutor(1) as reading, ThreadPoolExecutor(1) as writing:
        for is_frame, item in _ahead(film.items(writer.copied), reading, busy):
            if is_frame:
                item = _timed(busy, "warp", warp, item)
                n_frames += 1
            write = writer.frame if is_frame else writer.packet
            waiting.append(writing.submit(_timed, busy, "encode", write, item))
            if len(waiting) > _AHEAD:
                waiting.popleft().result()
            if is_frame and progress is not None:
                progress(n_frames, film.n_frames)
        waiting.append(writing.submit(_timed, busy, "encode", writer.finish))
        for done in waiting:
            done.result()
    return n_frames


def _ahead(
    items: Iterator[Item], executor: ThreadPoolExecutor, busy: dict[str, float]
) -> Iterator[Item]:
    """The items, of which a few are made ahead in the thread of an executor."""
    end: Any = object()

    def following() -> Any:
        return _timed(busy, "decode", next, items, end)

    waiting = deque(executor.submit(following) for _ in range(_AHEAD))
    while (item := waiting.popleft().result()) is not end:
        waiting.append(executor.submit(following))
        yield item


def _timed(
    busy: dict[str, float], stage: str, work: Callable[..., Result], *arguments: Any
) -> Result:
    """Do it, and add the time that it took to its stage; each stage runs in one thread."""
    start = time.perf_counter()
    try:
        return work(*arguments)
    finally:
        busy[stage] += time.perf_counter() - start

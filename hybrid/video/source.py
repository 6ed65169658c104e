"""Reading a film: its frames in order of time, its sound as it is."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from importlib import import_module
from types import ModuleType, TracebackType
from typing import Any

import numpy as np
from jaxtyping import UInt8

from hybrid.video.display import Display

_PLANAR = tuple(
    f"{family}{sampling}p{depth}"
    for sampling in ("420", "422", "444")
    for family, depth in (("yuv", ""), ("yuvj", ""), ("yuv", "10le"))
)
_DECODE_ON = 4.0  # seconds; what is nearer is reached by decoding, not by seeking


def av_module() -> ModuleType:
    """PyAV, an optional extra.

    Raises:
        ValueError: If it is not installed.
    """
    try:
        return import_module("av")
    except ImportError as error:
        message = "Expected the package av for films: pip install 'straightlens[video]'"
        raise ValueError(message) from error


@contextmanager
def film_errors(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn FFmpeg's errors inside the block into an OSError or a ValueError of one line."""
    try:
        yield
    except av_module().FFmpegError as error:
        words = error.strerror or type(error).__name__
        if isinstance(error, OSError):
            raise OSError(error.errno, words, str(path)) from error
        raise ValueError(f"{path}: {words}") from error


class Film:
    """A film that is open for reading; also a context manager.

    Args:
        path: The file.

    Attributes:
        display: How its frames are shown.
        pixel_format: The planar format of its frames, or the nearest to it.
        rate: Frames a second, on average.
        duration: Seconds, or None where the file does not say.
        n_frames: Number of frames, an estimate where the file does not say, or None.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is no film, or PyAV is not installed.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = path
        self.n_broken = 0
        with film_errors(path):
            self._open()
            try:
                first = next(self.container.decode(self.video), None)
                if first is None:
                    raise ValueError(f"{path}: no frame can be decoded")
            except BaseException:
                self.close()
                raise
        self.display = _display(first, self.video.sample_aspect_ratio)
        self.pixel_format = _planar_format(first.format)
        self.rate: Fraction = self.video.average_rate or self.video.guessed_rate or Fraction(25)
        self.duration = _duration(self.container, self.video)
        self.n_frames: int | None = self.video.frames or (
            None if self.duration is None else round(self.duration * self.rate)
        )

    def __enter__(self) -> Film:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self.container.close()

    def frames(self) -> Iterator[Any]:
        """All frames (av.VideoFrame) from the beginning."""
        return (item for is_frame, item in self.items(()) if is_frame)

    def items(self, others: Sequence[int]) -> Iterator[tuple[bool, Any]]:
        """All frames, and between them the packets of other streams, as they lie in the file.

        Packets that cannot be decoded are left out and counted in `n_broken`.

        Args:
            others: Indices of the streams whose packets are wanted.

        Yields:
            True and an av.VideoFrame, or False and an av.Packet.
        """
        av = av_module()
        with film_errors(self.path):
            self._reopen()
            wanted = [self.video, *(self.container.streams[index] for index in others)]
            for packet in self.container.demux(wanted):
                if packet.stream.index != self.video.index:
                    if packet.dts is not None:  # else it marks the end
                        yield False, packet
                    continue
                try:
                    frames = packet.decode()
                except av.error.InvalidDataError:
                    self.n_broken += 1
                    continue
                for frame in frames:
                    yield True, frame

    def frames_from(self, times: Sequence[float], count: int) -> Iterator[list[Any]]:
        """For each time, the frames from there on; fewer at the end.

        Args:
            times: Seconds from the beginning, rising.
            count: How many frames each.
        """
        with film_errors(self.path):
            self._reopen()
            frames, now = self.container.decode(self.video), 0.0
            for time in times:
                if time - now > _DECODE_ON:
                    self._seek(time)
                    frames = self.container.decode(self.video)
                found = []
                for frame in frames:
                    now = self.seconds(frame)
                    if now >= time:
                        found.append(frame)
                    if len(found) == count:
                        break
                yield found

    def picture(self, frame: Any) -> UInt8[np.ndarray, "h w 3"]:
        """A frame upright as RGB of 8 bits."""
        return self.display.upright(frame.to_ndarray(format="rgb24"))

    def seconds(self, frame: Any) -> float:
        """The time of a frame from the beginning of the film."""
        start = (self.video.start_time or 0) * self.video.time_base
        return 0.0 if frame.time is None else frame.time - float(start)

    def _seek(self, seconds: float) -> None:
        """To the key frame before; where the file cannot be sought in, stay."""
        ticks = round(seconds / self.video.time_base) + (self.video.start_time or 0)
        try:
            self.container.seek(ticks, stream=self.video)
        except av_module().FFmpegError:
            return

    def _open(self) -> None:
        self.container = av_module().open(os.fspath(self.path))
        if not self.container.streams.video:
            self.close()
            raise ValueError(f"{self.path}: no video in it")
        self.video = self.container.streams.video[0]
        self.video.thread_type = "AUTO"

    def _reopen(self) -> None:
        """Begin again; seeking to the beginning would leave out sound from before it."""
        self.close()
        self._open()


def _display(frame: Any, pixel_aspect: Fraction | None) -> Display:
    turns = round(frame.rotation / 90) % 4
    return Display(frame.width, frame.height, turns, float(pixel_aspect or 1))


def _planar_format(pixel_format: Any) -> str:
    """A format's own name, or that of the nearest planar one."""
    if pixel_format.name in _PLANAR:
        return pixel_format.name
    deep = max(part.bits for part in pixel_format.components) > 8
    return "yuv420p10le" if deep else "yuv420p"


def _duration(container: Any, video: Any) -> float | None:
    if video.duration:
        return float(video.duration * video.time_base)
    return container.duration / 1e6 if container.duration else None

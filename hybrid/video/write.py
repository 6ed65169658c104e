"""Writing a film: frames encoded, sound copied."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from hybrid.video.source import Film, av_module

_ENCODERS = {"h264": "libx264", "h265": "libx265"}
_PRESETS = (
    "ultrafast",
    "superfast",
    "veryfast",
    "faster",
    "fast",
    "medium",
    "slow",
    "slower",
    "veryslow",
)
_MOVIES = (".mp4", ".mov", ".m4v")
CODECS, PRESETS = tuple(_ENCODERS), _PRESETS


@dataclass(frozen=True)
class Encoding:
    """How the frames are encoded.

    Attributes:
        codec: "h264" or "h265".
        preset: From "ultrafast" to "veryslow": smaller files for more time.
        crf: Quality, 0 (lossless) to 51 (worst); 18 is hard to tell from the original.
    """

    codec: str = "h264"
    preset: str = "veryfast"
    crf: int = 18

    def __post_init__(self) -> None:
        if self.codec not in CODECS:
            raise ValueError(f"Expected a codec in {', '.join(CODECS)}, got {self.codec!r}.")
        if self.preset not in PRESETS:
            raise ValueError(f"Expected a preset in {', '.join(PRESETS)}, got {self.preset!r}.")
        if not 0 <= self.crf <= 51:
            raise ValueError(f"Expected a crf from 0 to 51, got {self.crf}.")

    @property
    def encoder(self) -> str:
        """FFmpeg's name of the encoder."""
        return _ENCODERS[self.codec]


class FilmWriter:
    """A film that is being written; a context manager that closes the file.

    Args:
        path: Where to; the suffix chooses the container.
        film: The film that it comes from; its sound is copied.
        size: Width and height of the frames, even where colour has half the resolution.
        pixel_format: Of the frames.
        encoding: How they are encoded.

    Attributes:
        copied: Indices of the streams of `film` whose packets are to be handed over.

    Raises:
        ValueError: If the container cannot hold the codec, or the size is odd.
    """

    def __init__(
        self,
        path: Path,
        film: Film,
        size: tuple[int, int],
        pixel_format: str,
        encoding: Encoding,
    ) -> None:
        av = av_module()
        options = {"movflags": "+faststart"} if path.suffix.lower() in _MOVIES else {}
        self._check_size(size, pixel_format)
        try:
            self._out = av.open(str(path), "w", options=options)
        except ValueError as error:
            raise ValueError(f"{path.name}: {error}") from error
        if encoding.codec.replace("h265", "hevc") not in self._out.supported_codecs:
            self._out.close()
            raise ValueError(f"{path.name}: expected a container for {encoding.codec}, e.g. .mp4")
        self._out.metadata.update(film.container.metadata)
        self._video = self._out.add_stream(
            encoding.encoder,
            rate=film.rate,
            options={"crf": str(encoding.crf), "preset": encoding.preset},
        )
        self._describe(film, size, pixel_format)
        self._audio = {
            stream.index: self._out.add_stream_from_template(stream)
            for stream in film.container.streams.audio
        }
        self.copied = list(self._audio)

    def __enter__(self) -> FilmWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._out.close()

    def frame(self, frame: Any) -> None:
        """Encode a frame at its own time."""
        self._out.mux(self._video.encode(frame))

    def packet(self, packet: Any) -> None:
        """Copy a packet of one of the streams `copied`."""
        packet.stream = self._audio[packet.stream.index]
        self._out.mux(packet)

    def finish(self) -> None:
        """Encode the frames that the encoder still holds."""
        self._out.mux(self._video.encode(None))

    def _describe(self, film: Film, size: tuple[int, int], pixel_format: str) -> None:
        """What players need to know: size, colours, and the clock of the source."""
        context, source = self._video.codec_context, film.video.codec_context
        context.width, context.height = size
        context.pix_fmt = pixel_format
        context.time_base = film.video.time_base  # so that uneven frame times are kept exactly
        for name in ("color_range", "colorspace", "color_trc", "color_primaries"):
            setattr(context, name, getattr(source, name))

    @staticmethod
    def _check_size(size: tuple[int, int], pixel_format: str) -> None:
        shape = av_module().VideoFormat(pixel_format, *size)
        halves = (shape.chroma_width(2) == 1, shape.chroma_height(2) == 1)
        if any(half and side % 2 for half, side in zip(halves, size, strict=True)):
            raise ValueError(f"Expected an even size for {pixel_format}, got {size[0]}x{size[1]}.")

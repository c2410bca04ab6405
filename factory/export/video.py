"""Writes, joins and reads MP4 files with one video stream. The only module of the export that imports PyAV.

Converts errors of PyAV to `OSError`, with the errno of the system if there is one.
"""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from schemas.errors import ArchiveCorrupt, WorldError
from schemas.support.extras import pip_install

_ONE_THREAD = 1  # each process encodes one episode, and the bytes must not depend on the number of cores


@dataclass(frozen=True)
class Codec:
    """Video codec with its encoder settings."""

    encoder: str
    """Name of the encoder in FFmpeg."""
    name: str
    """Name of the codec in the file."""
    frames: str
    """Pixel format of the input frames."""
    pixels: str
    """Pixel format of the video."""
    options: Mapping[str, str] = field(default_factory=dict)


RGB_CODEC = Codec(
    "libx264",
    "h264",
    frames="rgb24",
    pixels="yuv420p",
    options=MappingProxyType({"preset": "veryfast", "crf": "19", "g": "2", "bf": "0"}),
)
"""Chosen by a measurement with one thread on 60 frames of each of the demo's four scenes:

| encoder | CPU time per frame, ms | size per frame, kB | PSNR of each scene, dB |
|---|---|---|---|
| LeRobot's default (AV1, g 2, crf 30, preset 12) | 15.8 | 7.2 | 38.8, 39.0, 35.4, 36.5 |
| this codec | 7.6 | 7.7 | 40.1, 40.4, 35.4, 36.9 |
| this codec with superfast, crf 22 | 5.7 | 9.5 | 40.3, 40.7, 35.4, 37.2 |
| this codec with g 10, crf 20 | 7.2 | 3.7 | 39.8, 39.8, 34.9, 36.6 |
"""

DEPTH_CODEC = Codec(
    "libx265",
    "hevc",
    frames="gray12le",
    pixels="gray12le",
    options=MappingProxyType(
        {
            "preset": "superfast",
            "g": "10",
            "x265-params": "lossless=1:bframes=0:pools=none:frame-threads=1:log-level=none",
        }
    ),
)
"""Lossless. CPU time and size per frame were measured for three presets. Superfast: 34 ms (g 30) to 55 ms (g 2), 13 kB.
Ultrafast: 23 ms, 18 to 32 kB. Medium: 63 to 73 ms, 12 kB."""


class VideoWriter:
    """Writer of an MP4 file. The video starts with a key frame at time 0 and has no B-frames.

    Raises:
        WorldError: the installed PyAV does not have the encoder.
        OSError: the disk is full or not available; the caller must delete the file.
    """

    def __init__(self, path: Path, codec: Codec, fps: int, width: int, height: int) -> None:
        import av

        self._codec = codec
        self._count = 0
        with _as_os_errors():
            self._container = av.open(str(path), "w", format="mp4")
        self._stream: Any
        try:
            self._stream = self._container.add_stream(codec.encoder, fps, options=dict(codec.options))
        except (ValueError, av.FFmpegError) as error:
            self._container.close()
            raise WorldError(
                f"PyAV {av.__version__} was built without the encoder {codec.encoder}; "
                f"install its wheel: {pip_install('--force-reinstall --only-binary :all: av')}"
            ) from error
        context: Any = self._stream.codec_context
        context.width, context.height, context.pix_fmt = width, height, codec.pixels
        context.time_base, context.thread_count = Fraction(1, fps), _ONE_THREAD

    def add(self, frame: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
        """Appends a frame: (H, W, 3) uint8 for `rgb24`, (H, W) uint16 for `gray12le`."""
        import av

        picture = av.VideoFrame.from_ndarray(frame, format=self._codec.frames)
        picture.pts = self._count
        self._count += 1
        with _as_os_errors():
            self._container.mux(self._stream.encode(picture))

    def close(self) -> None:
        """Flushes the encoder and writes the index."""
        with _as_os_errors():
            try:
                if self._count:
                    self._container.mux(self._stream.encode())
            finally:
                self._container.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
            return
        with contextlib.suppress(OSError):
            self.close()


def join_videos(sources: Iterable[Path], target: Path, fps: int) -> int:
    """Concatenates videos of equal codec and settings without re-encoding.

    Frame n of the result is shown at n / fps seconds. The index is at the start of the file, for streaming.

    Returns:
        The number of frames.

    Raises:
        OSError: the disk is full or not available; the caller must delete the target.
        ArchiveCorrupt: a source is damaged or has other settings.
    """
    import av

    count, head = 0, b""
    with contextlib.ExitStack() as stack:
        stack.enter_context(_as_os_errors())
        output = stack.enter_context(av.open(str(target), "w", format="mp4", options={"movflags": "faststart"}))
        stream: Any = None
        for source in sources:
            with av.open(str(source)) as piece:
                video = piece.streams.video[0]
                extra = bytes(video.codec_context.extradata or b"")
                if stream is None:
                    stream = output.add_stream_from_template(template=video, opaque=True)
                    stream.time_base, head = video.time_base, extra
                    step = Fraction(1, fps) / stream.time_base
                if extra != head or video.time_base != stream.time_base or step.denominator != 1:
                    raise ArchiveCorrupt(
                        f"{source} was encoded with other settings: delete the export and run the same command again"
                    )
                for packet in piece.demux(video):
                    if packet.dts is None:
                        continue
                    packet.pts = packet.dts = count * step.numerator
                    packet.stream = stream
                    output.mux(packet)
                    count += 1
    return count


def read_video(path: Path, pixels: str = "rgb24") -> Iterator[tuple[float, bool, NDArray[np.generic]]]:
    """Yields the time in seconds, whether the frame is a key frame, and the frame. Used by tests."""
    import av

    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            yield float(frame.time or 0.0), bool(frame.key_frame), frame.to_ndarray(format=pixels)


@contextlib.contextmanager
def _as_os_errors() -> Iterator[None]:
    import av

    try:
        yield
    except av.FFmpegError as error:
        raise OSError(error.errno or errno.EIO, error.strerror or str(error)) from error

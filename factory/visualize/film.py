"""Writes a video of an episode: colour, depth, ids and the track on the map, with the instruction as a caption.

The video plays in real time; frames are skipped to limit the frame rate. Formats: MP4 (H.264), GIF and WebP.
Does not open datasets.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from factory.support.terminal import Bars
from factory.visualize.panels import TrackMap, show_depth, show_ids
from schemas.bundle import BundleReader
from schemas.measure import Goal
from schemas.scene import CompiledScene
from schemas.storage.disk import replacing
from schemas.support.extras import require_package
from schemas.terms import SuccessMeasure

_TILE_PX = 320
_CAPTION_PX = 56
_MARGIN_PX = 10
_HOLD_S = 1
"""Duration for which the last picture is repeated, seconds."""
_GIF_COLOURS = 128
_WEBP_QUALITY = 60
_FPS = 30
_GIF_FPS = 15
Rgb = NDArray[np.uint8]


def film_rate(control_hz: int, fps: int = _FPS) -> tuple[int, Fraction]:
    """Returns the frame stride for at most `fps` pictures per second, and the resulting rate, 1/s."""
    stride = max(1, -(-control_hz // fps))
    return stride, Fraction(control_hz, stride)


def draw_film(
    episode: BundleReader, scene: CompiledScene, stride: int, instruction: str | None = None
) -> Iterator[Rgb]:
    """Yields pictures (H, W, 3) of even size for every `stride`-th frame and the last frame.

    Args:
        episode: Bundle of the episode.
        scene: Scene in which the episode was recorded, for the map.
        stride: Number of frames from one picture to the next.
        instruction: Caption; `None` is the recorded instruction.
    """
    chart = TrackMap(episode, scene, _TILE_PX)
    last = episode.length - 1
    for t in [*range(0, last, stride), last]:
        tiles = [
            episode.rgb(t),
            show_depth(episode.depth(t)),
            show_ids(episode.ids(t), episode.meta.target_instance_id),
        ]
        film = Image.new("RGB", (4 * _TILE_PX, _TILE_PX + _CAPTION_PX), "white")
        for place, tile in enumerate(tiles):
            small = Image.fromarray(tile).resize((_TILE_PX, _TILE_PX), Image.Resampling.BOX)
            film.paste(small, (place * _TILE_PX, 0))
        film.paste(chart.draw(t + 1), (3 * _TILE_PX, 0))
        _write_caption(film, episode, t, instruction or episode.meta.instruction)
        yield np.asarray(film)


def save_film(path: Path, length: int, control_hz: int, draw: Callable[[int], Iterable[Rgb]]) -> Fraction:
    """Writes the video of an episode in the format of the suffix of `path`, with a progress bar; returns its rate.

    Args:
        path: Path of the file; its suffix is in `FORMATS`.
        length: Number of frames of the episode.
        control_hz: Control rate, 1/s.
        draw: Function that returns the pictures of every n-th frame and the last frame, for a stride n.

    Raises:
        UsageError: PyAV is not installed.
        WorldError: The file cannot be written.
    """
    write, fps = FORMATS[path.suffix.lower()]
    stride, rate = film_rate(control_hz, fps)
    with Bars(transient=True) as bar:
        write(path, bar.track(draw(stride), total=-(-(length - 1) // stride) + 1), rate)
    return rate


def require_mp4() -> None:
    """Raises an error unless the package for MP4 is installed.

    Raises:
        UsageError: PyAV is not installed.
    """
    require_package("av", "an MP4 video")


def write_mp4(path: Path, pictures: Iterable[Rgb], rate: Fraction, crf: int = 20) -> None:
    """Writes H.264 in yuv420p, which all common players and browsers support; replaces `path` atomically.

    Args:
        path: Path of the file.
        pictures: (H, W, 3) sRGB images of even size.
        rate: Pictures per second.
        crf: Constant rate factor of x264; a larger value gives a smaller file.

    Raises:
        UsageError: PyAV is not installed.
        WorldError: The file cannot be written.
    """
    require_mp4()
    import av

    with (
        replacing(path) as beside,  # converts the errors of PyAV, too
        av.open(str(beside), "w", format="mp4", options={"movflags": "faststart"}) as container,
    ):
        stream: Any = None
        for picture in _held(pictures, rate):
            if stream is None:
                stream = container.add_stream("libx264", rate=rate, options={"crf": str(crf), "preset": "veryfast"})
                stream.height, stream.width = picture.shape[:2]
                stream.pix_fmt = "yuv420p"
                stream.codec_context.thread_count = 1  # so that the bytes do not depend on the number of cores
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())


def write_gif(path: Path, pictures: Iterable[Rgb], rate: Fraction) -> None:
    """Writes a looping GIF; replaces `path` atomically.

    Raises:
        WorldError: The file cannot be written.
    """
    frames = (Image.fromarray(picture).quantize(_GIF_COLOURS) for picture in _held(pictures, rate))
    with replacing(path) as beside:
        first = next(frames)
        first.save(beside, "GIF", save_all=True, append_images=frames, duration=10 * round(100 / rate), loop=0)


def write_webp(path: Path, pictures: Iterable[Rgb], rate: Fraction) -> None:
    """Writes a looping animated WebP, about a fifth of the size of a GIF; replaces `path` atomically.

    Raises:
        WorldError: The file cannot be written.
    """
    frames = (Image.fromarray(picture) for picture in _held(pictures, rate))
    with replacing(path) as beside:
        first = next(frames)
        options = {"duration": round(1000 / rate), "loop": 0, "quality": _WEBP_QUALITY, "method": 4}
        first.save(beside, "WEBP", save_all=True, append_images=frames, **options)


FORMATS: Mapping[str, tuple[Callable[[Path, Iterable[Rgb], Fraction], None], int]] = MappingProxyType(
    {".mp4": (write_mp4, _FPS), ".gif": (write_gif, _GIF_FPS), ".webp": (write_webp, _GIF_FPS)}
)
"""Writer of each video format by suffix, and its largest number of pictures per second."""


def _held(pictures: Iterable[Rgb], rate: Fraction) -> Iterator[Rgb]:
    picture: Rgb | None = None
    for picture in pictures:
        yield picture
    if picture is not None:
        yield from [picture] * round(_HOLD_S * rate)


def _write_caption(film: Image.Image, episode: BundleReader, t: int, instruction: str) -> None:
    pen = ImageDraw.Draw(film)
    top = _TILE_PX + 6
    pen.text((_MARGIN_PX, top), instruction, fill="black", font=ImageFont.load_default(20))
    pen.text((_MARGIN_PX, top + 27), facts_of_step(episode, t), fill=(90, 90, 90), font=ImageFont.load_default(14))


def facts_of_step(episode: BundleReader, t: int) -> str:
    """Returns the caption of a step: episode, time, command, distance to the target by the success measure."""
    meta, job = episode.meta, episode.meta.job
    speed, turn = episode.arrays.actions_continuous[t]
    distance = Goal.of_episode(meta).distance(*episode.arrays.poses[t, :2].tolist())
    part = "footprint" if job.task.success is SuccessMeasure.SURFACE else "centre"
    return (
        f"{episode.episode_id}  {job.scene}  {job.tier}  {job.target_id}   t {t / job.task.control_hz:5.2f} s   "
        f"v {speed:4.2f} m/s   w {turn:+5.2f} rad/s   {distance:4.2f} m from the target's {part}"
    )

"""Writes and reads the piece of one episode for LeRobot: videos and a parquet file of columns, for both versions."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from factory.dataset.episode import Episode
from factory.export.base import EpisodeFacts, stride_of
from factory.export.lerobot.columns import FrameColumns, frame_columns, kept_frames
from factory.export.lerobot.features import (
    DEPTH,
    FILES,
    IDS,
    LARGEST_CODE,
    RGB,
    VECTORS,
    DepthCode,
    LeRobotOptions,
    data_schema,
    video_keys,
)
from factory.export.lerobot.statistics import ImageCounts, ImageTally, image_stats, sampled_frames
from factory.export.video import DEPTH_CODEC, RGB_CODEC, VideoWriter
from schemas.encoding.arrays import FRAME_SIZE_PX

FRAMES_FILE = "frames.parquet"
Image = NDArray[np.uint8] | NDArray[np.uint16]
_NUMBERED_LATER = ("episode_index", "index", "task_index")
_EVERY_PX = 4  # LeRobot computes statistics from every fourth row and column of images of this size
_CODECS = {RGB: RGB_CODEC, DEPTH: DEPTH_CODEC}
_LARGEST = {RGB: 255, DEPTH: LARGEST_CODE, IDS: 65535}


class LeRobotFacts(EpisodeFacts):
    """Facts of a piece for both versions."""

    images: dict[str, ImageCounts]
    """Image feature -> histogram of its codes."""
    states_digest: str
    """Digest of actions, poses and metadata of the episode."""


def write_piece(episode: Episode, options: LeRobotOptions, folder: Path) -> LeRobotFacts:
    """Writes `front.mp4`, optionally `depth.mp4`, and `frames.parquet`."""
    meta = episode.meta
    hz = meta.job.task.control_hz
    stride = stride_of(options.fps, hz)
    code = DepthCode(meta.job.camera.far_m)
    kept = kept_frames(len(episode), stride)
    sampled = sampled_frames(len(kept))
    tallies = {key: empty_tally(key) for key in _image_keys(options)}
    pictures: list[bytes] = []
    with ExitStack() as stack:
        writers = {
            key: stack.enter_context(
                VideoWriter(folder / FILES[key], _CODECS[key], hz // stride, FRAME_SIZE_PX, FRAME_SIZE_PX)
            )
            for key in video_keys(options)
        }
        for number, t in enumerate(kept):
            images: dict[str, Image] = {RGB: episode.rgb(t)}
            if options.depth:
                images[DEPTH] = code.encode(episode.depth(t))
            if options.ids:
                pictures.append(episode.stored(f"seg_front/{t:06d}.png"))
            for key, writer in writers.items():
                writer.add(images[key])
            if number in sampled:
                _count(tallies, images, episode, t)
    columns = frame_columns(episode.actions, episode.poses, hz, stride)
    pq.write_table(_table(columns, pictures, options), folder / FRAMES_FILE, compression="snappy")
    counts = {key: tally.result() for key, tally in tallies.items()}
    return LeRobotFacts(frames=len(kept), images=counts, states_digest=episode.states_digest)


def read_columns(folder: Path, numbers: dict[str, NDArray[np.int64]], options: LeRobotOptions) -> pa.Table:
    """Returns the rows of a piece with index columns, in the final column order."""
    schema = data_schema(options)
    table = pq.read_table(folder / FRAMES_FILE, columns=[name for name in schema.names if name not in _NUMBERED_LATER])
    for name in _NUMBERED_LATER:
        table = table.append_column(name, pa.array(numbers[name], pa.int64()))
    return table.select(schema.names).cast(schema)


def empty_tally(key: str) -> ImageTally:
    """Returns an empty histogram for the codes of an image feature."""
    return ImageTally(3 if key == RGB else 1, _LARGEST[key])


def stats_of_images(images: dict[str, ImageCounts], far_m: float) -> dict[str, Any]:
    """Returns the statistics of image features: RGB in 0..1, depth in metres, ids unscaled."""
    code = DepthCode(far_m)
    decoders = {
        RGB: lambda values: values / 255.0,
        DEPTH: code.decode,
        IDS: lambda values: values,
    }
    return {key: image_stats(counts, decoders[key]) for key, counts in images.items()}


def _image_keys(options: LeRobotOptions) -> tuple[str, ...]:
    return (*video_keys(options), *((IDS,) if options.ids else ()))


def _count(tallies: dict[str, ImageTally], images: dict[str, Image], episode: Episode, t: int) -> None:
    for key, tally in tallies.items():
        image = episode.ids(t) if key == IDS else images[key]
        tally.add(image[::_EVERY_PX, ::_EVERY_PX])


def _table(columns: FrameColumns, pictures: list[bytes], options: LeRobotOptions) -> pa.Table:
    values = {"observation.state": columns.state}
    values |= {name: getattr(columns, name) for name in VECTORS if hasattr(columns, name)}
    schema = pa.schema([field for field in data_schema(options) if field.name not in _NUMBERED_LATER])
    arrays = [
        _pictures(pictures, field.type) if field.name == IDS else _column(values[field.name], field.type)
        for field in schema
    ]
    return pa.Table.from_arrays(arrays, schema=schema)


def _column(values: NDArray[np.generic], kind: pa.DataType) -> pa.Array:
    if values.ndim == 1:
        return pa.array(values, kind)
    flat = pa.array(np.ascontiguousarray(values).reshape(-1), kind.value_type)
    return pa.FixedSizeListArray.from_arrays(flat, type=kind)


def _pictures(pictures: list[bytes], kind: pa.DataType) -> pa.Array:
    names = [f"frame-{number:06d}.png" for number in range(len(pictures))]
    data = [pa.array(pictures, pa.binary()), pa.array(names, pa.string())]
    return pa.StructArray.from_arrays(data, fields=list(kind))

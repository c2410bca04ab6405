"""Writes and reads the piece of one episode for LeRobot: videos and a parquet file of columns, for both versions.

A row of a rig's sensors has the latest measurement at or before its frame, so no row depends on the future.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from factory.dataset.episode import Episode
from factory.export.base import EpisodeFacts
from factory.export.lerobot.columns import INTERVENTION, frame_columns, kept_frames, outcome_columns
from factory.export.lerobot.features import LARGEST_CODE, DepthCode, data_schema
from factory.export.lerobot.layout import CAMERA_POSE, STATE, ImageFeature, Layout, extra_layout_of, layout_of
from factory.export.lerobot.statistics import ImageCounts, ImageTally, image_stats, sampled_frames
from factory.export.options import LeRobotOptions, stride_of
from factory.export.origin import COLUMN as ORIGIN
from factory.export.origin import origin_of
from factory.export.rig.description import intrinsics_of, optical_poses
from factory.export.rig.reader import SensorReader, shown_rig
from factory.export.video import DEPTH_CODEC, RGB_CODEC, VideoWriter
from schemas.encoding.png import encode_png
from schemas.rig import CameraOutput, Lidar2d, Lidar3d
from schemas.terms import Driver, EndReason
from workers.sensors import ImuMeasurements


def rig_columns(layout: Layout, reader: SensorReader, kept: Sequence[int]) -> dict[str, NDArray[np.float32]]:
    """Returns the values (N, ...) of the columns that a sensor of the rig measures.

    Args:
        layout: features of the export.
        reader: sensors of the episode.
        kept: control steps (N,) of the exported frames.
    """
    return {
        name: _scans(reader, column.sensor, kept)
        if isinstance(column.sensor, Lidar2d | Lidar3d)
        else _vectors(reader, column.sensor.name, kept)
        for name, column in layout.columns.items()
        if column.sensor is not None
    }


def camera_columns(
    layout: Layout, episode: Episode, reader: SensorReader | None, kept: Sequence[int]
) -> dict[str, NDArray[np.float32]]:
    """Returns the values of the columns that describe cameras: poses (N, 7) at the measurements, matrices (N, 9)."""
    cameras = {camera.name: camera for camera in shown_rig(episode).cameras}
    values = {}
    for name, column in layout.columns.items():
        if column.camera is None:
            continue
        camera = cameras[column.camera]
        if name.startswith(CAMERA_POSE):
            seen = [t if reader is None else reader.latest_step(camera.name, t) for t in kept]
            values[name] = optical_poses(episode.poses[seen], camera.mount).astype(np.float32)
        elif (intrinsics := intrinsics_of(camera)) is not None:
            values[name] = np.tile(np.array(intrinsics.matrix, np.float32), (len(kept), 1))
    return values


def _vectors(reader: SensorReader, name: str, kept: Sequence[int]) -> NDArray[np.float32]:
    """Returns (N, 6) angular velocity and specific force, or (N, 5) pose and twist of odometry."""
    motion = reader.motion[name]
    if isinstance(motion, ImuMeasurements):
        measured = np.concatenate((motion.angular_velocity, motion.specific_force), axis=1)
    else:
        measured = np.concatenate((motion.poses, motion.twists), axis=1).astype(np.float32)
    return np.asarray(measured[np.asarray(kept) // reader.strides[name]])


def _scans(reader: SensorReader, lidar: Lidar2d | Lidar3d, kept: Sequence[int]) -> NDArray[np.float32]:
    """Returns ranges (N, samples), or (N, lines, samples), metres; 0 without a return."""
    ranges = np.stack([reader.arrays(lidar, t)["ranges"] for t in kept])
    return ranges[:, 0] if isinstance(lidar, Lidar2d) else ranges


Image = NDArray[np.uint8] | NDArray[np.uint16]
_NUMBERED_LATER = ("episode_index", "index", "task_index")
_EVERY_PX = 4  # statistics use every fourth row and column, as LeRobot does for images of 640 x 640 pixels
_CODECS = {CameraOutput.RGB: RGB_CODEC, CameraOutput.DEPTH: DEPTH_CODEC}
_LARGEST = {CameraOutput.RGB: 255, CameraOutput.DEPTH: LARGEST_CODE, CameraOutput.IDS: 65535}


class LeRobotFacts(EpisodeFacts):
    """Facts of a piece for both versions."""

    images: dict[str, ImageCounts]
    """Image feature -> histogram of its codes."""
    states_digest: str
    """Digest of actions, poses and metadata of the episode."""


def write_piece(episode: Episode, options: LeRobotOptions, folder: Path) -> LeRobotFacts:
    """Writes a video for each video feature, and the rows of the dataset and of the second dataset."""
    meta = episode.meta
    hz = meta.job.task.control_hz
    stride = stride_of(options.fps, hz)
    extra = extra_layout_of(options, meta.job.camera, episode.rig)
    corrections = episode.corrections
    main = layout_of(meta.job.camera, episode.rig, is_corrected=corrections is not None)
    layouts = [main, *([] if extra is None else [extra])]
    reader = SensorReader(episode) if episode.rig else None
    kept = kept_frames(len(episode), stride)
    features = [image for layout in layouts for image in layout.images]
    counts, pictures = _write_images(episode, reader, features, kept, hz // stride, folder)
    columns = frame_columns(episode.actions, episode.poses, hz, stride)
    origins = np.array([origin_of(episode).to_json(), *[""] * (len(kept) - 1)], dtype=object)
    outcome = outcome_columns(len(kept), is_success=meta.rollout.end_reason is EndReason.SUCCESS)
    if corrections is not None:
        outcome[INTERVENTION] = corrections.drivers[np.asarray(kept)] == Driver.EXPERT
    for layout in layouts:
        values: dict[str, NDArray[Any]] = {STATE: columns.state, ORIGIN: origins, **outcome}
        values |= {name: getattr(columns, name) for name in layout.columns if hasattr(columns, name)}
        values |= camera_columns(layout, episode, reader, kept)
        if reader is not None:
            values |= rig_columns(layout, reader, kept)
        pq.write_table(_table(values, pictures, layout), folder / layout.rows_file, compression="snappy")
    return LeRobotFacts(frames=len(kept), images=counts, states_digest=episode.states_digest)


def _write_images(
    episode: Episode,
    reader: SensorReader | None,
    features: Sequence[ImageFeature],
    kept: Sequence[int],
    fps: int,
    folder: Path,
) -> tuple[dict[str, ImageCounts], dict[str, list[bytes]]]:
    """Writes the videos; returns the histogram of each feature, and the PNG images of features that are not videos."""
    sampled = sampled_frames(len(kept))
    tallies = {image.key: empty_tally(image) for image in features}
    pictures: dict[str, list[bytes]] = {image.key: [] for image in features if not image.is_video}
    with ExitStack() as stack:
        writers = {
            image.key: stack.enter_context(
                VideoWriter(folder / image.file, _CODECS[image.output], fps=fps, width=image.width, height=image.height)
            )
            for image in features
            if image.is_video
        }
        for number, t in enumerate(kept):
            for feature in features:
                source = _FrameSource(episode, reader, feature, t)
                if feature.is_video:
                    writers[feature.key].add(source.codes())
                else:
                    pictures[feature.key].append(source.png())
                if number in sampled:
                    tallies[feature.key].add(source.codes()[::_EVERY_PX, ::_EVERY_PX])
    return {key: tally.result() for key, tally in tallies.items()}, pictures


class _FrameSource:
    """One image feature at one step; the image is read at most once."""

    def __init__(self, episode: Episode, reader: SensorReader | None, feature: ImageFeature, t: int) -> None:
        self._episode, self._reader, self._feature, self._t = episode, reader, feature, t
        self._codes: Image | None = None

    def codes(self) -> Image:
        """Returns the image as it is encoded: colour (H, W, 3) uint8, depth codes or ids (H, W) uint16."""
        if self._codes is None:
            image = self._read()
            is_depth = self._feature.output is CameraOutput.DEPTH
            self._codes = DepthCode(self._feature.largest_m).encode(image) if is_depth else image
        return self._codes

    def png(self) -> bytes:
        """Returns the ids as PNG; for the recorded camera, the bytes equal those in a frames recording."""
        if self._reader is None:
            return self._episode.stored(f"seg_front/{self._t:06d}.png")
        return encode_png(self.codes())

    def _read(self) -> Any:
        feature = self._feature
        if self._reader is None or feature.camera is None:
            return getattr(self._episode, feature.output)(self._t)
        return self._reader.arrays(feature.camera, self._t)[feature.output]


def read_columns(folder: Path, numbers: dict[str, NDArray[np.int64]], layout: Layout) -> pa.Table:
    """Returns the rows of a piece with index columns, in the final column order."""
    schema = data_schema(layout)
    stored = [name for name in schema.names if name not in _NUMBERED_LATER]
    table = pq.read_table(folder / layout.rows_file, columns=stored)
    for name in _NUMBERED_LATER:
        table = table.append_column(name, pa.array(numbers[name], pa.int64()))
    return table.select(schema.names).cast(schema)


def empty_tally(image: ImageFeature) -> ImageTally:
    """Returns an empty histogram for the codes of an image feature."""
    return ImageTally(image.channels, _LARGEST[image.output])


def stats_of_images(counts: dict[str, ImageCounts], layout: Layout) -> dict[str, Any]:
    """Returns the statistics of image features: RGB in 0..1, depth in metres, ids unscaled."""
    return {image.key: image_stats(counts[image.key], _decoder(image)) for image in layout.images}


def _decoder(image: ImageFeature) -> Any:
    match image.output:
        case CameraOutput.RGB:
            return lambda values: values / 255.0
        case CameraOutput.DEPTH:
            return DepthCode(image.largest_m).decode
    return lambda values: values


def _table(values: dict[str, NDArray[Any]], pictures: dict[str, list[bytes]], layout: Layout) -> pa.Table:
    schema = pa.schema([field for field in data_schema(layout) if field.name not in _NUMBERED_LATER])
    arrays = [
        _pictures(pictures[field.name], field.type)
        if field.name in pictures
        else _column(values[field.name], field.type)
        for field in schema
    ]
    return pa.Table.from_arrays(arrays, schema=schema)


def _column(values: NDArray[np.generic], kind: pa.DataType) -> pa.Array:
    if values.ndim == 1:
        return pa.array(values, kind)
    if values.ndim == 3:
        lines = _ragged(
            _ragged(pa.array(values.reshape(-1), kind.value_type.value_type), values.shape[2]), values.shape[1]
        )
        return lines.cast(kind)
    flat = pa.array(np.ascontiguousarray(values).reshape(-1), kind.value_type)
    return pa.FixedSizeListArray.from_arrays(flat, type=kind)


def _ragged(values: pa.Array, size: int) -> pa.ListArray:
    """Returns the values divided into lists of `size` values."""
    return pa.ListArray.from_arrays(pa.array(np.arange(0, len(values) + 1, size), pa.int32()), values)


def _pictures(pictures: list[bytes], kind: pa.DataType) -> pa.Array:
    names = [f"frame-{number:06d}.png" for number in range(len(pictures))]
    data = [pa.array(pictures, pa.binary()), pa.array(names, pa.string())]
    return pa.StructArray.from_arrays(data, fields=list(kind))

"""Format `lerobot`: LeRobotDataset v3.0, in which many episodes share a data file and a video file.

Layout and limits are those of LeRobot 0.6 (datasets/utils.py); a test compares the schemas with those of its writer.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from coordinator.tables.write import parquet_schema
from factory.export.base import Finish
from factory.export.lerobot.common import (
    DatasetStats,
    LeRobotBase,
    LeRobotExport,
    Stats,
    describe_dataset,
    episode_stats,
)
from factory.export.lerobot.features import data_schema
from factory.export.lerobot.layout import ImageFeature, Layout
from factory.export.lerobot.numbering import ABOUT, STATES_DIGEST, Numbered, Numbering
from factory.export.lerobot.piece import LeRobotFacts, read_columns
from factory.export.lerobot.statistics import QUANTILES
from factory.export.lerobot.subtasks import (
    COLUMN,
    EVENTS,
    EVENTS_TYPE,
    FEATURE,
    TYPE,
    question_rows,
    subtask_rows,
    with_questions,
    with_subtasks,
)
from factory.export.options import LeRobotOptions
from factory.export.video import join_videos
from schemas.dataset.rows import EpisodeSummary

VERSION = "v3.0"
_EPISODES_A_BATCH = 200
_FILE = "chunk-{:03d}/file-{:03d}"
_TEMPLATE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_SCALAR, _NESTED = pa.list_(pa.float64()), pa.list_(pa.list_(pa.list_(pa.float64())))
FilePositions = dict[int, tuple[int, int, float]]
"""Episode index -> chunk index, file index, and start time in the video file, seconds (0 for a data file)."""


class FileLimits(NamedTuple):
    """Maximum sizes of files and folders; the defaults are those of LeRobot."""

    chunk_files: int = 1000
    """Maximum number of files in a folder."""
    data_mib: int = 100
    video_mib: int = 200
    episodes: int = 10_000
    """Maximum number of rows in a file of `meta/episodes`."""


class LeRobotExporter(LeRobotBase[LeRobotOptions]):
    """Exporter of format `lerobot`: joins pieces into files of at most 100 MiB of rows and 200 MiB of video."""

    name = "lerobot"
    version = 6
    keeps_questions = True
    about = "LeRobotDataset v3.0: parquet and H.264; LeRobot 0.4 and later"
    options = LeRobotOptions

    def finish(self, export: Finish[LeRobotOptions, LeRobotFacts]) -> None:
        """Writes data, videos and `meta/`."""
        write_dataset(export, FileLimits())


def write_dataset(export: Finish[LeRobotOptions, LeRobotFacts], limits: FileLimits) -> None:
    """Joins pieces into files within the limits and writes their description to `meta/`."""
    for dataset in describe_dataset(export).with_extra():
        _write_one(dataset, limits)


def _write_one(dataset: LeRobotExport, limits: FileLimits) -> None:
    data = _write_data(dataset, limits)
    videos = {image.key: _write_videos(dataset, image, limits) for image in dataset.layout.videos}
    stats = DatasetStats(dataset.layout)
    _write_episodes(dataset, data, videos=videos, stats=stats, limits=limits)
    dataset.write_stats(stats.result(dataset.numbering))
    with dataset.replacing("meta/tasks.parquet") as part:
        pq.write_table(tasks_table(dataset.numbering.tasks), part, compression="snappy")
    if not dataset.folder:
        dataset.write_card(
            VERSION, {"frames": {"train": "data/*/*.parquet"}, "episodes": {"train": "meta/episodes/*/*.parquet"}}
        )
    dataset.write_info(
        VERSION,
        dict.fromkeys(_language_types(dataset), FEATURE),
        chunks_size=limits.chunk_files,
        data_files_size_in_mb=limits.data_mib,
        video_files_size_in_mb=limits.video_mib,
        data_path=f"data/{_TEMPLATE}.parquet",
        video_path=f"videos/{{video_key}}/{_TEMPLATE}.mp4",
    )


def episodes_schema(layout: Layout) -> pa.Schema:
    """Returns the schema of `meta/episodes`: the columns of LeRobot in its order, then additional columns."""
    fields = [("episode_index", pa.int64()), ("tasks", pa.list_(pa.string())), ("length", pa.int64())]
    fields += [(name, pa.int64()) for name in ("data/chunk_index", "data/file_index")]
    fields += [(name, pa.int64()) for name in ("dataset_from_index", "dataset_to_index")]
    for key in (image.key for image in layout.videos):
        fields += [(f"videos/{key}/{name}", pa.int64()) for name in ("chunk_index", "file_index")]
        fields += [(f"videos/{key}/{name}", pa.float64()) for name in ("from_timestamp", "to_timestamp")]
    images = [image.key for image in layout.images]
    for key in (*images, *layout.columns):
        kind = _NESTED if key in images else _SCALAR
        for stat in ("min", "max", "mean", "std", "count", *QUANTILES):
            fields.append((f"stats/{key}/{stat}", pa.list_(pa.int64()) if stat == "count" else kind))
    fields += [(name, pa.int64()) for name in ("meta/episodes/chunk_index", "meta/episodes/file_index")]
    ours = parquet_schema(EpisodeSummary)
    return pa.schema([*fields, *((name, ours.field(name).type) for name in ABOUT), (STATES_DIGEST, pa.string())])


def tasks_table(tasks: Sequence[str]) -> pa.Table:
    """Returns the table of `meta/tasks.parquet`: a pandas frame with the instruction as index."""
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": dtype, "metadata": None}
        for name, kind, dtype in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]
    unnamed = {"name": None, "field_name": None, "pandas_type": "unicode", "numpy_type": "object"}
    pandas = {
        "index_columns": ["task"],
        "column_indexes": [unnamed | {"metadata": {"encoding": "UTF-8"}}],
        "columns": columns,
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.3.3",
    }
    schema = pa.schema([("task_index", pa.int64()), ("task", pa.string())], metadata={"pandas": json.dumps(pandas)})
    return pa.table([list(range(len(tasks))), list(tasks)], schema=schema)


def _write_data(dataset: LeRobotExport, limits: FileLimits) -> FilePositions:
    """Writes the data files with one row group per episode and returns the position of each episode."""
    places: FilePositions = {}
    schema = data_schema(dataset.layout)
    for name, kind in _language_types(dataset).items():
        # the metadata for `datasets` does not describe the language columns; readers take the features from info.json
        schema = schema.append(pa.field(name, kind)).remove_metadata()
    for number, group in enumerate(_grouped(dataset.numbering, dataset.layout.rows_file, limits.data_mib)):
        chunk, file = divmod(number, limits.chunk_files)
        places |= {numbered.episode_index: (chunk, file, 0.0) for numbered in group}
        name = f"data/{_FILE.format(chunk, file)}.parquet"
        if dataset.has(name):
            continue
        with (
            dataset.replacing(name) as part,
            pq.ParquetWriter(part, schema, compression="snappy", use_dictionary=True) as writer,
        ):
            for numbered in group:
                table = read_columns(numbered.piece.folder, numbered.numbers(), dataset.layout)
                writer.write_table(_with_language(table, dataset, numbered).cast(schema))
    return places


def _language_types(dataset: LeRobotExport) -> dict[str, pa.DataType]:
    """Returns the language columns of a dataset with their types."""
    event_types = {} if dataset.asked_about is None else {EVENTS: EVENTS_TYPE}
    return ({COLUMN: TYPE} if dataset.has_routes else {}) | event_types


def _with_language(table: pa.Table, dataset: LeRobotExport, numbered: Numbered) -> pa.Table:
    """Returns the frames of an episode with the language columns of the dataset."""
    episode, stride, frames = numbered.piece.episode, dataset.stride, numbered.frames
    if dataset.has_routes:
        table = with_subtasks(table, subtask_rows(episode.steps, dataset.fps * stride, stride, frames))
    if dataset.asked_about is not None:
        questions = numbered.piece.facts.questions
        asked = () if questions is None else questions.asked
        table = with_questions(table, question_rows(asked, dataset.asked_about, frames))
    return table


def _write_videos(dataset: LeRobotExport, image: ImageFeature, limits: FileLimits) -> FilePositions:
    """Writes the video files of a feature and returns the position of each episode."""
    places: FilePositions = {}
    for number, group in enumerate(_grouped(dataset.numbering, image.file, limits.video_mib)):
        chunk, file = divmod(number, limits.chunk_files)
        first = group[0].first
        places |= {numbered.episode_index: (chunk, file, (numbered.first - first) / dataset.fps) for numbered in group}
        name = f"videos/{image.key}/{_FILE.format(chunk, file)}.mp4"
        if not dataset.has(name):
            with dataset.replacing(name) as part:
                join_videos((numbered.piece.folder / image.file for numbered in group), part, dataset.fps)
    return places


def _write_episodes(
    dataset: LeRobotExport,
    data: FilePositions,
    videos: dict[str, FilePositions],
    stats: DatasetStats,
    limits: FileLimits,
) -> None:
    """Writes `meta/episodes` and merges the statistics of every episode."""
    numbering = dataset.numbering
    schema = episodes_schema(dataset.layout)
    for number, begin in enumerate(range(0, len(numbering), limits.episodes)):
        place = divmod(number, limits.chunk_files)
        some = numbering.episodes[begin : begin + limits.episodes]
        with (
            dataset.replacing(f"meta/episodes/{_FILE.format(*place)}.parquet") as part,
            pq.ParquetWriter(part, schema, compression="snappy", use_dictionary=True) as writer,
        ):
            for first in range(0, len(some), _EPISODES_A_BATCH):
                rows = []
                for numbered in some[first : first + _EPISODES_A_BATCH]:
                    stats_of_episodes = episode_stats(numbered, dataset.layout)
                    stats.merge(numbered, stats_of_episodes)
                    where = _placed(numbered, dataset.fps, data, videos, place)
                    rows.append(where | _flat(stats_of_episodes) | numbered.about())
                writer.write_table(pa.Table.from_pylist(rows, schema=schema))


def _placed(
    numbered: Numbered, fps: int, data: FilePositions, videos: dict[str, FilePositions], place: tuple[int, int]
) -> dict[str, Any]:
    chunk, file, _ = data[numbered.episode_index]
    row: dict[str, Any] = {
        "episode_index": numbered.episode_index,
        "tasks": [numbered.task],
        "length": numbered.frames,
        "data/chunk_index": chunk,
        "data/file_index": file,
        "dataset_from_index": numbered.first,
        "dataset_to_index": numbered.first + numbered.frames,
    }
    for key, places in videos.items():
        chunk, file, first_s = places[numbered.episode_index]
        row |= {f"videos/{key}/chunk_index": chunk, f"videos/{key}/file_index": file}
        ended_s = first_s + numbered.frames / fps
        row |= {f"videos/{key}/from_timestamp": first_s, f"videos/{key}/to_timestamp": ended_s}
    return row | {"meta/episodes/chunk_index": place[0], "meta/episodes/file_index": place[1]}


def _flat(stats: Stats) -> dict[str, Any]:
    return {f"stats/{key}/{stat}": value for key, values in stats.items() for stat, value in values.items()}


def _grouped(numbering: Numbering, file: str, limit_mib: int) -> Iterator[list[Numbered]]:
    """Yields groups of episodes whose pieces fill one file; an episode is not split."""
    group: list[Numbered] = []
    size = 0
    for numbered in numbering:
        more = (numbered.piece.folder / file).stat().st_size
        if group and size + more > limit_mib << 20:
            yield group
            group, size = [], 0
        group.append(numbered)
        size += more
    yield group

"""Format `lerobot-v2.1`: LeRobotDataset v2.1 with one data file and one video per episode, for GR00T and openpi.

Isaac-GR00T also requires `meta/modality.json` (its guide "data preparation").
"""

from __future__ import annotations

import json
from typing import Any

import pyarrow.parquet as pq

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
from factory.export.lerobot.layout import RGB, STATE, Layout
from factory.export.lerobot.numbering import Numbered
from factory.export.lerobot.piece import LeRobotFacts, read_columns
from factory.export.options import LeRobotV21Options
from schemas.support.geometry import STATE_NAMES

VERSION = "v2.1"
_CHUNK = 1000
_DATA_PATH = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
_VIDEO_PATH = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"

MODALITY: dict[str, dict[str, dict[str, Any]]] = {
    "state": {
        "odometry": {"start": 0, "end": 3, "dtype": "float32"},
        "twist": {"start": 3, "end": len(STATE_NAMES), "dtype": "float32"},
    },
    "action": {
        "twist": {"start": 0, "end": 2, "dtype": "float32", "absolute": False},
        "tokens": {"start": 0, "end": 2, "dtype": "int64", "original_key": "tokens"},
    },
    "video": {"front": {"original_key": RGB}},
    "annotation": {"human.task_description": {"original_key": "task_index"}},
}
"""Content of `modality.json` for the recorded camera: the parts of state and action, and the columns of the camera and
of the instruction. The actions are not `absolute`. Therefore, GR00T pads them after the last frame with zeros, which
stop the robot, instead of with the last value."""


class LeRobotV21Exporter(LeRobotBase[LeRobotV21Options]):
    """Exporter of format `lerobot-v2.1`: one data file and one video per piece."""

    name = "lerobot-v2.1"
    version = 6
    about = "LeRobotDataset v2.1 with modality.json; GR00T, openpi, LeRobot up to 0.3"
    options = LeRobotV21Options

    def finish(self, export: Finish[LeRobotV21Options, LeRobotFacts]) -> None:
        """Numbers the episodes and writes `meta/`."""
        dataset = describe_dataset(export)
        for numbered in dataset.numbering:
            _place(dataset, numbered)
        stats = DatasetStats(dataset.layout)
        _write_lists(dataset, stats)
        dataset.write_stats(_without_counts(stats.result(dataset.numbering)))
        export.out.write_text("meta/modality.json", json.dumps(modality_of(dataset.layout), indent=4) + "\n")
        dataset.write_card(VERSION, {"frames": {"train": "data/*/*.parquet"}})
        dataset.write_info(
            VERSION,
            total_videos=len(dataset.numbering) * len(dataset.layout.videos),
            total_chunks=-(-len(dataset.numbering) // _CHUNK),
            chunks_size=_CHUNK,
            data_path=_DATA_PATH,
            video_path=_VIDEO_PATH,
        )


def modality_of(layout: Layout) -> dict[str, dict[str, dict[str, Any]]]:
    """Returns the content of `modality.json`: `MODALITY` with the cameras and sensors of the export."""
    videos = {image.key.rpartition(".")[2]: {"original_key": image.key} for image in layout.videos}
    sensors = {
        name.rpartition(".")[2]: {"start": 0, "end": column.shape[0], "dtype": column.dtype, "original_key": name}
        for name, column in layout.columns.items()
        if column.sensor is not None and name != STATE and len(column.shape) == 1
    }
    return MODALITY | {"state": MODALITY["state"] | sensors, "video": videos}


def _path(template: str, numbered: Numbered, key: str = "") -> str:
    index = numbered.episode_index
    return template.format(episode_chunk=index // _CHUNK, episode_index=index, video_key=key)


def _place(dataset: LeRobotExport, numbered: Numbered) -> None:
    data = _path(_DATA_PATH, numbered)
    if not dataset.out.has(data):
        with dataset.out.replacing(data) as part:
            table = read_columns(numbered.piece.folder, numbered.numbers(), dataset.layout)
            table = table.cast(data_schema(dataset.layout, "Sequence"))  # LeRobot 0.3: `datasets` 3 has no `List`
            pq.write_table(table, part, compression="snappy")
    for image in dataset.layout.videos:
        video = _path(_VIDEO_PATH, numbered, image.key)
        if not dataset.out.has(video):
            dataset.out.link(numbered.piece.folder / image.file, video)


def _write_lists(dataset: LeRobotExport, stats: DatasetStats) -> None:
    """Writes the JSON lines files of episodes, episode statistics and tasks."""
    with dataset.out.replacing("meta/episodes.jsonl") as part, part.open("w", encoding="utf-8") as episodes:
        for numbered in dataset.numbering:
            row = {"episode_index": numbered.episode_index, "tasks": [numbered.task], "length": numbered.frames}
            episodes.write(_line(row | numbered.about()))
    with dataset.out.replacing("meta/episodes_stats.jsonl") as part, part.open("w", encoding="utf-8") as lines:
        for numbered in dataset.numbering:
            stats_of_episodes = episode_stats(numbered, dataset.layout)
            stats.merge(numbered, stats_of_episodes)
            lines.write(_line({"episode_index": numbered.episode_index, "stats": stats_of_episodes}))
    tasks = [{"task_index": number, "task": task} for number, task in enumerate(dataset.numbering.tasks)]
    dataset.out.write_text("meta/tasks.jsonl", "".join(map(_line, tasks)))


def _without_counts(stats: Stats) -> Stats:
    """Returns the statistics without `count`.

    GR00T divides every statistic into the parts of state and action, but `count` has only one value.
    """
    return {
        key: {name: value for name, value in statistics.items() if name != "count"} for key, statistics in stats.items()
    }


def _line(values: dict[str, Any]) -> str:
    return json.dumps(values, ensure_ascii=False) + "\n"

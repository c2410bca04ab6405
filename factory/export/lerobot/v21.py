"""`lerobot-v2.1`: LeRobotDataset v2.1, one data file and one video an episode; for GR00T, openpi and older LeRobots.

`meta/modality.json` is what Isaac-GR00T asks for beside it (its guide "data preparation").
"""

from __future__ import annotations

import json
from typing import Any

import pyarrow.parquet as pq

from factory.export.base import Finish
from factory.export.lerobot.columns import STATE_NAMES
from factory.export.lerobot.common import LeRobotBase, Whole, survey
from factory.export.lerobot.features import FILES, RGB, data_schema
from factory.export.lerobot.measure import DatasetStats, Stats, episode_stats
from factory.export.lerobot.numbering import Numbered
from factory.export.lerobot.piece import LeRobotFacts, read_columns
from factory.export.options import Decimated

__all__ = ["MODALITY", "LeRobotV21Exporter", "LeRobotV21Options"]

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
"""The parts of state and action by name, and where camera and instruction are. An action that is not `absolute` is
padded with zeros behind the last frame, where the robot stands; others with the last one."""


class LeRobotV21Options(Decimated):
    """What can be chosen of version 2.1, which knows neither depth video nor 16-bit images."""


class LeRobotV21Exporter(LeRobotBase[LeRobotV21Options]):
    """Pieces get their number, and are otherwise as they were made."""

    name = "lerobot-v2.1"
    version = 2
    about = "LeRobotDataset v2.1 with modality.json; GR00T, openpi, LeRobot up to 0.3"
    options = LeRobotV21Options

    def finish(self, export: Finish[LeRobotV21Options, LeRobotFacts]) -> None:
        """Numbers the episodes and writes `meta/`."""
        whole = survey(export)
        for numbered in whole.numbering:
            _place(whole, numbered)
        stats = DatasetStats(whole.far_m)
        _write_lists(whole, stats)
        whole.write_stats(_without_counts(stats.result(whole.numbering, whole.options)))
        export.out.write_text("meta/modality.json", json.dumps(MODALITY, indent=4) + "\n")
        whole.write_card(VERSION, {"frames": {"train": "data/*/*.parquet"}})
        whole.write_info(
            VERSION,
            total_videos=len(whole.numbering),
            total_chunks=-(-len(whole.numbering) // _CHUNK),
            chunks_size=_CHUNK,
            data_path=_DATA_PATH,
            video_path=_VIDEO_PATH,
        )


def _path(template: str, numbered: Numbered) -> str:
    index = numbered.episode_index
    return template.format(episode_chunk=index // _CHUNK, episode_index=index, video_key=RGB)


def _place(whole: Whole, numbered: Numbered) -> None:
    data, video = _path(_DATA_PATH, numbered), _path(_VIDEO_PATH, numbered)
    if not whole.out.has(data):
        with whole.out.replacing(data) as part:
            table = read_columns(numbered.piece.folder, numbered.numbers(), whole.options)
            table = table.cast(data_schema(whole.options, "Sequence"))  # LeRobot 0.3 has version 3 of `datasets`
            pq.write_table(table, part, compression="snappy")
    if not whole.out.has(video):
        whole.out.link(numbered.piece.folder / FILES[RGB], video)


def _write_lists(whole: Whole, stats: DatasetStats) -> None:
    """Writes the lists of episodes, of their statistics and of tasks, a line each."""
    with whole.out.replacing("meta/episodes.jsonl") as part, part.open("w", encoding="utf-8") as episodes:
        for numbered in whole.numbering:
            row = {"episode_index": numbered.episode_index, "tasks": [numbered.task], "length": numbered.frames}
            episodes.write(_line(row | numbered.about()))
    with whole.out.replacing("meta/episodes_stats.jsonl") as part, part.open("w", encoding="utf-8") as lines:
        for numbered in whole.numbering:
            found = episode_stats(numbered, whole.options, whole.far_m)
            stats.merge(numbered, found)
            lines.write(_line({"episode_index": numbered.episode_index, "stats": found}))
    tasks = [{"task_index": number, "task": task} for number, task in enumerate(whole.numbering.tasks)]
    whole.out.write_text("meta/tasks.jsonl", "".join(map(_line, tasks)))


def _without_counts(stats: Stats) -> Stats:
    """Returns what GR00T reads, which cuts its parts of state and action out of every statistic that is there."""
    return {key: {name: value for name, value in found.items() if name != "count"} for key, found in stats.items()}


def _line(values: dict[str, Any]) -> str:
    return json.dumps(values, ensure_ascii=False) + "\n"

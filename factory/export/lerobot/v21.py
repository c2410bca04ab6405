"""`lerobot-v2.1`: LeRobotDataset v2.1, one data file and one video an episode; for GR00T, openpi and InternNav.

`meta/modality.json` is what Isaac-GR00T asks for beside it (its getting_started/data_preparation.md).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from coordinator.dataset_meta import DatasetMeta
from factory.episode import Episode
from factory.export.base import Exporter, Finish, Requirement
from factory.export.card import CARD_FILE, export_card
from factory.export.lerobot.card import card_text
from factory.export.lerobot.columns import STATE_NAMES
from factory.export.lerobot.features import FILES, RGB, LeRobotOptions, info_of
from factory.export.lerobot.measure import DatasetStats, episode_stats
from factory.export.lerobot.numbering import Numbered, Numbering, number_pieces
from factory.export.lerobot.piece import LeRobotFacts, read_columns, write_piece
from factory.export.options import Decimated, stride_of

__all__ = ["MODALITY", "LeRobotV21Exporter", "LeRobotV21Options"]

VERSION = "v2.1"
_CHUNK = 1000
_DATA_PATH = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
_VIDEO_PATH = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"

MODALITY: dict[str, dict[str, dict[str, Any]]] = {
    "state": {"odometry": {"start": 0, "end": 3}, "twist": {"start": 3, "end": len(STATE_NAMES)}},
    "action": {
        "twist": {"start": 0, "end": 2},
        "tokens": {"start": 0, "end": 2, "original_key": "tokens"},
    },
    "video": {"front": {"original_key": RGB}},
    "annotation": {"human.task_description": {"original_key": "task_index"}},
}
"""The parts of state and action by name, and where camera and instruction are."""


class LeRobotV21Options(Decimated):
    """What can be chosen of version 2.1, which knows neither depth video nor 16-bit images."""


class LeRobotV21Exporter(Exporter[LeRobotV21Options, LeRobotFacts]):
    """Pieces get their number, and are otherwise as they were made."""

    name = "lerobot-v2.1"
    about = "LeRobotDataset v2.1 with modality.json; GR00T, openpi, InternNav"
    requires = (Requirement("av", "lerobot"),)
    assembles = True
    options = LeRobotV21Options
    facts = LeRobotFacts

    def check(self, options: LeRobotV21Options, meta: DatasetMeta) -> None:
        """Refuses a rate that does not divide the dataset's."""
        stride_of(options.fps, meta.plan.task.control_hz)

    def write_episode(self, episode: Episode, options: LeRobotV21Options, folder: Path) -> LeRobotFacts:
        """Writes video and columns of one episode."""
        return write_piece(episode, _shared(options), folder)

    def finish(self, export: Finish[LeRobotV21Options, LeRobotFacts]) -> None:
        """Numbers the episodes and writes `meta/`."""
        task, options, out = export.dataset.meta.plan.task, _shared(export.options), export.out
        far_m = export.dataset.meta.plan.camera.far_m
        stride = stride_of(options.fps, task.control_hz)
        fps = task.control_hz // stride
        numbering = number_pieces(export.pieces, stride)
        for numbered in numbering:
            _place(export, numbered, options)
        stats = DatasetStats(far_m)
        _write_lists(export, numbering, stats, options, far_m)
        out.write_text("meta/stats.json", json.dumps(stats.result(numbering, options), indent=4) + "\n")
        out.write_text("meta/modality.json", json.dumps(MODALITY, indent=4) + "\n")
        card = card_text(VERSION, options, fps, stride, numbering.splits)
        configs = {"frames": "data/*/*.parquet"}
        out.write_text(CARD_FILE, export_card(export.dataset.meta, len(numbering), card, configs, ["LeRobot"]))
        out.write_text("meta/info.json", _info(options, numbering, fps, far_m))


def _shared(options: LeRobotV21Options) -> LeRobotOptions:
    return LeRobotOptions(fps=options.fps)


def _path(template: str, numbered: Numbered) -> str:
    index = numbered.episode_index
    return template.format(episode_chunk=index // _CHUNK, episode_index=index, video_key=RGB)


def _place(export: Finish[LeRobotV21Options, LeRobotFacts], numbered: Numbered, options: LeRobotOptions) -> None:
    data, video = _path(_DATA_PATH, numbered), _path(_VIDEO_PATH, numbered)
    if not export.out.has(data):
        with export.out.replacing(data) as part:
            table = read_columns(numbered.piece.folder, numbered.numbers(), options)
            pq.write_table(table, part, compression="snappy")
    if not export.out.has(video):
        export.out.link(numbered.piece.folder / FILES[RGB], video)


def _write_lists(
    export: Finish[LeRobotV21Options, LeRobotFacts],
    numbering: Numbering,
    stats: DatasetStats,
    options: LeRobotOptions,
    far_m: float,
) -> None:
    """Writes the lists of episodes, of their statistics and of tasks, a line each."""
    with export.out.replacing("meta/episodes.jsonl") as part, part.open("w", encoding="utf-8") as episodes:
        for numbered in numbering:
            row = {"episode_index": numbered.episode_index, "tasks": [numbered.task], "length": numbered.frames}
            episodes.write(_line(row | numbered.about()))
    with export.out.replacing("meta/episodes_stats.jsonl") as part, part.open("w", encoding="utf-8") as lines:
        for numbered in numbering:
            found = episode_stats(numbered, options, far_m)
            stats.merge(numbered, found)
            lines.write(_line({"episode_index": numbered.episode_index, "stats": found}))
    tasks = [{"task_index": number, "task": task} for number, task in enumerate(numbering.tasks)]
    export.out.write_text("meta/tasks.jsonl", "".join(map(_line, tasks)))


def _line(values: dict[str, Any]) -> str:
    return json.dumps(values, ensure_ascii=False) + "\n"


def _info(options: LeRobotOptions, numbering: Numbering, fps: int, far_m: float) -> str:
    return info_of(
        options,
        fps,
        far_m,
        codebase_version=VERSION,
        total_episodes=len(numbering),
        total_frames=numbering.frames,
        total_tasks=len(numbering.tasks),
        total_videos=len(numbering),
        total_chunks=-(-len(numbering) // _CHUNK),
        chunks_size=_CHUNK,
        splits=numbering.splits,
        data_path=_DATA_PATH,
        video_path=_VIDEO_PATH,
    )

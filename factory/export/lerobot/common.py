"""Base class of the exporters of both LeRobot versions, and the description of the exported dataset."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from coordinator.tables.card_configs import Configs
from factory.dataset.episode import Episode
from factory.export.base import Exporter, Finish
from factory.export.card import CARD_FILE, export_card
from factory.export.lerobot.card import card_text
from factory.export.lerobot.features import LeRobotOptions, features_of
from factory.export.lerobot.measure import Stats
from factory.export.lerobot.numbering import Numbering, number_pieces
from factory.export.lerobot.piece import LeRobotFacts, write_piece
from factory.export.options import Decimated, stride_of
from factory.export.output import Output
from schemas.dataset_meta import DatasetMeta

__all__ = ["ROBOT", "LeRobotBase", "LeRobotExport", "describe_dataset"]

ROBOT = "nova_carter"
OptionsT = TypeVar("OptionsT", bound=Decimated)


class LeRobotBase(Exporter[OptionsT, LeRobotFacts]):
    """Base class: writes videos and columns of an episode as a piece. Subclasses write the layout of a version."""

    requires = ("av",)
    assembles = True
    facts = LeRobotFacts

    def write_episode(self, episode: Episode, options: OptionsT, folder: Path) -> LeRobotFacts:
        """Writes videos and columns of one episode."""
        return write_piece(episode, _widened(options), folder)


@dataclass(frozen=True)
class LeRobotExport:
    """Description of the exported dataset, with its output directory."""

    out: Output
    meta: DatasetMeta
    options: LeRobotOptions
    stride: int
    """Stride of the exported frames."""
    fps: int
    """Frames per second of the export."""
    far_m: float
    """Far plane of the camera, metres; range of the depth codes."""
    numbering: Numbering

    def write_card(self, version: str, configs: Configs) -> None:
        """Writes the card; `configs` maps names to the tables that `datasets` opens."""
        text = card_text(version, self.options, self.fps, self.stride, self.numbering.splits)
        self.out.write_text(CARD_FILE, export_card(self.meta, len(self.numbering), text, configs, ["LeRobot"]))

    def write_stats(self, stats: Stats) -> None:
        """Writes the statistics of all episodes."""
        self._write_json("meta/stats.json", stats)

    def write_info(self, version: str, **values: Any) -> None:
        """Writes `info.json`, the last file; `values` are inserted between version and features."""
        known = {
            "total_episodes": len(self.numbering),
            "total_frames": self.numbering.frames,
            "total_tasks": len(self.numbering.tasks),
        }
        shared = {
            "splits": self.numbering.splits,
            "robot_type": ROBOT,
            "fps": self.fps,
            "features": features_of(self.options, self.fps, self.far_m),
        }
        self._write_json("meta/info.json", {"codebase_version": version, **known, **values, **shared})

    def _write_json(self, name: str, values: dict[str, Any]) -> None:
        self.out.write_text(name, json.dumps(values, indent=4) + "\n")


def describe_dataset(export: Finish[Any, LeRobotFacts]) -> LeRobotExport:
    """Numbers the pieces of an export and returns the description of the dataset."""
    plan, options = export.dataset.meta.plan, _widened(export.options)
    stride = stride_of(options.fps, plan.task.control_hz)
    return LeRobotExport(
        out=export.out,
        meta=export.dataset.meta,
        options=options,
        stride=stride,
        fps=plan.task.control_hz // stride,
        far_m=plan.camera.far_m,
        numbering=number_pieces(export.pieces, stride),
    )


def _widened(options: Decimated) -> LeRobotOptions:
    """Converts the options of a version to `LeRobotOptions`."""
    return LeRobotOptions.model_validate(options.model_dump())

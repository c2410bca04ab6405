"""Base class of the exporters of both LeRobot versions; description, card and statistics of the exported dataset.

Statistics are computed from pieces in bounded memory.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import pyarrow as pa

from coordinator.tables.card import Configs, robot_name
from factory.dataset.episode import Episode
from factory.dataset.steps import has_questions, has_routes
from factory.export.base import Exporter, Finish
from factory.export.card import CARD_FILE, export_card
from factory.export.lerobot.columns import kept_frames
from factory.export.lerobot.features import features_of
from factory.export.lerobot.layout import EXTRA_FOLDER, RGB, ImageFeature, Layout, extra_layout_of, layout_of
from factory.export.lerobot.numbering import Numbered, Numbering, number_pieces
from factory.export.lerobot.piece import LeRobotFacts, empty_tally, read_columns, stats_of_images, write_piece
from factory.export.lerobot.statistics import ImageTally, RunningStats, vector_stats
from factory.export.options import Decimated, LeRobotOptions, stride_of
from factory.export.output import Output
from factory.export.questions import QuestionCount, ask_questions, not_asked, questions_text
from factory.export.rig.description import RIG_FILE, rig_table
from schemas.config import CameraConfig
from schemas.dataset.meta import DatasetMeta
from schemas.rig import CameraOutput, DepthKind, Rig

Stats = dict[str, dict[str, Any]]
"""Feature -> statistic -> values."""


def episode_stats(numbered: Numbered, layout: Layout) -> Stats:
    """Returns the statistics of one episode: feature -> statistic -> values."""
    images = stats_of_images(numbered.piece.facts.images, layout)
    return images | {name: vector_stats(matrix) for name, matrix in _matrices(numbered, layout)}


class DatasetStats:
    """Accumulator of statistics over all episodes: `merge` each episode, then call `result`."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._images: dict[str, ImageTally] = {}
        self._vectors: dict[str, RunningStats] = {}

    def merge(self, numbered: Numbered, stats: Stats) -> None:
        for image in self._layout.images:
            self._images.setdefault(image.key, empty_tally(image)).merge(numbered.piece.facts.images[image.key])
        for name in self._layout.columns:
            self._vectors.setdefault(name, RunningStats()).merge(stats[name])

    def result(self, numbering: Numbering) -> Stats:
        """Reads the columns again for the quantiles and returns the statistics over all episodes."""
        for numbered in numbering:
            for name, matrix in _matrices(numbered, self._layout):
                self._vectors[name].add(matrix)
        images = stats_of_images({key: tally.result() for key, tally in self._images.items()}, self._layout)
        return images | {name: running.result() for name, running in self._vectors.items()}


def _matrices(numbered: Numbered, layout: Layout) -> Iterator[tuple[str, Any]]:
    """Yields the name and the values (N,) or (N, D) of each column; for scans, the ranges of all frames (N * rays,)."""
    without_pictures = replace(layout, images=layout.videos)
    table = read_columns(numbered.piece.folder, numbered.numbers(), without_pictures)
    for name, column in layout.columns.items():
        array = table[name].combine_chunks()
        while not pa.types.is_primitive(array.type):
            array = array.flatten()
        values = array.to_numpy(zero_copy_only=False)
        yield name, values if column.is_scan or not column.shape else values.reshape(-1, *column.shape)


OptionsT = TypeVar("OptionsT", bound=Decimated)
_TEXT = """\
A [LeRobot](https://github.com/huggingface/lerobot) dataset, version {version}, {fps} frames per second{decimated}.

```python
{example}
```

| column | what |
|---|---|
{images}| `observation.state` | x, y, yaw since the first frame in its frame (m, rad), measured v and w (m/s, rad/s) |
| `action` | commanded v in m/s, w in rad/s{mean} |
| `tokens` | the action on the 7 x 7 grid, 0..6 each |
| `pose` | x, y, z, qw, qx, qy, qz of base_link in the world frame |
| `next.reward`, `next.success`, `next.done` | outcome of the action: 1, true, true in the last frame of a success |
| `task` | the instruction |
{sensors}
Frame t is what the robot saw before action t. Splits: {splits} (ranges of `episode_index`); {where}.
{hub}"""
_MEAN = ", the mean of the {stride} commands until the next frame"
_EXAMPLES = {
    "v3.0": "from lerobot.datasets.lerobot_dataset import LeRobotDataset\n\n"
    'dataset = LeRobotDataset("me/nav", root=".")',
    "v2.1": "from lerobot.datasets.lerobot_dataset import LeRobotDataset  # LeRobot 0.3; Isaac-GR00T, openpi\n\n"
    'dataset = LeRobotDataset("me/nav", root=".")',
}
_WHERE = {
    "v3.0": "`meta/episodes` also has split, scene, tier, target, template, goal and errors of every episode",
    "v2.1": "`meta/episodes.jsonl` also has split, scene, tier, target, template, goal and errors of every episode",
}
_IMAGES = {
    CameraOutput.RGB: "{width} x {height} RGB video (H.264, a key frame every other frame)",
    CameraOutput.DEPTH: "metric depth along the optical axis as lossless 12-bit video; 0 where nothing was hit",
    CameraOutput.IDS: "instance ids as 16-bit PNG; their meaning is listed in the original dataset's `meta.json`",
}
_RADIAL = "distance from the camera as lossless 12-bit video, metres; 0 where nothing was hit"
_HELD = """
A row has the latest measurement of each sensor at or before its time. `observation.<sensor>` is angular velocity
(rad/s) and specific force (m/s2) of an IMU, or the ranges of a lidar in metres, 0 without a return;
`observation.state` is the odometry of the rig if it has one.
"""


class LeRobotBase(Exporter[OptionsT, LeRobotFacts]):
    """Base class: writes videos and columns of an episode as a piece. Subclasses write the layout of a version."""

    requires = ("av",)
    assembles = True
    takes_rig = True
    rig_file = f"meta/{RIG_FILE}"
    facts = LeRobotFacts
    keeps_questions: ClassVar[bool] = False
    """Whether the version has a column of questions."""

    def check_rig(self, rig: Rig, options: OptionsT) -> None:
        """Validates that no feature occurs twice, and that width and height of videos are even numbers."""
        layout_of(CameraConfig(), rig)
        extra_layout_of(_widened(options), CameraConfig(), rig)

    def write_episode(self, episode: Episode, options: OptionsT, folder: Path) -> LeRobotFacts:
        """Writes videos and columns of one episode."""
        facts = write_piece(episode, _widened(options), folder)
        if not self.keeps_questions:
            return facts
        kept = kept_frames(len(episode), stride_of(options.fps, episode.meta.job.task.control_hz))
        questions = ask_questions(episode, kept) if episode.rig is None else not_asked(episode)
        return facts.model_copy(update={"questions": questions})


@dataclass(frozen=True)
class LeRobotExport:
    """Description of the exported dataset, with its output directory."""

    out: Output
    meta: DatasetMeta
    layout: Layout
    rig: Rig | None
    """Rig whose sensors are exported; `None` for the recorded camera."""
    stride: int
    """Stride of the exported frames."""
    fps: int
    """Frames per second of the export."""
    numbering: Numbering
    has_routes: bool
    """Whether the source has sub-instructions."""
    asked_about: str | None
    """Image feature that the questions of the source are about; `None` if the source has no questions, or if the images
    of a rig are exported."""
    questions: QuestionCount | None = None
    """Numbers of questions; `None` if the export has none."""
    extra: Layout | None = None
    """Layout of the second dataset, with depth and ids; `None` if neither is exported."""
    folder: str = ""
    """Prefix of the paths of all files of the dataset."""

    def with_extra(self) -> Iterator[LeRobotExport]:
        """Yields the second dataset, if there is one, then this one."""
        if self.extra is not None:
            yield replace(
                self,
                layout=self.extra,
                extra=None,
                has_routes=False,
                asked_about=None,
                folder=f"{self.folder}{EXTRA_FOLDER}/",
            )
        yield self

    def has(self, name: str) -> bool:
        """Returns whether an interrupted call has finished a file of the dataset."""
        return self.out.has(self.folder + name)

    def replacing(self, name: str) -> AbstractContextManager[Path]:
        """Opens a file of the dataset for writing, as `Output.replacing` does."""
        return self.out.replacing(self.folder + name)

    def write_card(self, version: str, configs: Configs) -> None:
        """Writes the card; `configs` maps names to the tables that `datasets` opens."""
        text, asked = card_text(version, self), questions_text(self.questions, has_file=False)
        episodes = len(self.numbering)
        card = export_card(self.meta, self.rig, episodes, text, configs, tags=["LeRobot"], questions=asked)
        self.out.write_text(CARD_FILE, card)

    def write_stats(self, stats: Stats) -> None:
        self._write_json("meta/stats.json", stats)

    def write_info(self, version: str, features: Mapping[str, Any] | None = None, **values: Any) -> None:
        """Writes `info.json`, the last file; `values` are inserted between version and features.

        Args:
            version: version of the format.
            features: additional features.
            values: additional values.
        """
        known = {
            "total_episodes": len(self.numbering),
            "total_frames": self.numbering.frames,
            "total_tasks": len(self.numbering.tasks),
        }
        shared = {
            "splits": self.numbering.splits,
            "robot_type": robot_name(self.meta.plan.robot, self.rig),
            "fps": self.fps,
            "features": features_of(self.layout, self.fps) | dict(features or {}),
        }
        self._write_json("meta/info.json", {"codebase_version": version, **known, **values, **shared})

    def _write_json(self, name: str, values: dict[str, Any]) -> None:
        self.out.write_text(self.folder + name, json.dumps(values, indent=4) + "\n")


def describe_dataset(export: Finish[Any, LeRobotFacts]) -> LeRobotExport:
    """Numbers the pieces of an export and returns the description of the dataset."""
    plan, options = export.dataset.meta.plan, _widened(export.options)
    is_asked = export.dataset.rig is None and has_questions(export.dataset.root, export.dataset.meta)
    stride = stride_of(options.fps, plan.task.control_hz)
    return LeRobotExport(
        out=export.out,
        meta=export.dataset.meta,
        layout=layout_of(plan.camera, export.dataset.rig, is_corrected=plan.correction is not None),
        extra=extra_layout_of(options, plan.camera, export.dataset.rig),
        rig=export.dataset.rig,
        stride=stride,
        fps=plan.task.control_hz // stride,
        numbering=number_pieces(export.pieces, stride),
        has_routes=has_routes(export.dataset.root),
        asked_about=RGB if is_asked else None,
        questions=export.questions,
    )


def _widened(options: Decimated) -> LeRobotOptions:
    """Converts the options of a version to `LeRobotOptions`."""
    return LeRobotOptions.model_validate(options.model_dump())


def card_text(version: str, dataset: LeRobotExport) -> str:
    """Returns the text of the card below the title."""
    fps, stride, splits = dataset.fps, dataset.stride, dataset.numbering.splits
    sensors = "" if dataset.rig is None else _HELD + rig_table(dataset.rig, fps * stride, LeRobotBase.rig_file)
    hub = (
        f"\nOn the Hub the repository needs a tag equal to the version, or LeRobot will not load it: "
        f'`HfApi().create_tag(REPO, tag="{version}", repo_type="dataset")`.\n'
    )
    return _TEXT.format(
        version=version,
        fps=fps,
        decimated="" if stride == 1 else f", one of {stride} recorded frames",
        example=_EXAMPLES[version],
        images="".join(f"| `{image.key}` | {_about(image)} |\n" for image in dataset.layout.images),
        sensors=sensors,
        mean="" if stride == 1 else _MEAN.format(stride=stride),
        splits=", ".join(f"{name} {span}" for name, span in splits.items()),
        where=_WHERE[version],
        hub=hub,
    )


def _about(image: ImageFeature) -> str:
    if image.output is CameraOutput.DEPTH and image.camera is not None and image.camera.depth is DepthKind.RADIAL:
        return _RADIAL
    return _IMAGES[image.output].format(width=image.width, height=image.height)

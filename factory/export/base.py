"""Base class of all exporters, with the models that it uses.

An export has two steps. `write_episode` runs in worker processes and writes the files of one episode, its *piece*, into
an empty folder; it returns *facts*, a small model that is stored with the piece. `finish` runs once with all pieces in
the order of the plan and writes the files of the whole export: tables, cards, shards.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from pydantic import Field

from factory.dataset.episode import Episode
from factory.dataset.reader import Dataset
from factory.export.options import Options
from factory.export.output import Output
from factory.export.questions import EpisodeQuestions, QuestionCount
from schemas.base import Model
from schemas.dataset.rows import EpisodeSummary
from schemas.rig import Rig


class EpisodeFacts(Model):
    """Facts that `finish` needs about a piece. Stored as JSON, so a resumed export can read them."""

    frames: int
    """Number of frames written."""
    questions: EpisodeQuestions | None = Field(default=None, exclude_if=lambda it: it is None)
    """Questions about the episode; `None` if it has none, or if the format does not contain questions."""


OptionsT = TypeVar("OptionsT", bound=Options)
FactsT = TypeVar("FactsT", bound=EpisodeFacts)


@dataclass(frozen=True, slots=True)
class ExportPiece(Generic[FactsT]):
    """One exported episode, as passed to `finish`. Small, because an export can have hundreds of thousands of them."""

    dataset: Dataset
    position: int
    """Index of the episode in `dataset`."""
    episode_id: str
    split: str
    folder: Path
    """Folder of the files of `write_episode` if the exporter `assembles`; otherwise the files are in OUT already."""
    facts_path: Path
    """JSON file of the facts. It is written last, so its existence marks a complete piece."""
    facts_type: type[FactsT]

    @property
    def facts(self) -> FactsT:
        """Facts that `write_episode` returned; read from disk on each access."""
        return self.facts_type.model_validate_json(self.facts_path.read_bytes())

    @property
    def episode(self) -> Episode:
        """The episode. Its file is opened at the first access to its content."""
        return self.dataset[self.position]

    @property
    def summary(self) -> EpisodeSummary:
        """Row of the episode in the metadata; parsed on each access."""
        return self.episode.summary


@dataclass(frozen=True)
class Finish(Generic[OptionsT, FactsT]):
    """Input of `finish`."""

    dataset: Dataset
    """Selected episodes, including skipped episodes, which have no piece."""
    options: OptionsT
    pieces: Sequence[ExportPiece[FactsT]]
    """Pieces in the order of the plan; at least one."""
    out: Output
    """Output directory; all writes go through it."""
    questions: QuestionCount | None = None
    """Numbers of questions; `None` if the episodes have none, or if the format does not contain questions."""


class Exporter(ABC, Generic[OptionsT, FactsT]):
    """Export format. Stateless; created in every process by its name in the registry.

    A piece has the directory tree of OUT, e.g. `episodes/ep_000001/meta.json`; its files are synced and renamed into
    OUT. If pieces must be joined into shards or numbered, `assembles` is true; pieces are then stored in a hidden
    folder, and deleted after `finish`.
    """

    name: ClassVar[str]
    """Name of the format, the value of `--to`."""
    about: ClassVar[str]
    """Description of the format for the help, one line."""
    version: ClassVar[int] = 1
    """Version of the writer; incremented when the files that it writes change. Unfinished exports of other versions are
    refused."""
    requires: ClassVar[tuple[str, ...]] = ()
    """Top-level modules that the format needs; their versions are recorded in the manifest."""
    assembles: ClassVar[bool] = False
    renders: ClassVar[bool] = True
    """Whether the format contains frames, which are rendered for each export of a states dataset."""
    asks: ClassVar[bool] = False
    """Whether the export has `questions.jsonl`, with the path of the picture of each question."""
    takes_rig: ClassVar[bool] = False
    """Whether the format can contain the sensors of `Episode.rig`."""
    rig_file: ClassVar[str] = "rig.json"
    """Path of the description of the cameras and sensors, which every export has."""
    options: type[OptionsT]
    facts: type[FactsT]

    def check_rig(self, rig: Rig, options: OptionsT) -> None:
        """Validates that the format can contain the sensors of a rig, before anything is written.

        Raises:
            UsageError: a sensor cannot be written with these options; the message names it and the remedy.
        """

    @abstractmethod
    def write_episode(self, episode: Episode, options: OptionsT, folder: Path) -> FactsT:
        """Writes one episode into an empty folder. Memory use does not depend on its length.

        Equal episodes and options give equal files. The caller syncs, renames and deletes files.

        Raises:
            ArchiveCorrupt: the episode is damaged; the export skips and reports it.
        """

    @abstractmethod
    def finish(self, export: Finish[OptionsT, FactsT]) -> None:
        """Writes the files of the whole export through `export.out`.

        It is called again after an interruption, or when a skipped episode has become available; `export.out.has`
        returns whether an interrupted call has finished a file. Memory use does not depend on the size of the episodes.
        """


AnyExporter = Exporter[Any, Any]
"""Exporter of any format."""

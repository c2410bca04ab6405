"""What a format is to the export: the base class of all exporters and the words it speaks. Does no I/O.

An exporter is used in two steps. `write_episode` runs in one process a core and writes the files of one episode, its
*piece*, into an empty folder; it returns *facts*, small numbers and strings that are kept beside. `finish` runs once,
with all pieces in the order of the plan, and writes what belongs to no single episode: tables, cards, shards.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Generic, TypeVar

from factory.dataset.episode import Episode
from factory.dataset.reader import Dataset
from factory.export.output import Output
from schemas.base import Model
from schemas.dataset import EpisodeSummary
from schemas.dataset_meta import DatasetMeta

__all__ = ["EpisodeFacts", "ExportPiece", "Exporter", "Finish", "Options"]


class Options(Model):
    """What a user can choose of a format: each field becomes an option of the command line with its description.

    Fields are `bool`, `int`, `int | None` or a `Literal` of strings, and all have defaults; a field that another format
    has too must be the same.
    """

    def check(self, meta: DatasetMeta) -> None:
        """Holds the options against a dataset, before anything is written.

        Raises:
            UsageError: they contradict each other or the dataset, e.g. a rate that does not divide the dataset's.
        """


class EpisodeFacts(Model):
    """What `finish` must know of a piece without opening it; kept as JSON, so that a resumed export has it too."""

    frames: int
    """Frames written."""


OptionsT = TypeVar("OptionsT", bound=Options)
FactsT = TypeVar("FactsT", bound=EpisodeFacts)


@dataclass(frozen=True, slots=True)
class ExportPiece(Generic[FactsT]):
    """One exported episode, as `finish` sees it; cheap to hold by the hundred thousand."""

    dataset: Dataset
    position: int
    """Among the episodes of `dataset`."""
    episode_id: str
    split: str
    folder: Path
    """What `write_episode` wrote, where the format assembles; otherwise those files lie below OUT already."""
    facts_path: Path
    facts_type: type[FactsT]

    @property
    def facts(self) -> FactsT:
        """What `write_episode` returned; read from disk each time."""
        return self.facts_type.model_validate_json(self.facts_path.read_bytes())

    @property
    def episode(self) -> Episode:
        """The episode itself, closed; its `summary` is its row of the metadata."""
        return self.dataset[self.position]

    @property
    def summary(self) -> EpisodeSummary:
        """Its row of the metadata; parsed each time."""
        return self.episode.summary


@dataclass(frozen=True)
class Finish(Generic[OptionsT, FactsT]):
    """All that `finish` works with."""

    dataset: Dataset
    """The episodes that were asked for; those that had to be skipped are among them, but not among the pieces."""
    options: OptionsT
    pieces: Sequence[ExportPiece[FactsT]]
    """At least one, in the order of the plan."""
    out: Output
    """The only door to the directory of the export."""


class Exporter(ABC, Generic[OptionsT, FactsT]):
    """One format. Stateless; made anew in every process, by the name in the registry.

    A piece holds the tree as it shall lie below OUT, e.g. `episodes/ep_000001/meta.json`: its files are made durable
    and then renamed there. Where pieces must first be joined to shards or numbered, `assembles` is true; pieces then
    wait in a hidden folder until `finish` has put them together, and are deleted.
    """

    name: ClassVar[str]
    """As said after `--to`."""
    about: ClassVar[str]
    """One line for the help."""
    version: ClassVar[int] = 1
    """Of our writer; rises when its files change, so that an unfinished export of an older one is not continued."""
    requires: ClassVar[tuple[str, ...]] = ()
    """Top-level modules that write it; their versions are recorded in the manifest."""
    assembles: ClassVar[bool] = False
    options: type[OptionsT]
    facts: type[FactsT]

    @abstractmethod
    def write_episode(self, episode: Episode, options: OptionsT, folder: Path) -> FactsT:
        """Writes one episode into an empty folder; memory does not grow with its length.

        Equal episodes and options give equal files. Syncing, renaming and cleaning up are the caller's.

        Raises:
            ArchiveCorrupt: the episode is damaged; it will be skipped and named.
        """

    @abstractmethod
    def finish(self, export: Finish[OptionsT, FactsT]) -> None:
        """Writes what belongs to no single episode, file by file through `export.out`.

        Called again when it was interrupted, or when an episode that was skipped has come in; `export.out.has` tells
        which files an interrupted call has finished. Memory does not grow with the size of the episodes.
        """

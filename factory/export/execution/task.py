"""Making one piece: what a process of the export does with one episode. Writes into its staging folder only."""

from __future__ import annotations

import shutil
from pathlib import Path

from factory.dataset.episode import Episode
from factory.export.output import sync_tree
from factory.export.registry import find_exporter
from schemas.base import Model
from schemas.errors import ArchiveCorrupt, InvalidBundle
from schemas.storage.disk import translated

__all__ = ["ExportTask", "Made", "make_piece"]


class ExportTask:
    """An episode to export, as it is sent to a process."""

    def __init__(self, exporter: str, options: str, episode: Episode, folder: Path) -> None:
        self.exporter = exporter
        self.options = options
        """As JSON."""
        self.episode = episode
        self.folder = folder
        """To make the piece in; not there yet."""


class Made(Model):
    """What became of a task."""

    episode_id: str
    facts: str | None = None
    """As JSON; the folder holds the synced piece."""
    damage: str | None = None
    """Why there is none; the folder is gone."""
    frames: int = 0


def make_piece(task: ExportTask) -> Made:
    """Exports one episode into its staging folder.

    Raises:
        WorldError: the disk is full or gone; the folder is gone as well.
    """
    name, folder = task.episode.episode_id, task.folder
    exporter = find_exporter(task.exporter)
    options = exporter.options.model_validate_json(task.options)
    whole = False
    try:
        with translated("write", folder), task.episode as episode:
            folder.mkdir(parents=True)
            _require_as_listed(episode)
            facts = exporter.write_episode(episode, options, folder)
            sync_tree(folder)
        whole = True
    except ArchiveCorrupt as error:
        return Made(episode_id=name, damage=str(error))
    except InvalidBundle as error:
        text = f"{task.episode.path} is damaged ({'; '.join(error.findings)}): run `factory verify --deep`"
        return Made(episode_id=name, damage=text)
    finally:
        if not whole:
            shutil.rmtree(folder, ignore_errors=True)
    return Made(episode_id=name, facts=facts.model_dump_json(), frames=facts.frames)


def _require_as_listed(episode: Episode) -> None:
    """Refuses a file that was swapped or replaced behind the tables' back."""
    meta, row = episode.meta, episode.summary
    if (meta.episode_id, meta.content_digest) != (row.episode_id, row.content_digest):
        found = f"{meta.episode_id} with content digest {meta.content_digest}, the metadata says {row.content_digest}"
        raise ArchiveCorrupt(f"{episode.path} holds {found}: run `factory verify --deep`")

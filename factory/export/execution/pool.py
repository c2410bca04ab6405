"""Exports one episode, in a worker process or in the calling process. A task writes into its staging folder only."""

from __future__ import annotations

import shutil
from pathlib import Path

from factory.dataset.episode import Episode
from factory.export.output import sync_tree
from factory.export.registry import find_exporter
from schemas.base import Model
from schemas.errors import ArchiveCorrupt, InvalidBundle
from schemas.storage.disk import translated


class ExportTask:
    """Picklable task: one episode to export."""

    def __init__(self, exporter: str, options: str, episode: Episode, folder: Path) -> None:
        self.exporter = exporter
        self.options = options
        """Options as JSON."""
        self.episode = episode
        self.folder = folder
        """Staging folder; it does not exist yet."""


class PieceResult(Model):
    """Result of a task: facts or damage."""

    episode_id: str
    facts: str | None = None
    """Facts as JSON; the folder contains the synced piece."""
    damage: str | None = None
    """Reason why the episode could not be exported; the folder is deleted."""
    frames: int = 0


def make_piece(task: ExportTask) -> PieceResult:
    """Exports one episode into its staging folder.

    Raises:
        WorldError: the disk is full or not available; the folder is deleted.
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
        return PieceResult(episode_id=name, damage=str(error))
    except InvalidBundle as error:
        text = f"{task.episode.path} is damaged ({'; '.join(error.findings)}): run `factory verify --deep`"
        return PieceResult(episode_id=name, damage=text)
    finally:
        if not whole:
            shutil.rmtree(folder, ignore_errors=True)
    return PieceResult(episode_id=name, facts=facts.model_dump_json(), frames=facts.frames)


def _require_as_listed(episode: Episode) -> None:
    """Validates that the content of a file matches its row of the metadata."""
    meta, row = episode.meta, episode.summary
    if (meta.episode_id, meta.content_digest) != (row.episode_id, row.content_digest):
        found = f"{meta.episode_id} with content digest {meta.content_digest}, but the table has {row.content_digest}"
        raise ArchiveCorrupt(f"{episode.path} contains {found}: run `factory verify --deep`")

"""Reads the recorded actions of archived episodes for policies that replay them. Runs no policies."""

from __future__ import annotations

from pathlib import Path

from factory.eval.models.request import Actions
from schemas.bundle import BundleReader
from schemas.dataset import file_name_of
from schemas.errors import ArchiveCorrupt, InvalidBundle

__all__ = ["read_actions_of"]


def read_actions_of(root: Path, episode: str) -> Actions:
    """Returns the recorded commands of an episode.

    Args:
        root: Dataset directory.
        episode: Episode id.

    Raises:
        ArchiveCorrupt: The episode is missing or damaged.
    """
    path = root / file_name_of(episode)
    try:
        with path.open("rb") as file:
            commands = BundleReader(file).arrays.actions_continuous
    except FileNotFoundError as error:
        raise ArchiveCorrupt(f"{path} is missing: run `factory verify`") from error
    except InvalidBundle as error:
        raise ArchiveCorrupt(f"{path} is damaged ({'; '.join(error.findings)}): run `factory verify --deep`") from error
    return tuple((float(v), float(w)) for v, w in commands)

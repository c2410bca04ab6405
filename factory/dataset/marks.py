"""Flags and notes about episodes, stored in one JSON file beside the dataset; usable as `factory export --exclude`."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError

from factory.dataset.site import Site
from schemas.base import Model, Name
from schemas.errors import WorldError
from schemas.storage.dataset_files import MARKS_FILE
from schemas.storage.disk import replacing

MOST_NOTE_CHARS = 2000
"""Largest length of a note, characters."""


class Mark(Model):
    """Flag and note of one episode."""

    flagged: bool = False
    """Whether the episode is excluded by `factory export --exclude`."""
    note: Annotated[str, Field(max_length=MOST_NOTE_CHARS)] = ""
    """Free text."""


class MarksFile(Model):
    """Content of `marks.json`."""

    marks_format: int = 1
    """Version of the format."""
    marks: dict[Name, Mark] = Field(default_factory=dict)
    """Flag and note by the id of the episode."""


def read_marks(path: Path) -> dict[str, Mark]:
    """Returns flags and notes by episode id; empty if the file does not exist.

    Raises:
        WorldError: the file is damaged.
    """
    try:
        return dict(MarksFile.model_validate_json(path.read_bytes()).marks)
    except FileNotFoundError:
        return {}
    except (OSError, ValidationError) as error:
        raise WorldError(f"{path} cannot be read ({error}): restore or delete the file") from error


def excluded_in(path: Path) -> list[str]:
    """Returns the ids of the flagged episodes of a marks file, or the ids in a text file with one id on each line.

    Raises:
        WorldError: the file does not exist or is damaged.
    """
    if not path.is_file():
        raise WorldError(f"{path} does not exist")
    if path.suffix == ".json":
        return sorted(name for name, mark in read_marks(path).items() if mark.flagged)
    try:
        return [line.strip() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise WorldError(f"{path} cannot be read: {error}") from error


class Marks:
    """Flags and notes of a dataset; thread-safe. For a dataset in object storage, the file is in the state directory.

    Args:
        site: location of the dataset.
    """

    def __init__(self, site: Site) -> None:
        # a file and not a column of `metadata.parquet`, which the coordinator rewrites from the ledger
        self._path = site.state_dir / MARKS_FILE
        self._writing = threading.Lock()

    def read(self) -> dict[str, Mark]:
        """Returns flags and notes by episode id.

        Raises:
            WorldError: the file is damaged.
        """
        return read_marks(self._path)

    def write(self, episode_id: str, mark: Mark) -> None:
        """Replaces flag and note of an episode. An episode with neither a flag nor a note is removed from the file.

        Raises:
            WorldError: the file is damaged or cannot be written.
        """
        with self._writing:
            marks = {**self.read(), episode_id: mark}
            kept = {name: marks[name] for name in sorted(marks) if marks[name] != Mark()}
            text = json.dumps(MarksFile(marks=kept).model_dump(mode="json"), indent=1, ensure_ascii=False)
            with replacing(self._path, durable=True) as part:
                part.write_text(f"{text}\n", encoding="utf-8")

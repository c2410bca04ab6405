"""Shards of a run: contiguous parts of its episode numbers, and the file in which a shard records its state.

A shard has a separate dataset directory and ledger; `factory gather` joins the shards of a run. They are not the
shards of `schemas.storage.shards`, which are files with packed episodes in one dataset.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from datetime import datetime
from typing import Annotated, Self

from pydantic import Field, ValidationError, model_validator

from schemas.base import Count, Line, Model, Ordinal, Sha256
from schemas.errors import ArchiveCorrupt, UsageError
from schemas.protocol.status import Counts
from schemas.storage.dataset_files import RUN_SHARD_FILE
from schemas.storage.place import Place, children

_WRITTEN = re.compile(r"([0-9]{1,9})/([0-9]{1,9})", re.ASCII)
_MAX_VERSIONS = 100


class RunShard(Model):
    """One of several parts of a run."""

    number: Ordinal
    """Number of the shard, from 1."""
    count: Ordinal
    """Number of shards of the run."""

    @model_validator(mode="after")
    def _is_in_range(self) -> Self:
        if self.number > self.count:
            raise ValueError(f"shard {self.number} does not exist: the run has {self.count} shards")
        return self

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def numbers(self, episodes: int) -> range:
        """Returns the episode numbers of the shard in a run of `episodes` episodes; a shard may be empty."""
        return range((self.number - 1) * episodes // self.count + 1, self.number * episodes // self.count + 1)


class ShardState(Model):
    """Content of `run_shard.json`, which a shard writes when it starts, every half minute, and when it ends."""

    format: int = 1
    """Version of the file."""
    shard: RunShard
    """The shard."""
    run: Line
    """Name of the run."""
    plan_digest: Sha256
    """Digest of the plan."""
    versions: Annotated[tuple[Line, ...], Field(max_length=_MAX_VERSIONS)]
    """Versions of minivla-factory that have run the shard, sorted."""
    scenes: dict[str, Sha256]
    """Digest of the compiled package by scene name."""
    host: Line
    """Host that wrote the file."""
    planned: Count
    """Number of episodes of the shard."""
    jobs: Counts
    """Number of episodes by the state of their current draw."""
    attempts: Counts
    """Number of attempts by outcome."""
    finished: bool
    """Whether the shard has ended: its episodes and tables are complete and will not change."""
    updated_at: datetime
    """Time of writing by the clock of the host, UTC."""


def parse_shard(text: str) -> RunShard:
    """Returns the shard that is written as `NUMBER/COUNT`.

    Raises:
        UsageError: the text has a different form, or the number is out of range.
    """
    match = _WRITTEN.fullmatch(text)
    if match is None:
        raise UsageError(f"{text!r} is not a valid shard; example: 7/200, which is the seventh of 200 shards")
    number, count = map(int, match.groups())
    if not 1 <= number <= count:
        raise UsageError(f"shard {text} does not exist: the shards of a run are 1/{count} to {count}/{count}")
    return RunShard(number=number, count=count)


def read_shard_state(root: Place) -> ShardState | None:
    """Returns the state of a shard, or `None` if the directory is not a shard.

    Raises:
        ArchiveCorrupt: the file is damaged.
    """
    path = root / RUN_SHARD_FILE
    try:
        return ShardState.model_validate_json(path.read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        return None
    except ValidationError as error:
        raise ArchiveCorrupt(
            f"{path} is damaged ({error.errors()[0]['msg']}): remove it, and continue the shard with the command that "
            "started it"
        ) from error


def find_shards(folder: Place) -> Iterator[tuple[Place, ShardState]]:
    """Yields the shards in a folder, or the folder itself if it is a shard, with their states.

    Raises:
        ArchiveCorrupt: the file of a shard is damaged.
    """
    state = read_shard_state(folder)
    if state is not None:
        yield folder, state
        return
    for place in children(folder):
        state = read_shard_state(place)
        if state is not None:
            yield place, state


def to_text(state: ShardState) -> str:
    """Returns the content of `run_shard.json`."""
    return json.dumps(state.model_dump(mode="json"), indent=2) + "\n"

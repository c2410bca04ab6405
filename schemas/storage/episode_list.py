"""Lists the episodes of a dataset, as files and in shards, and the faults of the shards. Reads no episode."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from operator import itemgetter

import numpy as np

from schemas.job import episode_id, index_of_file
from schemas.storage.dataset_files import EPISODES
from schemas.storage.object_path import ObjectPath
from schemas.storage.place import FilePlace, Place, children
from schemas.storage.shard_index import ShardIndex, open_shard, read_index
from schemas.storage.shards import ShardDirectory, empty_directory, is_shard


@dataclass(frozen=True)
class EpisodeList:
    """Content of the episode folder of a dataset."""

    episodes: dict[int, FilePlace]
    """Path of each episode by number, ascending; for an episode that is stored twice, the path in a shard."""
    shards: int
    """Number of shards."""
    foreign: list[Place] = field(default_factory=list)
    """Paths that are neither episodes nor shards."""
    damaged: dict[str, str] = field(default_factory=dict)
    """Damage of shards by file name; their intact episodes are listed."""
    twice: list[str] = field(default_factory=list)
    """Descriptions of episodes that are stored twice."""
    index_fault: str = ""
    """Description of a missing, damaged or outdated index; empty for a correct one."""


def list_episodes(root: Place) -> EpisodeList:
    """Lists a dataset; reads the directories of its shards and the index.

    Raises:
        WorldError: the store does not answer.
    """
    folder = root / EPISODES
    files: dict[int, FilePlace] = {}
    foreign, damaged, shards = list[Place](), dict[str, str](), list[ShardDirectory]()
    for path in sorted(folder.walk()) if isinstance(folder, ObjectPath) else children(folder):
        is_regular = path.parent == folder and path.is_file() and not path.is_symlink()
        index = index_of_file(path.name) if is_regular else None
        if index is not None:
            files[index] = path
        elif is_regular and is_shard(path.name):
            shard, damage = _read_shard(path)
            shards.append(shard)
            damaged |= {path.name: damage} if damage else {}
        else:
            foreign.append(path)
    packed = ShardIndex.of(folder, shards)
    files_by_index = files | dict(reversed(list(packed))) if len(packed) else files
    ordered = dict(sorted(files_by_index.items(), key=itemgetter(0)))
    twice, index_fault = list(_find_twice(files, packed)), _index_fault(root, packed)
    return EpisodeList(ordered, len(shards), foreign=foreign, damaged=damaged, twice=twice, index_fault=index_fault)


def _read_shard(path: Place) -> tuple[ShardDirectory, str]:
    try:
        return open_shard(path)
    except OSError as error:
        return empty_directory(path.name), f"cannot be read: {error.strerror}"


def _find_twice(files: dict[int, FilePlace], packed: ShardIndex) -> Iterator[str]:
    for position in np.flatnonzero(np.diff(packed.numbers) == 0).tolist():
        one, two = packed.at(position), packed.at(position + 1)
        yield f"{one.stem} is in {one.shard.name} and in {two.shard.name}"
    for number in sorted(files.keys() & set(packed.numbers.tolist())) if files else ():
        path = packed.find(number)
        yield f"{episode_id(number)} is a file and in {path.shard.name if path is not None else 'a shard'}"


def _index_fault(root: Place, packed: ShardIndex) -> str:
    stored = read_index(root)
    if stored is None:
        return f"is missing or damaged; {len(packed)} episodes are packed" if len(packed) else ""
    same = stored.names == packed.names and all(
        np.array_equal(getattr(stored, name), getattr(packed, name))
        for name in ("numbers", "shards", "offsets", "sizes")
    )
    return "" if same else f"lists {len(stored)} episodes and does not match the shards, which contain {len(packed)}"

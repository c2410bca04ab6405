"""Base class of archives: episodes are files, or members of shards. Independent of the storage.

A shard is written, synced and published before the files of its episodes are deleted, so an interruption can leave an
episode that is stored twice. When the archive is opened, one of the two copies is deleted if their bytes are equal,
and quarantined if they differ. The module does not decide which episodes are packed.
"""

from __future__ import annotations

import hashlib
import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import TypeVar

import numpy as np
import structlog

from coordinator.archive.staging import Staging
from schemas.dataset.rows import file_name_of
from schemas.errors import ArchiveCorrupt
from schemas.job import episode_id, index_of_file
from schemas.storage.dataset_files import EPISODES, SHARDS_FILE
from schemas.storage.disk import translated
from schemas.storage.packed_path import PackedPath
from schemas.storage.place import FilePlace, Place
from schemas.storage.shard_index import ShardIndex, open_shard, read_index, write_index
from schemas.storage.shards import (
    MAX_PACKED_BYTES,
    ShardDirectory,
    is_shard,
    range_of_shard,
    read_shard,
    shard_name,
    write_shard,
)

_THREADS = 8
_AHEAD = 64
"""Number of items that `in_threads` processes at a time."""
T = TypeVar("T")
R = TypeVar("R")

log = structlog.get_logger(__name__)


class PackingArchive(ABC):
    """Listing of the episode folder, and packing of its files into shards; see `Archive`."""

    root: Place
    _staging: Staging

    def __init__(self) -> None:
        self._packing = threading.RLock()
        self._directories: dict[str, ShardDirectory] = {}
        self._index: ShardIndex | None = None

    @abstractmethod
    def _listing(self) -> Iterator[tuple[int | None, Place]]:
        """Yields the paths in the episode folder in any order, each with its episode number or `None`."""

    @abstractmethod
    def _store_shard(self, part: Path, name: str) -> None:
        """Publishes a synced part file durably as a shard.

        An existing file of that name has the same bytes or is damaged.
        """

    @abstractmethod
    def _delete(self, places: Collection[Place]) -> None:
        """Deletes files of the episode folder durably; files that do not exist are ignored."""

    @abstractmethod
    def _set_aside(self, path: Place, reason: str) -> Place:
        """Moves a file to the quarantine folder, writes the reason to a file beside it, and returns the new path."""

    @abstractmethod
    def _keep_copy(self, path: PackedPath, reason: str) -> Place:
        """Copies a packed episode durably to the quarantine folder, writes the reason, and returns the new path."""

    @abstractmethod
    def replacing(self, name: str) -> AbstractContextManager[Path]:
        """See `Archive.replacing`."""

    @property
    def _shards(self) -> ShardIndex:
        index = self._index
        if index is None:
            with self._packing:
                index = self._index = ShardIndex.of(self.root / EPISODES, self._directories.values())
        return index

    def path_of(self, index: int) -> FilePlace:
        return self._shards.find(index) or self._file_of(index)

    def present(self) -> dict[int, FilePlace]:
        with self._packing:  # while an episode is packed, it is stored twice
            packed: dict[int, FilePlace] = dict(self._shards)
            return dict(sorted((packed | self.unpacked()).items(), key=itemgetter(0)))

    def unpacked(self) -> dict[int, Place]:
        numbered = ((index, path) for index, path in self._listing() if index is not None)
        return dict(sorted(numbered, key=itemgetter(0)))

    def foreign(self) -> list[Place]:
        known = {self.root / EPISODES / name for name in self._directories}
        return sorted(path for index, path in self._listing() if index is None and path not in known)

    def shards(self) -> Sequence[str]:
        return self._shards.names

    def pack(self, owned: Mapping[int, str], first: int, last: int) -> int:
        with self._packing:
            shard = self._write_shard(self._whole_files(owned), first, last)
            self._delete([self._file_of(int(number)) for number in shard.numbers])
        return len(shard.numbers)

    def write_shard_index(self) -> None:
        with self._packing, self.replacing(SHARDS_FILE) as path:
            write_index(path, self._shards)

    def unpublish(self, index: int) -> None:
        with self._packing:
            self._delete([self._file_of(index)])
            packed = self._shards.find(index)
            if packed is not None:
                self._remove(packed.shard.name, {index})

    def quarantine(self, path: FilePlace, reason: str) -> Place:
        if not isinstance(path, PackedPath):
            return self._set_aside(path, reason)
        index = index_of_file(path.name) or 0
        with self._packing:
            current = self._shards.find(index) or path  # the shard may have been replaced since the path was listed
            kept = self._keep_copy(current, reason)
            self._remove(current.shard.name, {index})
        return kept

    def _file_of(self, index: int) -> Place:
        """Returns the path of an episode that is not packed."""
        return self.root / file_name_of(episode_id(index))

    def _require_free(self, index: int) -> None:
        """Checks that an episode is not stored yet.

        Raises:
            ArchiveCorrupt: the episode is stored.
        """
        final = self.path_of(index)
        if final.exists():
            raise ArchiveCorrupt(f"{final} already exists and is not overwritten: run `factory verify --deep`")

    def _whole_files(self, owned: Mapping[int, str]) -> Iterator[tuple[int, bytes]]:
        """Yields episode number and content of each file that can be packed, in ascending order of the numbers."""
        wanted = [index for index in sorted(owned) if self._shards.find(index) is None]
        for index, data in zip(wanted, in_threads(self._read_file, wanted), strict=True):
            if isinstance(data, str):
                why = data
            elif len(data) > MAX_PACKED_BYTES:
                why = f"{len(data)} bytes; a packed episode has at most {MAX_PACKED_BYTES}"
            elif hashlib.sha256(data).hexdigest() != owned[index]:
                why = f"its SHA-256 is not {owned[index]}"
            else:
                yield index, data
                continue
            log.warning("episode_not_packed", episode=episode_id(index), why=why, remedy="run `factory verify`")

    def _read_file(self, index: int) -> bytes | str:
        try:
            return self._file_of(index).read_bytes()
        except OSError as error:
            return f"cannot be read: {error.strerror}"

    def _write_shard(self, episodes: Iterable[tuple[int, bytes]], first: int, last: int) -> ShardDirectory:
        """Publishes episodes of one range of numbers as a shard, and returns the ZIP directory of the shard.

        Without episodes, nothing is published.
        """
        part = self._staging.part(f"shard_{first:06d}")
        try:
            with translated("write", part.parent), part.open("x+b") as file:
                write_shard(file, episodes)
                os.fsync(file.fileno())
                file.seek(0)
                name = shard_name(first, last, hashlib.file_digest(file, "sha256").hexdigest())
                shard = read_shard(file, name)
            if len(shard.numbers):
                self._store_shard(part, name)
                self._directories[name] = shard
                self._index = None
        finally:
            part.unlink(missing_ok=True)
        return shard

    def _remove(self, name: str, indices: Collection[int]) -> None:
        """Removes episodes from a shard by replacing it with a new shard."""
        one = ShardIndex.of(self.root / EPISODES, [self._directories[name]])
        rest = ((index, path.read_bytes(checked=False)) for index, path in one if index not in indices)
        self._write_shard(rest, *range_of_shard(name))
        del self._directories[name]
        self._index = None
        self._delete([self.root / EPISODES / name])
        self.write_shard_index()

    def _open_shards(self) -> None:
        """Reads the ZIP directories of the shards, and completes packing that an interrupted process began.

        Raises:
            WorldError: a shard cannot be read, or a file cannot be written.
        """
        listed = list(self._listing())
        folder = self.root / EPISODES
        for place in [path for _, path in listed if path.parent == folder and _is_regular_shard(path)]:
            with translated("read", place):
                shard, damage = open_shard(place)
            if damage:
                self._replace_damaged(place, shard, damage)
            else:
                self._directories[place.name] = shard
        if self._directories:
            self._settle_files({index: path for index, path in listed if index is not None})
            self._settle_shards()
        stored = read_index(self.root)
        if set(stored.names if stored is not None else ()) != self._directories.keys():
            self.write_shard_index()

    def _replace_damaged(self, place: Place, directory: ShardDirectory, damage: str) -> None:
        """Writes a new shard with the intact episodes of a damaged shard, and quarantines the damaged shard."""
        intact = ShardIndex.of(self.root / EPISODES, [directory])
        shard = self._write_shard(((index, path.read_bytes()) for index, path in intact), *range_of_shard(place.name))
        reason = f"{damage}; {len(intact)} intact episodes are kept in {shard.name}" if len(intact) else damage
        # if the names are equal, only the ZIP directory was damaged, and the new shard has replaced the damaged file
        if shard.name != place.name:
            self._set_aside(place, reason)
        log.warning("shard_damaged", shard=str(place), why=reason, remedy="missing episodes are generated again")

    def _settle_files(self, files: Mapping[int, Place]) -> None:
        """Deletes the files of packed episodes that equal the packed bytes, and quarantines the files that differ."""
        twice = [(path, packed) for index, path in files.items() if (packed := self._shards.find(index)) is not None]
        equal = list(in_threads(lambda pair: pair[0].read_bytes() == pair[1].read_bytes(checked=False), twice))
        self._delete([path for (path, _), same in zip(twice, equal, strict=True) if same])
        for (path, packed), same in zip(twice, equal, strict=True):
            if not same:
                self._set_aside(path, f"differs from the same episode in {packed.shard.name}")

    def _settle_shards(self) -> None:
        """Keeps one copy of an episode that is in two shards; quarantines the other copy if it differs."""
        index, surplus = self._shards, dict[str, set[int]]()
        for position in np.flatnonzero(np.diff(index.numbers) == 0).tolist():
            kept, twice = index.at(position), index.at(position + 1)
            if kept.read_bytes(checked=False) != twice.read_bytes(checked=False):
                self._keep_copy(twice, f"differs from the same episode in {kept.shard.name}")
            surplus.setdefault(twice.shard.name, set()).add(int(index.numbers[position]))
        for name, indices in surplus.items():
            self._remove(name, indices)


def _is_regular_shard(path: Place) -> bool:
    return is_shard(path.name) and path.is_file() and not path.is_symlink()


def in_threads(work: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    """Applies a function to items in several threads, and yields the results in the order of the items.

    Works on `_AHEAD` items at a time, so memory holds at most as many results.
    """
    rest = iter(items)
    with ThreadPoolExecutor(_THREADS) as pool:
        while batch := list(islice(rest, _AHEAD)):
            yield from pool.map(work, batch)

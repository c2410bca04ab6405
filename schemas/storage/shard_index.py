"""Locates the packed episodes of a dataset by `shards.parquet`, or by the directories of its shards.

The index is derived from the shards. A reader whose index is missing, damaged or outdated reads the directories of the
shards. Does not change shards.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.errors import InvalidBundle
from schemas.job import episode_id
from schemas.storage.dataset_files import EPISODES, SHARDS_FILE
from schemas.storage.object_path import ObjectPath
from schemas.storage.packed_path import PackedPath
from schemas.storage.place import FilePlace, Place, children, table_of
from schemas.storage.shards import (
    MAX_PACKED_BYTES,
    ShardDirectory,
    empty_directory,
    is_shard,
    read_shard,
    salvage_shard,
)
from schemas.support.foreign import PARSER_ERRORS

_COLUMNS = ("episode", "shard", "offset", "size")


@dataclass(frozen=True)
class ShardIndex:
    """Location of each packed episode of a dataset; if an episode is packed twice, the first shard by name applies."""

    folder: Place
    """Folder of the shards."""
    names: tuple[str, ...]
    """File names of the shards."""
    numbers: NDArray[np.int64]
    """Episode numbers, ascending."""
    shards: NDArray[np.int64]
    """Position in `names` of the shard of each episode."""
    offsets: NDArray[np.int64]
    """Offset of each episode file in its shard."""
    sizes: NDArray[np.int64]
    """Size of each episode file, bytes."""

    @classmethod
    def of(cls, folder: Place, shards: Iterable[ShardDirectory]) -> ShardIndex:
        ordered = sorted(shards, key=lambda shard: shard.name)
        positions = [np.full(len(shard.numbers), position, np.int64) for position, shard in enumerate(ordered)]
        columns = [_joined(shard.numbers for shard in ordered), _joined(positions)]
        columns += [_joined(shard.offsets for shard in ordered), _joined(shard.sizes for shard in ordered)]
        order = np.argsort(columns[0], kind="stable")
        return cls(folder, tuple(shard.name for shard in ordered), *(column[order] for column in columns))

    def find(self, number: int) -> PackedPath | None:
        """Returns the path of an episode, or `None` if no shard contains the episode. Reads nothing."""
        position = int(np.searchsorted(self.numbers, number))
        if position == len(self.numbers) or self.numbers[position] != number:
            return None
        return self.at(position)

    def __iter__(self) -> Iterator[tuple[int, PackedPath]]:
        """Yields number and path of each episode, by ascending number; an episode in two shards is yielded twice."""
        return ((number, self.at(position)) for position, number in enumerate(self.numbers.tolist()))

    def __len__(self) -> int:
        return len(self.numbers)

    @functools.cached_property
    def _paths(self) -> tuple[Place, ...]:
        return tuple(self.folder / name for name in self.names)

    def at(self, position: int) -> PackedPath:
        """Returns the path of the episode at a position in the columns."""
        shard = self._paths[self.shards[position]]
        name = f"{episode_id(int(self.numbers[position]))}.zip"
        return PackedPath(shard, name, int(self.offsets[position]), int(self.sizes[position]))


def _joined(arrays: Iterable[NDArray[np.int64]]) -> NDArray[np.int64]:
    return np.concatenate([np.empty(0, np.int64), *arrays])


def write_index(path: Path, index: ShardIndex) -> None:
    """Writes the index as a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    shards = pa.DictionaryArray.from_arrays(index.shards.astype(np.int32), pa.array(index.names, pa.string()))
    columns = [index.numbers.astype(np.int32), shards, index.offsets, index.sizes.astype(np.int32)]
    pq.write_table(pa.table(columns, names=_COLUMNS), path, compression="zstd", write_page_checksum=True)


def read_index(root: Place) -> ShardIndex | None:
    """Returns the index of a dataset as stored, or `None` if it is missing or damaged."""
    path = root / SHARDS_FILE
    if isinstance(path, Path) and not path.exists():
        return None
    import pyarrow as pa  # imported here, because readers of a dataset without shards do not need it
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(table_of(path), columns=list(_COLUMNS), page_checksum_verification=True)
        numbers, shards, offsets, sizes = (table[name].combine_chunks() for name in _COLUMNS)
        shards = shards.dictionary_encode()
        columns = (numbers, shards.indices, offsets, sizes)
        names = tuple(shards.dictionary.to_pylist())
        index = ShardIndex(root / EPISODES, names, *(column.cast(pa.int64()).to_numpy() for column in columns))
        return index if _is_valid(index) else None
    except (pa.ArrowException, *PARSER_ERRORS):
        return None


def _is_valid(index: ShardIndex) -> bool:
    """Returns whether all values are possible, so a damaged index names no file outside of the folder."""
    is_ascending = bool((np.diff(index.numbers) >= 0).all() and (index.numbers > 0).all())
    fits = (index.offsets >= 0) & (index.sizes >= 0) & (index.sizes <= MAX_PACKED_BYTES)
    return is_ascending and bool(fits.all()) and all(map(is_shard, index.names))


def shard_places(root: Place) -> list[Place]:
    """Returns the paths of the shards of a dataset, by name."""
    folder = root / EPISODES
    # the names of shards sort after the names of episodes, so one request lists all shards
    places = folder.walk(after="shard") if isinstance(folder, ObjectPath) else children(folder)
    return sorted(place for place in places if is_shard(place.name) and place.parent == folder)


def open_shard(place: Place) -> tuple[ShardDirectory, str]:
    """Reads the directory of a shard, or finds the intact episodes of a damaged shard.

    Returns:
        The directory, and the description of the damage; empty for an intact shard.

    Raises:
        OSError: the file cannot be read.
        WorldError: the store does not answer.
    """
    with place.open("rb") as file:
        try:
            return read_shard(file, place.name), ""
        except InvalidBundle as error:
            return salvage_shard(file, place.name), "; ".join(error.findings)


def list_shards(root: Place) -> ShardIndex:
    """Returns the index of a dataset from the directories of its shards."""
    return ShardIndex.of(root / EPISODES, map(_directory, shard_places(root)))


@functools.lru_cache(maxsize=4096)
def _directory(place: Place) -> ShardDirectory:
    """Returns the directory of a shard; cached, because the name of a shard contains the digest of its content."""
    try:
        return open_shard(place)[0]
    except OSError:
        return empty_directory(place.name)


_known: dict[str, ShardIndex] = {}
"""Index of each dataset that this process has read from, by its absolute path or URL."""


def packed_place(root: Place, number: int) -> PackedPath | None:
    """Returns the path of a packed episode according to the index, or `None`; this process reads the index once.

    Does not check whether the episode is stored there. An outdated index may give a wrong path; `episode_place` checks
    the path.
    """
    key = _key(root)
    if key not in _known:
        _known[key] = read_index(root) or ShardIndex.of(root / EPISODES, ())
    return _known[key].find(number)


def episode_place(root: Place, number: int) -> FilePlace:
    """Returns the path of an episode: its file, or its place in a shard.

    For an episode that is not stored, this is the path that its file would have. Reads the header at the place that the
    index names. If it is not the header of the episode, the index is outdated, and the directories of the shards are
    read.

    Args:
        root: root of the dataset.
        number: number of the episode.
    """
    packed = packed_place(root, number)
    if packed is not None and packed.is_file():
        return packed
    single = root / EPISODES / f"{episode_id(number)}.zip"
    if single.is_file():
        return single
    _known[_key(root)] = index = list_shards(root)
    return index.find(number) or single


def _key(root: Place) -> str:
    return str(root.absolute() if isinstance(root, Path) else root)

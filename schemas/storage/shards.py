"""Shards: files that each contain up to 1,000 small episodes of one range of numbers (docs/dataset.md#shards).

Writes and reads the format on open binary files; the reader checks untrusted files. Opens no path, deletes nothing.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Iterator
from typing import BinaryIO, NamedTuple

import numpy as np
from isal.isal_zlib import crc32
from numpy.typing import NDArray

from schemas.encoding.container import (
    ContainerLimits,
    ContainerReader,
    ContainerWriter,
    local_header_bytes,
    read_local_header,
)
from schemas.errors import InvalidBundle
from schemas.job import episode_id, index_of_file

MAX_SHARD_EPISODES = 1000
MAX_PACKED_BYTES = 1 << 20
"""Largest size of an episode that is packed, bytes. A shard with 1,000 episodes of this size still needs no zip64
records."""
_LIMITS = ContainerLimits(MAX_SHARD_EPISODES, MAX_PACKED_BYTES)
_MAX_SHARD_BYTES = MAX_SHARD_EPISODES * (MAX_PACKED_BYTES + 256)
_NAME = re.compile(r"shard_(\d{6,7})-(\d{6,8})-[0-9a-f]{8}\.zip", re.ASCII)
_HEADER = b"PK\x03\x04"


class ShardDirectory(NamedTuple):
    """Directory of a shard, by ascending episode number."""

    name: str
    """File name."""
    numbers: NDArray[np.int64]
    """Episode numbers."""
    offsets: NDArray[np.int64]
    """Offset of the first byte of each episode file in the shard."""
    sizes: NDArray[np.int64]
    """Size of each episode file, bytes."""


def range_of(number: int, episodes: int = MAX_SHARD_EPISODES) -> tuple[int, int]:
    """Returns the first and last number of the range that contains an episode; a range has `episodes` numbers."""
    first = (number - 1) // episodes * episodes + 1
    return first, first + episodes - 1


def shard_name(first: int, last: int, sha256: str) -> str:
    """Returns the file name of a shard from its range of episode numbers and the SHA-256 of its content."""
    return f"shard_{first:06d}-{last:06d}-{sha256[:8]}.zip"


def is_shard(name: str) -> bool:
    return _NAME.fullmatch(name) is not None


def range_of_shard(name: str) -> tuple[int, int]:
    """Returns the first and the last episode number of the range of a shard.

    Raises:
        InvalidBundle: the file name is not that of a shard.
    """
    match = _NAME.fullmatch(name)
    if match is None:
        raise InvalidBundle("shard refused", [f"{name!r} is not the name of a shard"])
    return int(match[1]), int(match[2])


def write_shard(file: BinaryIO, episodes: Iterable[tuple[int, bytes]]) -> None:
    """Writes a shard; the bytes depend only on numbers and contents of the episodes.

    Args:
        file: seekable file, opened for writing.
        episodes: number and content of each episode file, by ascending number.
    """
    with ContainerWriter(file) as out:
        for number, data in episodes:
            out.add(f"{episode_id(number)}.zip", data)


def read_shard(file: BinaryIO, name: str) -> ShardDirectory:
    """Reads the directory of a shard; does not read its episodes.

    Args:
        file: seekable file, opened for reading.
        name: file name of the shard.

    Raises:
        InvalidBundle: the file is not a shard, is truncated, or exceeds a limit.
    """
    members = ContainerReader(file, _LIMITS)
    numbers = [index_of_file(member) or 0 for member in members.names]
    first, last = range_of_shard(name)
    if sorted(set(numbers)) != numbers or (numbers and not first <= numbers[0] <= numbers[-1] <= last):
        raise InvalidBundle("shard refused", ["its members are not episodes of its range in ascending order"])
    starts = (members.offset(member) + local_header_bytes(member) for member in members.names)
    return _shard(name, numbers, starts, map(members.size, members.names))


def salvage_shard(file: BinaryIO, name: str) -> ShardDirectory:
    """Returns the intact episodes of a damaged shard, found by their headers and checksums instead of its directory.

    Args:
        file: seekable file, opened for reading.
        name: file name of the shard.
    """
    size = file.seek(0, io.SEEK_END)
    file.seek(0)
    data = file.read(min(size, _MAX_SHARD_BYTES))
    first, last = range_of_shard(name)
    places = {number: place for number, *place in _scan(data) if first <= number <= last}
    numbers = sorted(places)[:MAX_SHARD_EPISODES]
    return _shard(name, numbers, (places[number][0] for number in numbers), (places[number][1] for number in numbers))


def empty_directory(name: str) -> ShardDirectory:
    return _shard(name, (), (), ())


def _scan(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yields number, offset and size of each intact episode; skips damaged parts."""
    at = data.find(_HEADER)
    while at >= 0:
        header = read_local_header(data, at)
        number = index_of_file(header.name) if header is not None else None
        after = at + 1
        if header is not None and number is not None:
            start = at + local_header_bytes(header.name)
            end = start + header.size
            if end <= len(data) and crc32(memoryview(data)[start:end]) == header.crc:
                yield number, start, header.size
                after = end
        at = data.find(_HEADER, after)


def _shard(name: str, numbers: Iterable[int], offsets: Iterable[int], sizes: Iterable[int]) -> ShardDirectory:
    return ShardDirectory(name, *(np.fromiter(values, np.int64) for values in (numbers, offsets, sizes)))

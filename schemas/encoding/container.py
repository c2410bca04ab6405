"""A deterministic, bounded container: a zip whose members are stored as they are, in order, without times.

Reads and writes open binary files; never deflates, never touches a path, and trusts no size that it has not checked.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from threading import Lock
from typing import BinaryIO, NamedTuple

from isal.isal_zlib import crc32

from schemas.errors import InvalidBundle
from schemas.support.closing import Closing

__all__ = ["ContainerLimits", "ContainerReader", "ContainerWriter"]

_LOCAL = struct.Struct("<I5H3I2H")
"""A member's own header: mark, version, flags, method, time, date, CRC, sizes twice, lengths of name and extra."""
_CENTRAL = struct.Struct("<I6H3I5H2I")
"""Its entry in the directory: the same with the maker's version, and comment, disk, attributes and offset behind."""
_ENTRY = struct.Struct("<I4xHH4xIIIHHH8xI")
"""What a reader wants of it: mark, flags, method, CRC, sizes twice, lengths of name, extra and comment, offset."""
_END = struct.Struct("<I4H2IH")
"""The end: mark, disks, entries on this disk and in all, size and offset of the directory, length of the comment."""
_LOCAL_MARK, _CENTRAL_MARK, _END_MARK = 0x04034B50, 0x02014B50, 0x06054B50
_LOCATOR_64, _LOCATOR_64_BYTES = b"PK\x06\x07", 20
"""What stands before the end where the 64-bit records of a zip are to be believed instead."""
_MOST_NAME_BYTES = 255
_VERSION, _MADE_BY_UNIX, _STORED, _UTF8 = 20, 3 << 8 | 20, 0, 0x800
_ENCRYPTED = 0x1
_EPOCH = (0, 1 << 5 | 1)
"""1980-01-01, 0:00, as DOS has it: the least that a zip can say."""
_REGULAR_FILE_0644 = 0o100644 << 16
_MOST_BYTES = (1 << 32) - (1 << 24)
"""What a zip can address without its 64-bit records, less room for the directory."""


class ContainerLimits(NamedTuple):
    """What a reader accepts before it allocates anything."""

    members: int
    """The most members."""
    member_bytes: int
    """The largest member, bytes."""


class ContainerWriter(Closing):
    """Appends members to a file opened for writing; the bytes depend only on names, data and order.

    Writes the records itself: `zipfile` takes longer over a frame than its depth image takes to compress.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._offset = 0
        self._directory: dict[str, bytes] = {}
        self._is_open = True

    def add(self, name: str, data: bytes) -> None:
        """Writes one member.

        Raises:
            ValueError: a member of that name is there already, or the container would pass 4 GiB.
        """
        if name in self._directory:
            raise ValueError(f"{name!r} is already in the container")
        spelt = name.encode()
        if self._offset + len(data) + len(spelt) + _LOCAL.size > _MOST_BYTES:
            raise ValueError(f"{name!r} of {len(data)} bytes does not fit: a container has at most {_MOST_BYTES} bytes")
        flags = 0 if name.isascii() else _UTF8
        facts = (_VERSION, flags, _STORED, *_EPOCH, crc32(data), len(data), len(data), len(spelt), 0)
        self._directory[name] = (
            _CENTRAL.pack(_CENTRAL_MARK, _MADE_BY_UNIX, *facts, 0, 0, 0, _REGULAR_FILE_0644, self._offset) + spelt
        )
        self._write(_LOCAL.pack(_LOCAL_MARK, *facts) + spelt)
        self._write(data)

    def close(self) -> None:
        """Writes the directory; the file itself stays open. Closing twice is harmless."""
        if self._is_open:
            self._is_open = False
            start, entries, count = self._offset, b"".join(self._directory.values()), len(self._directory)
            self._write(entries + _END.pack(_END_MARK, 0, 0, count, count, len(entries), start, 0))
            self._file.flush()

    def _write(self, data: bytes) -> None:
        self._file.write(data)
        self._offset += len(data)


class ContainerReader:
    """Random access to the members of a container held in a seekable binary file; threads may share it.

    Raises:
        InvalidBundle: the file is no such container or passes a limit; nothing has been allocated by then.
    """

    def __init__(self, file: BinaryIO, limits: ContainerLimits) -> None:
        self._file = file
        self._position = Lock()  # the file has one, whoever reads
        self._members = _read_directory(file, limits)
        self.names: tuple[str, ...] = tuple(self._members)
        """Member names in the order of the file."""

    def read(self, name: str) -> bytes:
        """Returns one member whole; its CRC has been checked.

        Raises:
            InvalidBundle: the member is missing or damaged.
        """
        member = self._members.get(name)
        if member is None:
            raise InvalidBundle("member missing", [f"{name} is not in the container"])
        try:
            with self._position:
                data = self._read_stored(member)
        except (ValueError, OSError, OverflowError) as error:
            raise InvalidBundle("member damaged", [f"{name}: {error}"]) from error
        _, size, crc, _ = member
        if data is None or len(data) != size:
            raise InvalidBundle("member damaged", [f"{name}: its header is wrong, or it ends too early"])
        if crc32(data) != crc:
            raise InvalidBundle("member damaged", [f"{name}: Bad CRC-32"])
        return data

    def _read_stored(self, member: _Member) -> bytes | None:
        """Returns the bytes behind a member's own header, or `None` where that header is not the member's."""
        offset, size, _, name = member
        self._file.seek(offset)
        header = self._file.read(_LOCAL.size)
        if len(header) < _LOCAL.size:
            return None
        mark, _, _, method, _, _, _, _, _, name_bytes, extra_bytes = _LOCAL.unpack(header)
        spelt = self._file.read(name_bytes + extra_bytes)[:name_bytes]
        if mark != _LOCAL_MARK or method != _STORED or spelt != name:
            return None
        return self._file.read(size)

    def size(self, name: str) -> int:
        """Returns the size of a member in bytes without reading it."""
        return self._members[name][1]


_Member = tuple[int, int, int, bytes]
"""Where the directory says a member lies: offset of its own header, size in bytes, CRC-32, its name as spelt there. A
plain tuple, for an episode has hundreds."""


def _read_directory(file: BinaryIO, limits: ContainerLimits) -> dict[str, _Member]:
    """Returns the members by name, in order; what they claim is within the limits and the file.

    Reads it itself: `zipfile` takes longer over the directory of an episode than a frame takes to decode.
    """
    size = file.seek(0, 2)
    count, start = _bound_directory(file, limits, size)
    file.seek(start)
    directory = file.read(size - _END.size - start)
    members: dict[str, _Member] = {}
    findings: list[str] = []
    at = total = 0
    for _ in range(count):
        if at + _ENTRY.size > len(directory):
            raise _unreadable(size, "its directory ends too early")
        mark, flags, method, crc, packed, length, name_bytes, extra_bytes, note_bytes, offset = _ENTRY.unpack_from(
            directory, at
        )
        end = at + _ENTRY.size + name_bytes
        spelt = directory[at + _ENTRY.size : end]
        if mark != _CENTRAL_MARK or len(spelt) != name_bytes:
            raise _unreadable(size, "its directory is damaged")
        name = spelt.decode() if spelt.isascii() else _decode_name(spelt, flags, size)
        if flags & _ENCRYPTED or method != _STORED or packed != length or length > limits.member_bytes:
            findings += _objections(name, flags, method, packed, length, limits)
        if name in members:
            findings.append(f"{name!r} stands twice")
        members[name] = offset, length, crc, spelt
        total += length
        at = end + extra_bytes + note_bytes
    if at != len(directory):
        raise _unreadable(size, "its directory is damaged")
    if total > size:
        findings.append(f"members claim {total} bytes in a file of {size}")
    if findings:
        raise InvalidBundle("container refused", findings)
    return members


def _bound_directory(file: BinaryIO, limits: ContainerLimits, size: int) -> tuple[int, int]:
    """Returns how many members the directory has and where it starts, once its size is known to be in bounds."""
    file.seek(max(0, size - _END.size - _LOCATOR_64_BYTES))
    tail = file.read()
    before, end = tail[: -_END.size], tail[-_END.size :]
    if len(end) < _END.size:
        raise _unreadable(size, "they are too few")
    mark, _, _, _, count, directory_bytes, start, comment_bytes = _END.unpack(end)
    if mark != _END_MARK or comment_bytes or start + directory_bytes + _END.size != size or before[:4] == _LOCATOR_64:
        raise _unreadable(size, "they do not end as one")
    if count > limits.members:
        raise InvalidBundle("container refused", [f"more than {limits.members} members"])
    if directory_bytes > count * (_CENTRAL.size + _MOST_NAME_BYTES):
        raise InvalidBundle("container refused", [f"a directory of {directory_bytes} bytes for {count} members"])
    return count, start


def _decode_name(spelt: bytes, flags: int, size: int) -> str:
    try:
        return spelt.decode("utf-8" if flags & _UTF8 else "cp437")
    except UnicodeDecodeError as error:
        raise _unreadable(size, "a member's name is not UTF-8") from error


def _objections(name: str, flags: int, method: int, packed: int, length: int, limits: ContainerLimits) -> Iterator[str]:
    if method != _STORED or packed != length:
        yield f"{name!r} is compressed by the zip; members must be stored"
    if flags & _ENCRYPTED:
        yield f"{name!r} is encrypted"
    if length > limits.member_bytes:
        yield f"{name!r} has {length} bytes, more than {limits.member_bytes}"


def _unreadable(size: int, why: str) -> InvalidBundle:
    return InvalidBundle("not a container", [f"{size} bytes that are no readable zip: {why}"])

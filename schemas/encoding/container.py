"""Deterministic container with size limits: a zip file with uncompressed members in a fixed order, without times.

Reads and writes open binary files, and checks every size before it allocates memory. Does not compress, opens no path.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from threading import Lock
from typing import BinaryIO, NamedTuple

from isal.isal_zlib import crc32

from schemas.errors import InvalidBundle
from schemas.support.closing import Closing

_LOCAL = struct.Struct("<I5H3I2H")
"""Local header of a member: signature, version, flags, method, time, date, CRC, sizes, lengths of name and extra."""
_CENTRAL = struct.Struct("<I6H3I5H2I")
"""Entry of a member in the directory: signature, the writer's version, the other fields of the local header, comment
length, disk, attributes and offset."""
_ENTRY = struct.Struct("<I4xHH4xIIIHHH8xI")
"""Fields of a directory entry (`_CENTRAL`) that the reader uses: signature, flags, method, CRC, both sizes, lengths of
name, extra and comment, offset."""
_END = struct.Struct("<I4H2IH")
"""End of the directory: signature, disks, entries on this disk and in total, size and offset of the directory, length
of the comment."""
_LOCAL_MARK, _CENTRAL_MARK, _END_MARK = 0x04034B50, 0x02014B50, 0x06054B50
_LOCATOR_64, _LOCATOR_64_BYTES = b"PK\x06\x07", 20
"""Signature and size of the zip64 locator. A file with this record before the end of its directory needs zip64 and is
rejected."""
_MOST_NAME_BYTES = 255
_VERSION, _MADE_BY_UNIX, _STORED, _UTF8 = 20, 3 << 8 | 20, 0, 0x800
_ENCRYPTED = 0x1
_EPOCH = (0, 1 << 5 | 1)
"""1980-01-01 0:00 as DOS time and date, the earliest time that a zip can store."""
_REGULAR_FILE_0644 = 0o100644 << 16
MAX_CONTAINER_BYTES = (1 << 32) - (1 << 24)
"""Largest size of all members with their headers, bytes: 4 GiB, the limit without zip64 records, less 16 MiB for the
directory."""


class ContainerLimits(NamedTuple):
    """Limits that a reader checks before it allocates memory."""

    members: int
    """Largest number of members."""
    member_bytes: int
    """Largest size of a member, bytes."""


class ContainerWriter(Closing):
    """Writer that appends members to an open file; the bytes depend only on names, data and order.

    Does not use `zipfile`, which takes longer to add a frame than the compression of its depth image takes.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._offset = 0
        self._directory: dict[str, bytes] = {}
        self._is_open = True

    def add(self, name: str, data: bytes) -> None:
        """Writes one member.

        Raises:
            ValueError: the container already has a member of that name, or would exceed 4 GiB.
        """
        if name in self._directory:
            raise ValueError(f"{name!r} is already in the container")
        encoded = name.encode()
        if self._offset + len(data) + len(encoded) + _LOCAL.size > MAX_CONTAINER_BYTES:
            raise ValueError(
                f"{name!r} of {len(data)} bytes does not fit: a container has at most {MAX_CONTAINER_BYTES} bytes"
            )
        flags = 0 if name.isascii() else _UTF8
        fields = (_VERSION, flags, _STORED, *_EPOCH, crc32(data), len(data), len(data), len(encoded), 0)
        self._directory[name] = (
            _CENTRAL.pack(_CENTRAL_MARK, _MADE_BY_UNIX, *fields, 0, 0, 0, _REGULAR_FILE_0644, self._offset) + encoded
        )
        self._write(_LOCAL.pack(_LOCAL_MARK, *fields) + encoded)
        self._write(data)

    def close(self) -> None:
        """Writes the directory and leaves the file open; further calls have no effect."""
        if self._is_open:
            self._is_open = False
            start, entries, count = self._offset, b"".join(self._directory.values()), len(self._directory)
            self._write(entries + _END.pack(_END_MARK, 0, 0, count, count, len(entries), start, 0))
            self._file.flush()

    def _write(self, data: bytes) -> None:
        self._file.write(data)
        self._offset += len(data)


class ContainerReader:
    """Random access to the members of a container in a seekable binary file; safe to use from several threads.

    Raises:
        InvalidBundle: the file is not a valid container or exceeds a limit; no memory was allocated for its members.
    """

    def __init__(self, file: BinaryIO, limits: ContainerLimits) -> None:
        self._file = file
        self._position = Lock()  # guards the position of the file, which all threads share
        self._members = _read_directory(file, limits)
        self.names: tuple[str, ...] = tuple(self._members)
        """Member names in the order of the file."""

    def read(self, name: str) -> bytes:
        """Returns the data of one member after a check of its CRC.

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
            raise InvalidBundle("member damaged", [f"{name}: its header is wrong, or its data is truncated"])
        if crc32(data) != crc:
            raise InvalidBundle("member damaged", [f"{name}: Bad CRC-32"])
        return data

    def _read_stored(self, member: _Member) -> bytes | None:
        """Returns the bytes that follow a member's local header, or `None` if the header is not that of the member."""
        offset, size, _, name = member
        self._file.seek(offset)
        header = self._file.read(_LOCAL.size)
        if len(header) < _LOCAL.size:
            return None
        mark, _, _, method, _, _, _, _, _, name_bytes, extra_bytes = _LOCAL.unpack(header)
        encoded = self._file.read(name_bytes + extra_bytes)[:name_bytes]
        if mark != _LOCAL_MARK or method != _STORED or encoded != name:
            return None
        return self._file.read(size)

    def size(self, name: str) -> int:
        """Returns the size of a member in bytes without reading it."""
        return self._members[name][1]

    def offset(self, name: str) -> int:
        """Returns the offset of a member's local header according to the directory."""
        return self._members[name][0]


class LocalHeader(NamedTuple):
    """Local header of a stored member."""

    name: str
    """Name of the member."""
    size: int
    """Size of the member, bytes."""
    crc: int
    """CRC-32 of the member."""


def local_header_bytes(name: str) -> int:
    """Returns the size of the local header that `ContainerWriter` writes before a member."""
    return _LOCAL.size + len(name.encode())


def read_local_header(data: bytes, at: int = 0) -> LocalHeader | None:
    """Returns the local header at an offset, or `None` if it is not one that `ContainerWriter` writes.

    The result is also `None` if the name is not ASCII.
    """
    if len(data) < at + _LOCAL.size:
        return None
    mark, version, flags, method, *time, crc, packed, size, name_bytes, extra_bytes = _LOCAL.unpack_from(data, at)
    encoded = data[at + _LOCAL.size : at + _LOCAL.size + name_bytes]
    fixed = (mark, version, flags, method, tuple(time), extra_bytes)
    if fixed != (_LOCAL_MARK, _VERSION, 0, _STORED, _EPOCH, 0) or packed != size:
        return None
    return LocalHeader(encoded.decode(), size, crc) if len(encoded) == name_bytes and encoded.isascii() else None


_Member = tuple[int, int, int, bytes]
"""Directory entry of a member: offset of its local header, size in bytes, CRC-32, encoded name. A plain tuple, because
an episode has hundreds of them."""


def _read_directory(file: BinaryIO, limits: ContainerLimits) -> dict[str, _Member]:
    """Returns the members by name, in the order of the file, after a check of their sizes.

    Does not use `zipfile`, which takes longer to read the directory of an episode than a frame takes to decode.
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
            raise _unreadable(size, "its directory is truncated")
        mark, flags, method, crc, packed, length, name_bytes, extra_bytes, note_bytes, offset = _ENTRY.unpack_from(
            directory, at
        )
        end = at + _ENTRY.size + name_bytes
        encoded = directory[at + _ENTRY.size : end]
        if mark != _CENTRAL_MARK or len(encoded) != name_bytes:
            raise _unreadable(size, "its directory is damaged")
        name = encoded.decode() if encoded.isascii() else _decode_name(encoded, flags, size)
        if flags & _ENCRYPTED or method != _STORED or packed != length or length > limits.member_bytes:
            findings += _member_violations(name, flags, method=method, packed=packed, length=length, limits=limits)
        if name in members:
            findings.append(f"{name!r} is listed twice")
        members[name] = offset, length, crc, encoded
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
    """Returns the number of members and the offset of the directory, after a check of this number and of the
    directory's size."""
    file.seek(max(0, size - _END.size - _LOCATOR_64_BYTES))
    tail = file.read()
    before, end = tail[: -_END.size], tail[-_END.size :]
    if len(end) < _END.size:
        raise _unreadable(size, "it is too short")
    mark, _, _, _, count, directory_bytes, start, comment_bytes = _END.unpack(end)
    if mark != _END_MARK or comment_bytes or start + directory_bytes + _END.size != size or before[:4] == _LOCATOR_64:
        raise _unreadable(size, "it has no valid end record")
    if count > limits.members:
        raise InvalidBundle("container refused", [f"more than {limits.members} members"])
    if directory_bytes > count * (_CENTRAL.size + _MOST_NAME_BYTES):
        raise InvalidBundle("container refused", [f"a directory of {directory_bytes} bytes for {count} members"])
    return count, start


def _decode_name(encoded: bytes, flags: int, size: int) -> str:
    try:
        return encoded.decode("utf-8" if flags & _UTF8 else "cp437")
    except UnicodeDecodeError as error:
        raise _unreadable(size, "a member's name is not UTF-8") from error


def _member_violations(
    name: str, flags: int, method: int, packed: int, length: int, limits: ContainerLimits
) -> Iterator[str]:
    if method != _STORED or packed != length:
        yield f"{name!r} is compressed by the zip; members must be stored"
    if flags & _ENCRYPTED:
        yield f"{name!r} is encrypted"
    if length > limits.member_bytes:
        yield f"{name!r} has {length} bytes, more than {limits.member_bytes}"


def _unreadable(size: int, why: str) -> InvalidBundle:
    return InvalidBundle("not a container", [f"{size} bytes that are not a readable zip: {why}"])

"""A deterministic, bounded container: a zip whose members are stored as they are, in order, without times.

Reads and writes open binary files; never deflates, never touches a path, and trusts no size that it has not checked.
"""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Iterable
from types import TracebackType
from typing import BinaryIO, NamedTuple, Self

from isal.isal_zlib import crc32

from schemas.errors import InvalidBundle

__all__ = ["ContainerReader", "ContainerWriter", "Limits"]

_LOCAL = struct.Struct("<I5H3I2H")
"""A member's own header: mark, version, flags, method, time, date, CRC, sizes twice, lengths of name and extra."""
_CENTRAL = struct.Struct("<I6H3I5H2I")
"""Its entry in the directory: the same with the maker's version, and comment, disk, attributes and offset behind."""
_END = struct.Struct("<I4H2IH")
"""The end: mark, disks, entries on this disk and in all, size and offset of the directory, length of the comment."""
_LOCAL_MARK, _CENTRAL_MARK, _END_MARK = 0x04034B50, 0x02014B50, 0x06054B50
_LOCATOR_64, _LOCATOR_64_BYTES = b"PK\x06\x07", 20
"""What stands before the end where the 64-bit records of a zip are to be believed instead."""
_MOST_NAME_BYTES = 255
_VERSION, _MADE_BY_UNIX, _STORED, _UTF8 = 20, 3 << 8 | 20, 0, 0x800
_EPOCH = (0, 1 << 5 | 1)
"""1980-01-01, 0:00, as DOS has it: the least that a zip can say."""
_REGULAR_FILE_0644 = 0o100644 << 16
_MOST_BYTES = (1 << 32) - (1 << 24)
"""What a zip can address without its 64-bit records, less room for the directory."""


class Limits(NamedTuple):
    """What a reader accepts before it allocates anything."""

    members: int
    """The most members."""
    member_bytes: int
    """The largest member, bytes."""


class ContainerWriter:
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
            raise ValueError(f"{name!r} stands in the container already")
        spelt = name.encode()
        if self._offset + len(data) + len(spelt) + _LOCAL.size > _MOST_BYTES:
            raise ValueError(f"{name!r} of {len(data)} bytes does not fit: a container holds {_MOST_BYTES} bytes")
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

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class ContainerReader:
    """Random access to the members of a container held in a seekable binary file.

    Raises:
        InvalidBundle: the file is no such container or passes a limit; nothing has been allocated by then.
    """

    def __init__(self, file: BinaryIO, limits: Limits) -> None:
        self._limits = limits
        self._file = file
        size = file.seek(0, 2)
        _bound_directory(file, limits, size)
        try:
            members = zipfile.ZipFile(file).infolist()
        except (zipfile.BadZipFile, ValueError, NotImplementedError, OverflowError, EOFError) as error:
            raise InvalidBundle("not a container", [f"{size} bytes that are no readable zip ({error})"]) from error
        findings = list(_findings(members, limits, size))
        if findings:
            raise InvalidBundle("container refused", findings)
        self._info = {info.filename: info for info in members}
        self.names: tuple[str, ...] = tuple(self._info)
        """Member names in the order of the file."""

    def read(self, name: str) -> bytes:
        """Returns one member whole; its CRC has been checked.

        Raises:
            InvalidBundle: the member is missing or damaged.
        """
        info = self._info.get(name)
        if info is None:
            raise InvalidBundle("member missing", [f"{name} is not in the container"])
        try:
            data = self._read_stored(info)
        except (ValueError, OSError, OverflowError) as error:
            raise InvalidBundle("member damaged", [f"{name}: {error}"]) from error
        if data is None or len(data) != info.file_size:
            raise InvalidBundle("member damaged", [f"{name}: its header is wrong, or it ends too early"])
        if crc32(data) != info.CRC:
            raise InvalidBundle("member damaged", [f"{name}: Bad CRC-32"])
        return data

    def _read_stored(self, info: zipfile.ZipInfo) -> bytes | None:
        """Returns the bytes behind a member's own header, or `None` where that header is not the member's."""
        self._file.seek(info.header_offset)
        header = self._file.read(_LOCAL.size)
        if len(header) < _LOCAL.size:
            return None
        mark, _, flags, method, _, _, _, _, _, name_bytes, extra_bytes = _LOCAL.unpack(header)
        name = self._file.read(name_bytes + extra_bytes)[:name_bytes]
        spelt = info.orig_filename.encode("utf-8" if flags & _UTF8 else "cp437")
        if mark != _LOCAL_MARK or method != _STORED or name != spelt:
            return None
        return self._file.read(info.file_size)

    def size(self, name: str) -> int:
        """Returns the size of a member in bytes without reading it."""
        return self._info[name].file_size


def _bound_directory(file: BinaryIO, limits: Limits, size: int) -> None:
    """Refuses what `zipfile`, which reads the whole directory at once, could take much memory for."""
    file.seek(max(0, size - _END.size - _LOCATOR_64_BYTES))
    tail = file.read()
    before, end = tail[: -_END.size], tail[-_END.size :]
    if len(end) < _END.size:
        raise InvalidBundle("not a container", [f"{size} bytes that are no readable zip"])
    mark, _, _, _, count, directory_bytes, start, comment_bytes = _END.unpack(end)
    if mark != _END_MARK or comment_bytes or start + directory_bytes + _END.size != size or before[:4] == _LOCATOR_64:
        raise InvalidBundle("not a container", [f"{size} bytes that are no readable zip: they do not end as one"])
    if count > limits.members:
        raise InvalidBundle("container refused", [f"more than {limits.members} members"])
    if directory_bytes > count * (_CENTRAL.size + _MOST_NAME_BYTES):
        raise InvalidBundle("container refused", [f"a directory of {directory_bytes} bytes for {count} members"])


def _findings(members: Iterable[zipfile.ZipInfo], limits: Limits, file_bytes: int) -> Iterable[str]:
    seen: set[str] = set()
    total = 0
    for count, info in enumerate(members, 1):
        if count > limits.members:
            yield f"more than {limits.members} members"
            return
        total += info.file_size
        if info.compress_type != zipfile.ZIP_STORED or info.compress_size != info.file_size:
            yield f"{info.filename!r} is compressed by the zip; members must be stored"
        if info.flag_bits & 0x1:
            yield f"{info.filename!r} is encrypted"
        if info.file_size > limits.member_bytes:
            yield f"{info.filename!r} has {info.file_size} bytes, more than {limits.member_bytes}"
        if info.filename in seen:
            yield f"{info.filename!r} stands twice"
        seen.add(info.filename)
    if total > file_bytes:
        yield f"members claim {total} bytes in a file of {file_bytes}"

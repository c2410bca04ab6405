"""A deterministic, bounded container: a zip whose members are stored as they are, in order, without times.

Reads and writes open binary files; never deflates, never touches a path, and trusts no size that it has not checked.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterable
from types import TracebackType
from typing import BinaryIO, NamedTuple, Self

from schemas.errors import InvalidBundle

__all__ = ["ContainerReader", "ContainerWriter", "Limits"]

_EPOCH = (1980, 1, 1, 0, 0, 0)
_REGULAR_FILE_0644 = 0o100644 << 16


class Limits(NamedTuple):
    """What a reader accepts before it allocates anything."""

    members: int
    """The most members."""
    member_bytes: int
    """The largest member, bytes."""


class ContainerWriter:
    """Appends members to a file opened for writing; the bytes depend only on names, data and order."""

    def __init__(self, file: BinaryIO) -> None:
        self._zip = zipfile.ZipFile(file, "w", zipfile.ZIP_STORED, allowZip64=True)

    def add(self, name: str, data: bytes) -> None:
        """Writes one member."""
        info = zipfile.ZipInfo(name, _EPOCH)
        info.create_system = 3
        info.external_attr = _REGULAR_FILE_0644
        self._zip.writestr(info, data)

    def close(self) -> None:
        """Writes the directory; the file itself stays open."""
        self._zip.close()

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
        size = file.seek(0, 2)
        try:
            self._zip = zipfile.ZipFile(file)
        except (zipfile.BadZipFile, ValueError, NotImplementedError, OverflowError, EOFError) as error:
            raise InvalidBundle("not a container", [f"{size} bytes that are no readable zip ({error})"]) from error
        members = self._zip.infolist()
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
            with self._zip.open(info) as member:
                return member.read()
        except (zipfile.BadZipFile, ValueError, NotImplementedError, EOFError, OSError) as error:
            raise InvalidBundle("member damaged", [f"{name}: {error}"]) from error

    def size(self, name: str) -> int:
        """Returns the size of a member in bytes without reading it."""
        return self._info[name].file_size


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

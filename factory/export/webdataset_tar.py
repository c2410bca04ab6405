"""Tar shards that depend on nothing but names and data: USTAR members, and members joined to an archive. Reads none."""

from __future__ import annotations

import os
import shutil
import tarfile
from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO

__all__ = ["join_members", "member_bytes", "write_member"]

_MODE = 0o644


def write_member(file: BinaryIO, name: str, data: bytes) -> None:
    """Appends one member, without owner and time; the end of the archive is left to `join_members`."""
    info = tarfile.TarInfo(name)
    info.size, info.mode = len(data), _MODE
    file.write(info.tobuf(tarfile.USTAR_FORMAT))
    file.write(data)
    file.write(b"\0" * (-len(data) % tarfile.BLOCKSIZE))


def member_bytes(size: int) -> int:
    """Returns what a member of that size takes in an archive."""
    return tarfile.BLOCKSIZE + size + -size % tarfile.BLOCKSIZE


def join_members(pieces: Iterable[Path], shard: Path) -> None:
    """Writes an archive from files of members, one after the other, in bounded memory."""
    with shard.open("wb") as out:
        for piece in pieces:
            with piece.open("rb") as members:
                shutil.copyfileobj(members, out, 1 << 20)
        out.write(b"\0" * (2 * tarfile.BLOCKSIZE))
        out.write(b"\0" * (-out.tell() % tarfile.RECORDSIZE))
        out.flush()
        os.fsync(out.fileno())

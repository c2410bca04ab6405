"""Digest of a closed ledger (`ledger.digest`), so the next start need not audit an unchanged file.

Does not open the ledger. A ledger on a database server has no digest.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import xxhash

from coordinator.ledger.database.engine import sqlite_files

_SUFFIX = ".digest"
_PIECE_BYTES = 1 << 20


def write_closed_digest(url: str) -> None:
    """Records the digest of a closed ledger, unless it has a write-ahead log, which the digest does not cover."""
    with contextlib.suppress(OSError):  # without the digest, the next start audits the ledger
        for file in _whole_file(url):
            file.with_suffix(_SUFFIX).write_text(_digest(file))


def is_unchanged(url: str) -> bool:
    """Returns whether a ledger is unchanged since this version of the software closed it."""
    try:
        return any(file.with_suffix(_SUFFIX).read_text() == _digest(file) for file in _whole_file(url))
    except (OSError, UnicodeDecodeError):
        return False


def _whole_file(url: str) -> Iterator[Path]:
    """Yields the database file, if it exists and its write-ahead log is missing or empty."""
    files = sqlite_files(url)
    if files and not any(path.name.endswith("-wal") and path.stat().st_size for path in files):
        yield files[-1]


def _digest(file: Path) -> str:
    digest = xxhash.xxh3_128(version("minivla-factory").encode())
    with file.open("rb") as stream:
        while piece := stream.read(_PIECE_BYTES):
            digest.update(piece)
    return digest.hexdigest()

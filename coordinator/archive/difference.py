"""Compares the episodes that a directory holds with those that the ledger records. Reads no file and no ledger."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

GONE = "its file is missing"
"""Reason that is recorded when an episode is generated again because its file is missing."""


class ListedFile(NamedTuple):
    """One episode file as found."""

    size: int
    """Size of the file, bytes."""
    sha256: str | None = None
    """Digest of the file; `None` if it was not computed. The digest is then not compared."""
    fault: str = ""
    """Reason why the file cannot be read; empty if it can be read."""


class RecordedFile(NamedTuple):
    """One episode file as the ledger records it."""

    size: int
    """Size of the file, bytes."""
    sha256: str | None = None
    """Digest."""
    gateway: str | None = None
    """Gateway that keeps the file; `None` when it is kept in the directory that is compared."""


@dataclass(frozen=True)
class ArchiveDifference:
    """Episode numbers by finding, each in ascending order."""

    same: tuple[int, ...]
    """Episodes that are recorded in this directory and whose file equals the record."""
    missing: tuple[int, ...]
    """Episodes that are recorded in this directory and have no file."""
    unknown: tuple[int, ...]
    """Episodes that have a file and no record."""
    changed: Mapping[int, str]
    """Episodes whose file differs from its record, with a description of the difference."""
    elsewhere: tuple[int, ...]
    """Episodes that are recorded at a gateway and whose file equals the record; they are not in `same`."""

    @property
    def strays(self) -> tuple[int, ...]:
        """Numbers of the unknown and the changed episodes, ascending."""
        return tuple(sorted((*self.unknown, *self.changed)))


def diff_archive(listed: Mapping[int, ListedFile], recorded: Mapping[int, RecordedFile]) -> ArchiveDifference:
    """Compares files with records.

    Args:
        listed: the files of one directory, by episode number.
        recorded: the ledger's records, by episode number.
    """
    both = sorted(listed.keys() & recorded.keys())
    changed = {index: words for index in both if (words := describe_difference(listed[index], recorded[index]))}
    whole = [index for index in both if index not in changed]
    gone = sorted(recorded.keys() - listed.keys())
    return ArchiveDifference(
        same=tuple(index for index in whole if recorded[index].gateway is None),
        missing=tuple(index for index in gone if recorded[index].gateway is None),
        unknown=tuple(sorted(listed.keys() - recorded.keys())),
        changed=changed,
        elsewhere=tuple(index for index in whole if recorded[index].gateway is not None),
    )


def describe_difference(listed: ListedFile | None, record: RecordedFile) -> str:
    """Returns the difference between a file (`None`: missing) and its record as text; empty if there is none."""
    if listed is None:
        return GONE
    if listed.size != record.size:
        return f"{listed.size} bytes; in the ledger {record.size}"
    if listed.fault or listed.sha256 in (None, record.sha256):
        return listed.fault
    return f"SHA-256 {listed.sha256}; in the ledger {record.sha256}"

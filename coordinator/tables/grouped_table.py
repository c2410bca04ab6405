"""Writes a table of a dataset in row groups by episode number, and copies the row groups that have not changed.

A copied group has the same bytes as a newly written group, so the same ledger results in the same file. Bytes
that this process has not written are not copied, because other processes can change the file.
"""

from __future__ import annotations

import enum
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, BinaryIO, Protocol

import pyarrow as pa

from coordinator.archive.contract import Archive
from coordinator.tables.aggregates import TableAggregates
from coordinator.tables.row_groups import RowGroup, RowGroupWriter
from schemas.base import Model
from schemas.dataset.rows import EpisodeSummary, FailedAttempt
from schemas.storage.place import Place

Read = Callable[[int, int], Iterable[dict[str, Any]]]
"""Function that returns the rows of the episodes between two numbers, both included, ascending."""

GROUP_ROWS = 2000
"""Size of the range of episode numbers of a row group."""


class RowSource(Protocol):
    """Rows of a table, ordered by episode number."""

    def rows(self, first: int, last: int) -> Iterable[Model]:
        """Returns the rows of the episodes from `first` to `last`, ascending."""


class ListedRows:
    """Rows in memory.

    Args:
        rows: rows in ascending order of their episode numbers.
    """

    def __init__(self, rows: Iterable[EpisodeSummary | FailedAttempt]) -> None:
        self._groups: defaultdict[int, list[Model]] = defaultdict(list)
        for row in rows:
            self._groups[group_of(int(row.episode_id.removeprefix("ep_")))].append(row)

    def rows(self, first: int, last: int) -> Iterable[Model]:
        """See `RowSource`; `first` and `last` must be the limits of one row group."""
        assert last == first + GROUP_ROWS - 1
        return self._groups.get(group_of(first), ())


@dataclass(frozen=True)
class _Written:
    """Row group of the table, and what its rows add to the aggregates."""

    group: RowGroup
    aggregates: TableAggregates


class GroupedTable:
    """Table of one dataset. Remembers the row groups of its last write, to copy those that have not changed.

    Args:
        name: file name.
        schema: columns.
        aggregate: function that returns the aggregates of some rows.
    """

    def __init__(self, name: str, schema: pa.Schema, aggregate: Callable[[pa.Table], TableAggregates]) -> None:
        self._name, self._schema, self._aggregate = name, schema, aggregate
        self._written: dict[int, _Written] | None = None

    def write(
        self, archive: Archive, episodes: int, read: Read, changed: Collection[int] | None = None
    ) -> TableAggregates:
        """Writes the table and returns the aggregates of its rows.

        Args:
            archive: archive of the dataset, held exclusively.
            episodes: number of planned episodes.
            read: function that returns rows.
            changed: numbers of the episodes whose rows have changed since the last write; `None` reads all rows, as
                the first write does.

        Raises:
            WorldError: the disk is full or unavailable; the previous table is unchanged.
        """
        kept: dict[int, _Written | None] = dict.fromkeys(range(group_of(episodes) + 1))
        if changed is not None and self._written is not None:
            kept = {**self._written, **dict.fromkeys(map(group_of, changed))}
        written: dict[int, _Written] = {}
        with (
            _opened(archive.root / self._name) as former,
            archive.replacing(self._name) as part,
            part.open("wb") as file,
            RowGroupWriter(file, self._schema) as writer,
        ):
            for number, group in sorted(kept.items()):
                found = _copied(writer, former, group) or self._added(writer, number, read)
                if found is not None:
                    written[number] = found
        self._written = written
        return TableAggregates.total(found.aggregates for found in written.values())

    def _added(self, writer: RowGroupWriter, number: int, read: Read) -> _Written | None:
        rows = list(read(number * GROUP_ROWS + 1, (number + 1) * GROUP_ROWS))
        if not rows:
            return None
        table = pa.Table.from_pylist(rows, schema=self._schema)
        return _Written(writer.add(table), self._aggregate(table))


def _opened(place: Place) -> AbstractContextManager[BinaryIO | None]:
    try:
        return place.open("rb")
    except FileNotFoundError:
        return nullcontext()


def _copied(writer: RowGroupWriter, former: BinaryIO | None, kept: _Written | None) -> _Written | None:
    """Copies an unchanged row group from the previous file. Returns `None` if the group must be written from rows."""
    group = writer.copy(former, kept.group) if former is not None and kept is not None else None
    return None if group is None or kept is None else _Written(group, kept.aggregates)


def group_of(index: int) -> int:
    """Returns the number of the row group of an episode, from 0."""
    return (index - 1) // GROUP_ROWS


def plain_row(row: Model) -> dict[str, Any]:
    """Returns a model without nested models as a row of a table."""
    values = {name: getattr(row, name) for name in type(row).model_fields}
    return {name: str(value) if isinstance(value, enum.StrEnum) else value for name, value in values.items()}

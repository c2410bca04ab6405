"""Writes tables in row groups by episode number, and copies unchanged groups of the previous version undecoded.

pyarrow encodes each row group as a separate file; its bytes are moved into the table and the offsets in its description
adjusted, so the file equals that of a single `pyarrow.parquet.ParquetWriter`. Bytes that this process has not written
are not copied, because other processes can change the file.

Design: docs/design/data.md#unchanged-row-groups-are-copied.
"""

from __future__ import annotations

import enum
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, BinaryIO, Protocol

import pyarrow as pa
import pyarrow.parquet as pq
import xxhash

from coordinator.archive.contract import Archive
from coordinator.tables.aggregates import TableAggregates
from coordinator.tables.thrift import STRUCT, Field, Items, decode, encode
from schemas.base import Model
from schemas.dataset.rows import EpisodeSummary, FailedAttempt
from schemas.storage.place import Place
from schemas.support.closing import Closing

_MARK = b"PAR1"
_LENGTH_BYTES = 4
_ROWS, _GROUPS = 3, 4
"""Field numbers in `FileMetaData`: the number of rows, and the list of row groups."""
_COLUMNS, _GROUP_OFFSETS = 1, (5,)
"""Field numbers in `RowGroup`: the list of column chunks, and the offset of the first page."""
_COLUMN, _CHUNK_OFFSETS = 3, (2, 4, 6)
"""Field numbers in `ColumnChunk`: the description of the column, and the offsets of the chunk and of its indexes."""
_COLUMN_OFFSETS = (9, 10, 11, 14)
"""Field numbers in `ColumnMetaData`: offsets of the first data, index and dictionary page, and of the Bloom filter."""


@dataclass(frozen=True)
class RowGroup:
    """Row group of a written file."""

    start: int
    """Offset in the file, bytes."""
    size: int
    """Size, bytes."""
    digest: int
    """XXH3-64 of the bytes."""
    rows: int
    """Number of rows."""
    description: bytes
    """Thrift structure `RowGroup` in the footer of the file, encoded."""


class RowGroupWriter(Closing):
    """Writer of one file; closing it writes the footer and leaves the file open.

    Args:
        file: empty file, opened for writing.
        schema: schema of the table.
    """

    def __init__(self, file: BinaryIO, schema: pa.Schema) -> None:
        self._file, self._schema = file, schema
        self._groups: list[RowGroup] = []
        self._end = file.write(_MARK)

    def add(self, table: pa.Table) -> RowGroup:
        """Appends rows as one row group.

        Args:
            table: at least one row.
        """
        data, footer = _encode_alone(table)
        (group,) = _value(footer, _GROUPS).values
        return self._append(data, len(table), encode(_moved(group, self._end - len(_MARK))))

    def copy(self, former: BinaryIO, group: RowGroup) -> RowGroup | None:
        """Appends a row group of another file with the same schema.

        Returns `None` if the bytes of the group have changed or cannot be read.

        Args:
            former: file that contains the group.
            group: the group in that file.
        """
        try:
            former.seek(group.start)
            data = former.read(group.size)
        except OSError:
            return None
        if xxhash.xxh3_64_intdigest(data) != group.digest:
            return None
        by = self._end - group.start
        return self._append(
            data, group.rows, encode(_moved(decode(group.description), by)) if by else group.description
        )

    def _append(self, data: bytes, rows: int, description: bytes) -> RowGroup:
        group = RowGroup(
            self._end, len(data), digest=xxhash.xxh3_64_intdigest(data), rows=rows, description=description
        )
        self._end += self._file.write(data)
        self._groups.append(group)
        return group

    def close(self) -> None:
        """Writes the footer."""
        _, footer = _encode_alone(self._schema.empty_table())
        ours = {
            _ROWS: sum(group.rows for group in self._groups),
            _GROUPS: Items(STRUCT, [group.description for group in self._groups]),
        }
        data = encode([field._replace(value=ours.get(field.id, field.value)) for field in footer])
        self._file.write(data + len(data).to_bytes(_LENGTH_BYTES, "little") + _MARK)


def _encode_alone(table: pa.Table) -> tuple[bytes, list[Field]]:
    """Encodes rows as a separate file; returns the bytes of its row group and its decoded footer."""
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    data = sink.getvalue().to_pybytes()
    end = len(data) - _LENGTH_BYTES - len(_MARK)
    start = end - int.from_bytes(data[end : end + _LENGTH_BYTES], "little")
    return data[len(_MARK) : start], decode(data[start:end])


def _moved(group: list[Field], by: int) -> list[Field]:
    """Returns the description of a row group whose offset in the file has changed by `by` bytes."""
    chunks: Items = _value(group, _COLUMNS)
    moved = Items(chunks.kind, [_moved_chunk(chunk, by) for chunk in chunks.values])
    return [
        field._replace(value=moved) if field.id == _COLUMNS else field for field in _shifted(group, _GROUP_OFFSETS, by)
    ]


def _moved_chunk(chunk: list[Field], by: int) -> list[Field]:
    return [
        field._replace(value=_shifted(field.value, _COLUMN_OFFSETS, by)) if field.id == _COLUMN else field
        for field in _shifted(chunk, _CHUNK_OFFSETS, by)
    ]


def _shifted(fields: list[Field], numbers: Collection[int], by: int) -> list[Field]:
    """Returns the fields with `by` added to the offsets with the given field numbers; an offset of 0 means "none"."""
    return [
        field._replace(value=field.value + by) if field.id in numbers and field.value else field for field in fields
    ]


def _value(fields: list[Field], number: int):  # type: ignore[no-untyped-def]
    return next(field.value for field in fields if field.id == number)


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
                group_rows = _copied(writer, former, group) or self._added(writer, number, read)
                if group_rows is not None:
                    written[number] = group_rows
        self._written = written
        return TableAggregates.total(group_rows.aggregates for group_rows in written.values())

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

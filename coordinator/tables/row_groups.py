"""Writes a Parquet file by row groups, and copies row groups of its previous version without decoding them.

pyarrow encodes each row group as a separate file. This module moves the bytes of the group into the table and adjusts
the offsets in its description. The bytes of the file equal those of a single `pyarrow.parquet.ParquetWriter`.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import BinaryIO

import pyarrow as pa
import pyarrow.parquet as pq
import xxhash

from coordinator.tables.thrift import STRUCT, Field, Items, decode, encode
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
        group = RowGroup(self._end, len(data), xxhash.xxh3_64_intdigest(data), rows, description)
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

"""Columns of `metadata.parquet`, read at the first access and kept in a compact form. Interprets no row.

A million rows take 0.3 GB: repeated text is stored once, and integers have the smallest type that fits. All columns
come from one version of the file, even if a coordinator replaces it meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from schemas.dataset.rows import EpisodeSummary
from schemas.errors import ArchiveCorrupt
from schemas.storage.dataset_files import METADATA_FILE
from schemas.storage.place import Place, table_of
from schemas.support.foreign import PARSER_ERRORS

_EARLIEST, _LATEST = datetime(1, 1, 2, tzinfo=UTC), datetime(9999, 12, 30, tzinfo=UTC)
"""Range of timestamps that `datetime` represents in any time zone."""
_TICKS_PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
_MIN, _MAX = -(2**63), 2**63 - 1


def read_table(path: Place, columns: Sequence[str]) -> pa.Table:
    """Returns the named columns of a table; other columns, which a later version added, are ignored.

    Timestamps that `datetime` cannot represent become null, so the row can be read and its check reports it.

    Raises:
        FileNotFoundError: The file does not exist.
        Exception: The file is damaged: `pyarrow.ArrowException` or one of `PARSER_ERRORS`.
    """
    table = pq.read_table(table_of(path))
    table.validate(full=True)  # otherwise invalid UTF-8 raises an error only when the value is used
    table = table.select(list(columns))
    for position, field in enumerate(table.schema):
        if pa.types.is_timestamp(field.type):
            table = table.set_column(position, field, representable(table[position]))
    return table


def representable(times: pa.ChunkedArray) -> pa.ChunkedArray:
    """Returns timestamps with null for those that `datetime` cannot represent."""
    ticks, per_second = times.cast(pa.int64()), _TICKS_PER_SECOND[times.type.unit]
    first, last = (int(bound.timestamp()) * per_second for bound in (_EARLIEST, _LATEST))
    is_valid = pc.and_(pc.greater_equal(ticks, max(first, _MIN)), pc.less_equal(ticks, min(last, _MAX)))
    return pc.if_else(is_valid, times, pa.scalar(None, times.type))


NAMES = tuple(EpisodeSummary.model_fields)
"""Names of the columns."""
_UNIQUE = frozenset({"episode_id", "content_digest", "file_sha256", "file_name"})
"""Text columns whose values do not repeat."""
_LATER = pa.schema(
    [("spawn_surface_m", pa.float64()), ("final_surface_m", pa.float64()), ("target_in_view", pa.bool_())]
)
"""Columns that later versions of this software added; null in tables that lack them."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_ROWS_PER_SINGLE = 3000
"""Reading one row from its row group takes about as long as reading all columns of this number of rows."""
_SMALL_INTEGERS = (pa.int8(), pa.int16(), pa.int32())


Found = TypeVar("Found")


class Columns:
    """Columns of the table of a dataset; safe to use from several threads, and in forked processes.

    Args:
        root: Location of the dataset.

    Raises:
        ArchiveCorrupt: The table is missing or damaged. A damaged column raises it at the first access.
    """

    def __init__(self, root: Place) -> None:
        self._path = root / METADATA_FILE
        self._loaded: dict[str, pa.Array] = {}
        self._readers: dict[str, Callable[[int], Any]] = {}
        self._single = 0
        self._loading = Lock()
        self._file: pq.ParquetFile | None = self._translated(self._open)
        self.rows: int = self._file.metadata.num_rows
        """Number of rows."""

    def __getitem__(self, name: str) -> pa.Array:
        """Returns a column. Repeated text is stored as a dictionary array, and integers in the smallest type that fits.

        Raises:
            ArchiveCorrupt: The column is damaged.
        """
        with self._loading:
            if name not in self._loaded:
                self._loaded[name] = self._translated(lambda: self._read(name))
            return self._loaded[name]

    def row(self, position: int) -> dict[str, Any]:
        """Returns the values of one row, not validated.

        At first, each requested row of a large table is read from its row group. As soon as this has taken as long as
        reading all columns would, all columns are read.
        """
        if not self._readers and self._single < self.rows // _ROWS_PER_SINGLE:
            self._single += 1
            with self._loading:
                return self._translated(lambda: self._read_single(position))
        self._readers = self._readers or {name: _reader(self[name]) for name in NAMES}
        return {name: read(position) for name, read in self._readers.items()}

    def _open(self) -> pq.ParquetFile:
        table = table_of(self._path)
        source = pa.OSFile(str(table)) if isinstance(table, Path) else table  # stays readable if it is replaced
        footer = pq.read_metadata(source)
        names = footer.schema.to_arrow_schema().names
        missing = [name for name in NAMES if name not in {*names, *_LATER.names}]
        if missing:
            raise ValueError(f"it has no column {missing[0]}")
        repeating = [name for name in NAMES if name in names and name not in _UNIQUE]
        return pq.ParquetFile(source, metadata=footer, read_dictionary=repeating)

    def _read(self, name: str) -> pa.Array:
        assert self._file is not None
        if name not in self._file.schema_arrow.names:
            return pa.nulls(self.rows, _LATER.field(name).type)
        (column,) = self._file.read([name], use_threads=False).columns
        column.validate(full=True)  # otherwise invalid UTF-8 raises an error only when the value is used
        compact = _compact(representable(column) if pa.types.is_timestamp(column.type) else column)
        pa.default_memory_pool().release_unused()
        return compact

    def _read_single(self, position: int) -> dict[str, Any]:
        assert self._file is not None
        footer = self._file.metadata
        ends = np.cumsum([footer.row_group(number).num_rows for number in range(footer.num_row_groups)])
        number = int(np.searchsorted(ends, position, side="right"))
        group = self._file.read_row_group(number, use_threads=False)
        row = group.slice(position - int(ends[number]) + group.num_rows, 1)
        row.validate(full=True)
        return {name: _single_value(row[name]) if name in row.column_names else None for name in NAMES}

    def _translated(self, read: Callable[[], Found]) -> Found:
        try:
            return read()
        except FileNotFoundError as error:
            raise ArchiveCorrupt(f"{self._path} is missing: resume the run to rewrite it") from error
        except (pa.ArrowException, *PARSER_ERRORS) as error:
            raise ArchiveCorrupt(f"{self._path} is damaged ({error}): resume the run to rewrite it") from error

    def __getstate__(self) -> dict[str, Any]:
        """Reads and returns all columns, because the file may be replaced before another process opens it."""
        return {
            "_path": self._path,
            "_loaded": {name: self[name] for name in NAMES},
            "_readers": {},
            "_single": 0,
            "rows": self.rows,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__ |= state | {"_loading": Lock(), "_file": None}


def _single_value(column: pa.ChunkedArray) -> Any:
    return (
        _reader(representable(column).combine_chunks())(0) if pa.types.is_timestamp(column.type) else column[0].as_py()
    )


def _compact(column: pa.ChunkedArray) -> pa.Array | pa.ChunkedArray:
    if pa.types.is_string(column.type):
        return column  # combining the chunks would briefly take twice the memory
    whole = column.unify_dictionaries().combine_chunks()
    if pa.types.is_dictionary(whole.type):
        return pa.DictionaryArray.from_arrays(_narrowed(whole.indices), whole.dictionary)
    return _narrowed(whole) if pa.types.is_integer(whole.type) else whole


def _narrowed(integers: pa.Array) -> pa.Array:
    """Returns integers in the smallest type that fits all of them."""
    for kind in _SMALL_INTEGERS:
        try:
            return integers.cast(kind)
        except pa.ArrowInvalid:
            continue
    return integers


def _reader(column: pa.Array) -> Callable[[int], Any]:
    """Returns a function that reads single values of a column, where possible faster than pyarrow's scalars."""
    if pa.types.is_dictionary(column.type) and not column.null_count:
        values, indices = column.dictionary.to_pylist(), column.indices.to_numpy()
        return lambda position: values[indices[position]]
    if column.null_count == len(column):
        return lambda _: None
    if pa.types.is_timestamp(column.type) and column.type.unit == "us" and not column.null_count:
        ticks = column.cast(pa.int64()).to_numpy()
        return lambda position: _EPOCH + timedelta(microseconds=ticks.item(position))
    is_simple = (
        pa.types.is_integer(column.type) or pa.types.is_floating(column.type) or pa.types.is_boolean(column.type)
    )
    if is_simple and not column.null_count:
        values = column.to_numpy(zero_copy_only=False)
        return lambda position: values.item(position)
    return lambda position: column[position].as_py()

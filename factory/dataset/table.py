"""Reads the Parquet tables of a dataset so that converting their values raises no error. Interprets no row."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from schemas.storage.place import Place, table_of

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

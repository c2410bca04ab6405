"""Reads the first rows of a table of episodes, for a page that is requested before the whole table is read."""

from __future__ import annotations

from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from factory.web.table import ROW_COLUMNS
from schemas.storage.dataset_files import METADATA_FILE
from schemas.storage.place import Place, table_of
from schemas.support.foreign import PARSER_ERRORS


class FirstRows(NamedTuple):
    """First rows of a table."""

    rows: list[dict[str, Any]]
    """Values of `ROW_COLUMNS`, in the order of the episodes."""
    total: int
    """Number of rows of the table."""


def read_first_rows(root: Place, count: int) -> FirstRows | None:
    """Returns the first rows of a table; `None` if it cannot be read. The error is reported when all rows are read."""
    try:
        file = pq.ParquetFile(table_of(root / METADATA_FILE))
        batch = next(file.iter_batches(count, columns=list(ROW_COLUMNS)), None)
        return FirstRows(batch.to_pylist() if batch else [], file.metadata.num_rows)
    except (OSError, pa.ArrowException, *PARSER_ERRORS):
        return None

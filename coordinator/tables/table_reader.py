"""Reads the dataset's tables: their digest, and rows that replace lost ledger records. Writes no file."""

from __future__ import annotations

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import ValidationError

from schemas.dataset.rows import FailedAttempt
from schemas.encoding.table_digest import DIGESTED, table_digest
from schemas.storage.place import Place, table_of
from schemas.support.foreign import PARSER_ERRORS


def read_digest(path: Place) -> str:
    """Returns the digest of the dataset with this `metadata.parquet`."""
    return table_digest(pq.read_table(table_of(path), columns=list(DIGESTED)))


def read_column(path: Place, name: str) -> list[str] | str:
    """Returns the values of a column as strings, or the reason why the column cannot be read."""
    try:
        return [str(value) for value in pq.read_table(table_of(path), columns=[name])[name].to_pylist()]
    except FileNotFoundError:
        return "is missing"
    except (pa.ArrowException, *PARSER_ERRORS) as error:
        return f"cannot be read: {error}"


def read_failed_attempts(path: Place) -> list[FailedAttempt]:
    """Returns the valid rows of `attempts.parquet`; empty if the file cannot be read."""
    try:
        rows = pq.read_table(table_of(path)).to_pylist()
    except (pa.ArrowException, *PARSER_ERRORS):
        return []
    failed_attempts = []
    for row in rows:
        try:
            failed_attempts.append(FailedAttempt.model_validate(row))
        except ValidationError:
            continue
    return failed_attempts

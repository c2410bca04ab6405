"""Reads the dataset's tables back, whole or not: a repair takes from them what the ledger has lost. Writes nothing."""

from __future__ import annotations

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import ValidationError

from schemas.dataset import FailedAttempt
from schemas.storage.place import Place, table_of
from schemas.support.foreign import PARSER_ERRORS

__all__ = ["read_column", "read_failed_attempts"]


def read_column(path: Place, name: str) -> list[str] | str:
    """Returns a column of text, or why it cannot be read, in words."""
    try:
        return [str(value) for value in pq.read_table(table_of(path), columns=[name])[name].to_pylist()]
    except FileNotFoundError:
        return "is not there"
    except (pa.ArrowException, *PARSER_ERRORS) as error:
        return f"cannot be read: {error}"


def read_failed_attempts(path: Place) -> list[FailedAttempt]:
    """Returns the rows of `attempts.parquet` that can be understood; none when the file cannot be read."""
    try:
        rows = pq.read_table(table_of(path)).to_pylist()
    except (pa.ArrowException, *PARSER_ERRORS):
        return []
    found = []
    for row in rows:
        try:
            found.append(FailedAttempt.model_validate(row))
        except ValidationError:
            continue
    return found

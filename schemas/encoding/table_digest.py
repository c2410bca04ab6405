"""Computes the digest of a dataset from the columns of its metadata table. Reads no file."""

from __future__ import annotations

from collections.abc import Iterator

import pyarrow as pa

from schemas.encoding.digest import dataset_digest

DIGESTED = ("episode_id", "content_digest")
"""Columns of the table that the digest depends on."""
_ROWS_AT_A_TIME = 10_000


def table_digest(table: pa.Table) -> str:
    """Returns the `schemas.encoding.digest.dataset_digest` of the episodes of a table."""
    ordered = table.select(DIGESTED).sort_by([(name, "ascending") for name in DIGESTED])
    return dataset_digest(_pairs(ordered), is_sorted=True)


def _pairs(table: pa.Table) -> Iterator[tuple[str, str]]:
    for batch in table.to_batches(max_chunksize=_ROWS_AT_A_TIME):
        yield from zip(*(column.to_pylist() for column in batch.columns), strict=True)

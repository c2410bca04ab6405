"""Which split tables a dataset should have: the rows of `metadata.parquet` by split and range. Reads that file only."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import xxhash

from schemas.dataset_files import METADATA_FILE, SPLITS_FOLDER
from schemas.errors import ArchiveCorrupt
from schemas.storage.place import Place, table_of
from schemas.terms import Split

__all__ = ["DIGEST_KEY", "PICTURES_KEY", "THUMBNAIL", "UNREADABLE", "SplitTable", "read_pictures", "split_tables_of"]

THUMBNAIL = "thumbnail"
"""Last column: frame 0 as `datasets.Image` stores it; null where the episode's file was not there."""
DIGEST_KEY, PICTURES_KEY = b"minivla_rows", b"minivla_thumbnails"
"""Keys of a file's own metadata: digest of its rows, number of its thumbnails."""
UNREADABLE = (pa.ArrowException, OSError, KeyError, ValueError)
"""What reading a damaged table raises."""
_SHARD_EPISODES = 10_000
"""Planned episodes whose rows share files: of 60 % in one split, 6000 rows, some 30 MB."""


class SplitTable(NamedTuple):
    """A file that a dataset should have."""

    name: str
    """Below the dataset's directory."""
    rows: pa.Table
    """Of `metadata.parquet`, in its order."""

    @property
    def digest(self) -> str:
        """XXH3-128 of the rows."""
        sink = pa.BufferOutputStream()
        whole = self.rows.replace_schema_metadata().combine_chunks()
        with pa.ipc.new_stream(sink, whole.schema) as stream:
            stream.write_table(whole)
        return xxhash.xxh3_128_hexdigest(sink.getvalue())

    def sources(self) -> list[dict[str, Any]]:
        """Returns, row by row, what names and finds the episode."""
        found: list[dict[str, Any]] = self.rows.select(
            ["episode_id", "content_digest", "file_name", "num_steps"]
        ).to_pylist()
        return found


def split_tables_of(root: Place, shard_episodes: int = _SHARD_EPISODES) -> Iterator[SplitTable]:
    """Yields the split tables of a dataset, one range of episode numbers after the other.

    Args:
        root: of the dataset.
        shard_episodes: planned episodes whose rows share files.

    Raises:
        ArchiveCorrupt: `metadata.parquet` cannot be read, or its episodes are not in ascending order.
    """
    try:
        with pq.ParquetFile(table_of(root / METADATA_FILE)) as file:
            for shard, rows in _ranges(file, shard_episodes):
                for split in Split:
                    chosen = rows.filter(pc.equal(rows["split"], str(split)))
                    if chosen.num_rows:
                        yield SplitTable(f"{SPLITS_FOLDER}/{split}-{shard:05d}.parquet", chosen)
    except UNREADABLE as error:
        raise ArchiveCorrupt(f"{root / METADATA_FILE} cannot be read: {error}; run `factory repair`") from error


def _ranges(file: pq.ParquetFile, shard_episodes: int) -> Iterator[tuple[int, pa.Table]]:
    last = -1
    for shard, slices in groupby(_slices(file, shard_episodes), lambda found: found[0]):
        if shard <= last:
            raise ArchiveCorrupt(f"{METADATA_FILE}: episodes are not in ascending order; run `factory repair`")
        last = shard
        yield shard, pa.concat_tables([rows for _, rows in slices])


def _slices(file: pq.ParquetFile, shard_episodes: int) -> Iterator[tuple[int, pa.Table]]:
    for batch in file.iter_batches():
        start = 0
        for shard, run in groupby((index - 1) // shard_episodes for index in batch["index"].to_pylist()):
            count = len(list(run))
            yield shard, pa.Table.from_batches([batch.slice(start, count)])
            start += count


def read_pictures(path: Place) -> dict[str, bytes]:
    """Returns the thumbnails of a split table by the content digest of their episode; none where it cannot be read."""
    columns = ["content_digest", THUMBNAIL]
    try:
        found = pq.read_table(table_of(path), columns=columns, page_checksum_verification=True).to_pylist()
    except UNREADABLE:
        return {}
    return {row["content_digest"]: row[THUMBNAIL]["bytes"] for row in found if row[THUMBNAIL] is not None}

"""Determines the split tables of a dataset: the rows of `metadata.parquet` by split and range of episode numbers.

The module reads `metadata.parquet` and thumbnails, and writes no file.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import xxhash

from schemas.dataset.meta import read_dataset_meta
from schemas.errors import ArchiveCorrupt, WorldError
from schemas.storage.dataset_files import METADATA_FILE, SPLITS_FOLDER
from schemas.storage.place import Place, table_of
from schemas.terms import Recording, Split

THUMBNAIL = "thumbnail"
"""Name of the last column: frame 0 in the format of `datasets.Image`; null if the episode's file was not available, or
if the dataset records states and `factory push --thumbnails` has not rendered it."""
DIGEST_KEY, PICTURES_KEY = b"minivla_rows", b"minivla_thumbnails"
"""Keys of the file metadata: digest of the rows and number of thumbnails."""
UNREADABLE = (pa.ArrowException, OSError, KeyError, ValueError)
"""Exceptions of reading a damaged table."""
_SHARD_EPISODES = 10_000
"""Number of planned episodes per shard. A split with 60 % of the episodes has 6000 rows per file, about 30 MB."""


class SplitTable(NamedTuple):
    """Expected split table of a dataset."""

    name: str
    """Path relative to the root of the dataset."""
    rows: pa.Table
    """Rows of `metadata.parquet`, in its order."""

    @property
    def digest(self) -> str:
        """XXH3-128 of the rows, hexadecimal."""
        sink = pa.BufferOutputStream()
        whole = self.rows.replace_schema_metadata().combine_chunks()
        with pa.ipc.new_stream(sink, whole.schema) as stream:
            stream.write_table(whole)
        return xxhash.xxh3_128_hexdigest(sink.getvalue())

    def sources(self) -> list[dict[str, Any]]:
        """Returns id, content digest, file name and length of the episode of each row."""
        found: list[dict[str, Any]] = self.rows.select(
            ["episode_id", "content_digest", "file_name", "num_steps"]
        ).to_pylist()
        return found


def split_tables_of(root: Place, shard_episodes: int = _SHARD_EPISODES) -> Iterator[SplitTable]:
    """Yields the split tables of a dataset by range of episode numbers.

    Args:
        root: root of the dataset.
        shard_episodes: number of planned episodes per shard.

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


def has_pictures(root: Place) -> bool:
    """Returns whether the episodes store frames, from which thumbnails are made."""
    try:
        return read_dataset_meta(root).plan.record is Recording.FRAMES
    except WorldError:
        return True


def lacks_pictures(path: Place) -> bool:
    """Returns whether a split table has rows without thumbnails; `False` if it does not exist or is unreadable."""
    try:
        found = pq.read_metadata(table_of(path))
    except UNREADABLE:
        return False
    return bool(int((found.metadata or {}).get(PICTURES_KEY, b"0")) < found.num_rows)


def read_pictures(path: Place) -> dict[str, bytes]:
    """Returns the thumbnails of a split table by content digest of the episode; empty if the table is unreadable."""
    columns = ["content_digest", THUMBNAIL]
    try:
        found = pq.read_table(table_of(path), columns=columns, page_checksum_verification=True).to_pylist()
    except UNREADABLE:
        return {}
    return {row["content_digest"]: row[THUMBNAIL]["bytes"] for row in found if row[THUMBNAIL] is not None}

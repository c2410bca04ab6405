"""Writes `metadata.parquet` in row groups by episode number, and reuses the groups whose episode files are unchanged.

The SHA-256 of an episode's file determines its whole row. Therefore the same ledger gives the same bytes, independently
of earlier versions of the table, and no state is kept between two calls.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any, Protocol

import pyarrow as pa
import pyarrow.parquet as pq

from coordinator.archive.contract import Archive
from coordinator.expansion.instances import Sides
from coordinator.tables.aggregates import TableAggregates
from schemas.base import Model
from schemas.dataset import EpisodeSummary
from schemas.storage.place import Place, table_of
from schemas.support.foreign import PARSER_ERRORS

GROUP_ROWS = 2000
"""Number of episode numbers per row group."""
_SUMS = ("num_steps", "spawn_dist_m", "trajectory_length_m", "final_ne_m")
_MAKER = ("renderer", "software", "cpu")
_CELL = ["scene", "split", "spawn_tier"]


class Episodes(Protocol):
    """Source of the archived episodes of a run, ordered by number."""

    def digests(self) -> Iterator[tuple[int, str]]:
        """Yields number and file SHA-256 of each episode, ascending."""

    def rows(self, first: int, last: int) -> Iterable[EpisodeSummary]:
        """Returns the rows of the episodes from `first` to `last`, ascending."""


class ListedEpisodes:
    """Source of episodes from a list in memory.

    Args:
        rows: rows in ascending order of their episode numbers.
    """

    def __init__(self, rows: Iterable[EpisodeSummary]) -> None:
        self._rows = list(rows)

    def digests(self) -> Iterator[tuple[int, str]]:
        """See `Episodes`."""
        return ((row.index, row.file_sha256) for row in self._rows)

    def rows(self, first: int, last: int) -> Iterable[EpisodeSummary]:
        """See `Episodes`."""
        return [row for row in self._rows if first <= row.index <= last]


def write_metadata(
    archive: Archive,
    name: str,
    schema: pa.Schema,
    side_column: str,
    episodes: Episodes,
    sides: Mapping[str, Sides],
    aggregates: TableAggregates,
    *,
    anew: bool,
) -> int:
    """Writes the table by row groups and updates the aggregates.

    Args:
        archive: archive of the dataset, held exclusively.
        name: file name of the table.
        schema: schema of the table.
        side_column: name of the column with the side of the target.
        episodes: archived episodes.
        sides: mapping of scene name to the side of each instance.
        aggregates: aggregates to update with the rows.
        anew: whether to ignore the existing table.

    Returns:
        The number of rows.

    Raises:
        WorldError: the disk is full or unavailable; the previous table is unchanged.
    """
    former, count = None if anew else _Former(archive.root / name, schema), 0
    with archive.replacing(name) as path, pq.ParquetWriter(path, schema, compression="zstd") as writer:
        for number, found in groupby(episodes.digests(), lambda one: (one[0] - 1) // GROUP_ROWS):
            digests = list(found)
            table = former.group(digests) if former is not None else None
            if table is None:
                rows = episodes.rows(number * GROUP_ROWS + 1, (number + 1) * GROUP_ROWS)
                plain = [{**plain_row(row), side_column: _side(sides, row)} for row in rows]
                table = pa.Table.from_pylist(plain, schema=schema)
            writer.write_table(table, row_group_size=GROUP_ROWS)
            _add(aggregates, table)
            count += len(digests)
    return count


def plain_row(row: Model) -> dict[str, Any]:
    """Returns a model without nested models as a row of a table."""
    values = {name: getattr(row, name) for name in type(row).model_fields}
    return {name: str(value) if isinstance(value, enum.StrEnum) else value for name, value in values.items()}


class _Former:
    """Row groups of the existing table; empty if the table is unreadable or has other columns."""

    def __init__(self, path: Place, schema: pa.Schema) -> None:
        self._schema = schema
        self._places: dict[int, int] = {}
        try:
            self._file = pq.ParquetFile(table_of(path))
            if self._file.schema_arrow.equals(schema):
                self._places = {first: group for group, first in self._firsts()}
        except (pa.ArrowException, *PARSER_ERRORS):
            self._places = {}

    def group(self, digests: Sequence[tuple[int, str]]) -> pa.Table | None:
        """Returns the row group that contains exactly these episodes, or `None`."""
        place = self._places.get(digests[0][0])
        if place is None:
            return None
        try:
            known = self._file.read_row_group(place, columns=["index", "file_sha256"])
            if list(zip(known["index"].to_pylist(), known["file_sha256"].to_pylist(), strict=True)) != digests:
                return None
            return self._file.read_row_group(place).cast(self._schema)
        except (pa.ArrowException, *PARSER_ERRORS):
            return None

    def _firsts(self) -> Iterator[tuple[int, int]]:
        """Yields each row group with its first episode number, from the statistics of the file."""
        column = self._schema.get_field_index("index")
        for group in range(self._file.metadata.num_row_groups):
            known = self._file.metadata.row_group(group).column(column).statistics
            if known is not None and known.has_min_max:
                yield group, int(known.min)


def _side(sides: Mapping[str, Sides], row: EpisodeSummary) -> str | None:
    side = sides.get(row.scene, {}).get(row.target_id)
    return None if side is None else str(side)


def _add(aggregates: TableAggregates, table: pa.Table) -> None:
    names, digests = table["episode_id"].to_pylist(), table["content_digest"].to_pylist()
    aggregates.digests.extend(zip(names, digests, strict=True))
    aggregates.renderers.update(table["renderer"].unique().to_pylist())
    aggregates.makers.update(zip(*(table[name].to_pylist() for name in _MAKER), strict=True))
    for row in _sums(table, ["target_category"], ()):
        aggregates.categories[row["target_category"]] += row["count_all"]
    for row in _sums(table, _CELL, ()):
        aggregates.counts[row["scene"], row["split"], row["spawn_tier"]] += row["count_all"]
    for key, sums in (("scene", aggregates.scenes), ("spawn_tier", aggregates.tiers)):
        for row in _sums(table, [key], _SUMS):
            sums[row[key]].add(row["count_all"], *(row[f"{name}_sum"] for name in _SUMS))


def _sums(table: pa.Table, keys: list[str], columns: Sequence[str]) -> list[dict[str, Any]]:
    """Returns row counts and column sums by key; with one thread, so that floating-point sums are reproducible."""
    grouped = table.group_by(keys, use_threads=False)
    found: list[dict[str, Any]] = grouped.aggregate(
        [*((name, "sum") for name in columns), ([], "count_all")]
    ).to_pylist()
    return found

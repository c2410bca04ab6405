"""Writes `metadata.parquet`, `attempts.parquet`, `dataset_meta.json` and the dataset card.

Each call generates the files from the ledger, which stays authoritative, and replaces each file as a whole. The module
does not change the ledger.
"""

from __future__ import annotations

import enum
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple, get_args, get_origin

import pyarrow as pa

from coordinator.archive.contract import Archive
from coordinator.expansion.instances import Sides
from coordinator.tables.aggregates import TableAggregates, aggregate_episodes, aggregate_failures
from coordinator.tables.card import dataset_card, splits_at, with_shards
from coordinator.tables.row_groups import GroupedTable, ListedRows, RowSource, plain_row
from coordinator.tables.table_reader import read_digest
from schemas.base import Model
from schemas.dataset.meta import (
    FORMAT_WITH_SOURCES,
    DatasetMeta,
    DatasetSource,
    GateOutcome,
    fields_of_plan,
    git_commit,
    read_dataset_meta,
    software_versions,
)
from schemas.dataset.rows import EpisodeSummary, FailedAttempt
from schemas.errors import WorldError
from schemas.job import episode_id
from schemas.plan import Plan
from schemas.storage.dataset_files import ATTEMPTS_FILE, CARD_FILE, META_FILE, METADATA_FILE
from schemas.storage.place import Place

SIDE_COLUMN = "instance_side"
"""Name of the last column of `metadata.parquet`, the side of the target: `train`, `evaluation` or `shared`; null if the
plan does not separate instances."""
SOURCE_COLUMNS = ("source", "source_episode")
"""Names of the columns that `metadata.parquet` of a dataset with sources has in addition: name of the source, and id of
the episode in it."""
_TYPES = {str: pa.string(), int: pa.int64(), float: pa.float64(), bool: pa.bool_()}


class TableContent(NamedTuple):
    """Content of the files that the plan and the ledger determine."""

    plan: Plan
    """Plan of the run."""
    scenes: Mapping[str, str]
    """Mapping of scene name to SHA-256 of its compiled package."""
    episodes: RowSource
    """Rows of all archived episodes."""
    failures: RowSource
    """Rows of all failed attempts."""
    sides: Mapping[str, Sides] = MappingProxyType({})
    """Mapping of scene name to the side of each instance, for plans with disjoint instances."""
    shared: Mapping[str, tuple[str, ...]] | None = None
    """Mapping of scene name to the categories with shared instances; `None` for other plans."""
    gate: Sequence[GateOutcome] = ()
    """Results of the gate; empty keeps the results in the existing metadata."""
    refused_seeds: Mapping[str, tuple[str, ...]] = MappingProxyType({})
    """Reasons why seeds of layouts were not used, by layout."""
    sources: Sequence[DatasetSource] = ()
    """Runs of a merged or extended dataset, in the order of their episodes."""

    def episode_rows(self, first: int, last: int) -> Iterator[dict[str, Any]]:
        """Yields rows of `metadata.parquet`."""
        for row in self.episodes.rows(first, last):
            plain = plain_row(row)
            side = self.sides.get(plain["scene"], {}).get(plain["target_id"])
            yield {**plain, SIDE_COLUMN: None if side is None else str(side), **self._origin(plain["index"])}

    def _origin(self, index: int) -> dict[str, str]:
        source = next((each for each in self.sources if index in each.numbers), None)
        if source is None:
            return {}
        return dict(zip(SOURCE_COLUMNS, (source.name, episode_id(source.own_index(index))), strict=True))

    def failure_rows(self, first: int, last: int) -> Iterator[dict[str, Any]]:
        """Yields rows of `attempts.parquet`."""
        return map(plain_row, self.failures.rows(first, last))


class TableChanges(NamedTuple):
    """Numbers of the episodes whose rows have changed since the last write."""

    episodes: Collection[int]
    """Episodes that were archived or lost."""
    failures: Collection[int]
    """Episodes with new failed attempts."""


class DatasetTables:
    """Writer of the four files of one dataset; keeps what it has written, for comparison.

    Args:
        has_sources: whether the dataset has sources, so its rows name them.
    """

    def __init__(self, *, has_sources: bool = False) -> None:
        schema = _METADATA_SCHEMA
        for name in SOURCE_COLUMNS if has_sources else ():
            schema = schema.append(pa.field(name, pa.string()))
        self._episodes = GroupedTable(METADATA_FILE, schema, aggregate_episodes)
        self._failures = GroupedTable(ATTEMPTS_FILE, _ATTEMPTS_SCHEMA, aggregate_failures)

    def write(
        self, archive: Archive, content: TableContent, now: datetime, changes: TableChanges | None = None
    ) -> DatasetMeta:
        """Writes all four files. The memory use does not depend on the number of rows.

        Args:
            archive: archive of the dataset, held exclusively.
            content: content of the files.
            now: the time of writing, UTC.
            changes: changes since the last call of this object; `None` reads every row.

        Returns:
            The written metadata; `complete` states whether all planned episodes are archived.

        Raises:
            WorldError: the disk is full or unavailable; each file is complete, either the previous or the new version.
        """
        plan, former = content.plan, _former(archive.root)
        changed = (None, None) if changes is None else changes
        episodes = self._episodes.write(archive, plan.episodes, content.episode_rows, changed[0])
        failures = self._failures.write(archive, plan.episodes, content.failure_rows, changed[1])
        complete = episodes.rows == plan.episodes
        fields = fields_of_plan(plan)
        if content.sources:
            fields["format"] = max(fields["format"], FORMAT_WITH_SOURCES)
        meta = DatasetMeta(
            **fields,
            episodes=episodes.rows,
            planned=plan.episodes,
            complete=complete,
            dataset_digest=read_digest(archive.root / METADATA_FILE) if complete else None,
            renderers=tuple(sorted(episodes.renderers)),
            scenes=dict(content.scenes),
            failed_attempts=failures.rows,
            software=software_versions(),
            git_commit=git_commit(Path(__file__).parents[2]),
            created_at=former.created_at if former else now.astimezone(UTC),
            updated_at=now,
            shared_instances=None if content.shared is None else dict(content.shared),
            gate=tuple(content.gate) or (former.gate if former else ()),
            refused_seeds=dict(content.refused_seeds) or (former.refused_seeds if former else {}),
            sources=tuple(content.sources),
        )
        aggregates = TableAggregates.total((episodes, failures))
        card = dataset_card(meta, aggregates, splits_at(archive.root))
        _write_text(archive, CARD_FILE, with_shards(card, len(archive.shards())))
        _write_text(archive, META_FILE, meta.model_dump_json(indent=1))  # last, because it describes the other files
        return meta


def write_tables(
    archive: Archive,
    plan: Plan,
    scenes: Mapping[str, str],
    episodes: Iterable[EpisodeSummary],
    failures: Iterable[FailedAttempt],
    now: datetime,
    sides: Mapping[str, Sides] = MappingProxyType({}),
    shared: Mapping[str, tuple[str, ...]] | None = None,
    gate: Sequence[GateOutcome] = (),
) -> DatasetMeta:
    """Writes all four files from rows in memory; see `TableContent` and `DatasetTables.write`.

    Args:
        archive: archive of the dataset, held exclusively.
        plan: plan of the run.
        scenes: mapping of scene name to SHA-256 of its compiled package.
        episodes: rows of all archived episodes, ordered by number.
        failures: rows of all failed attempts, in the order of the table.
        now: the time of writing, UTC.
        sides: mapping of scene name to the side of each instance.
        shared: mapping of scene name to the categories with shared instances.
        gate: results of the gate.
    """
    content = TableContent(
        plan,
        scenes,
        episodes=ListedRows(episodes),
        failures=ListedRows(failures),
        sides=sides,
        shared=shared,
        gate=gate,
    )
    return DatasetTables().write(archive, content, now)


def parquet_schema(model: type[Model]) -> pa.Schema:
    """Returns the schema of a model without nested models, with the columns in the order of the fields."""
    return pa.schema([(name, _column_type(info.annotation)) for name, info in model.model_fields.items()])


def _column_type(annotation: Any) -> pa.DataType:
    if type(None) in get_args(annotation):  # every column is nullable
        annotation = next(kind for kind in get_args(annotation) if kind is not type(None))
    kind = get_args(annotation)[0] if get_origin(annotation) is Annotated else annotation
    if isinstance(kind, type) and issubclass(kind, enum.StrEnum):
        return pa.string()
    if kind is datetime:
        return pa.timestamp("us", tz="UTC")
    return _TYPES[kind]


_METADATA_SCHEMA = parquet_schema(EpisodeSummary).append(pa.field(SIDE_COLUMN, pa.string()))
_ATTEMPTS_SCHEMA = parquet_schema(FailedAttempt)


def _write_text(archive: Archive, name: str, text: str) -> None:
    with archive.replacing(name) as path:
        path.write_text(text, encoding="utf-8")


def _former(root: Place) -> DatasetMeta | None:
    try:
        return read_dataset_meta(root)
    except WorldError:
        return None

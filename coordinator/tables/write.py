"""Writes `metadata.parquet`, `attempts.parquet`, `dataset_meta.json` and the dataset card.

Each call generates the files from the ledger, which stays authoritative, and replaces each file as a whole. The module
does not change the ledger.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, get_args, get_origin

import pyarrow as pa
import pyarrow.parquet as pq

from coordinator.archive.contract import Archive
from coordinator.expansion.instances import Sides
from coordinator.tables.aggregates import TableAggregates
from coordinator.tables.card import dataset_card, with_shards
from coordinator.tables.card_configs import splits_at
from coordinator.tables.metadata_table import Episodes, ListedEpisodes, plain_row, write_metadata
from schemas.base import Model
from schemas.dataset import EpisodeSummary, FailedAttempt
from schemas.dataset_files import ATTEMPTS_FILE, CARD_FILE, META_FILE, METADATA_FILE
from schemas.dataset_meta import DatasetMeta, GateOutcome, git_commit, read_dataset_meta, software_versions
from schemas.encoding.digest import dataset_digest
from schemas.errors import WorldError
from schemas.plan import Plan
from schemas.storage.place import Place

SIDE_COLUMN = "instance_side"
"""Name of the last column of `metadata.parquet`, the side of the target: `train`, `evaluation` or `shared`; null if the
plan does not separate the sides."""
_BATCH_ROWS = 2000
_TYPES = {str: pa.string(), int: pa.int64(), float: pa.float64(), bool: pa.bool_()}


def write_tables(
    archive: Archive,
    plan: Plan,
    scenes: Mapping[str, str],
    episodes: Episodes | Iterable[EpisodeSummary],
    failures: Iterable[FailedAttempt],
    now: datetime,
    sides: Mapping[str, Sides] = MappingProxyType({}),
    shared: Mapping[str, tuple[str, ...]] | None = None,
    gate: Sequence[GateOutcome] = (),
    *,
    anew: bool = True,
) -> DatasetMeta:
    """Writes all four files. The rows are streamed: the memory use is a few hundred bytes per episode.

    Args:
        archive: archive of the dataset, held exclusively.
        plan: plan of the run.
        scenes: mapping of scene name to SHA-256 of its compiled package.
        episodes: rows of all archived episodes, ordered by number.
        failures: rows of all failed attempts, in the order of the table.
        now: the time of writing, UTC.
        sides: mapping of scene name to the side of each instance, for plans with disjoint instances.
        shared: mapping of scene name to the categories with shared instances; `None` for other plans.
        gate: results of the pilot; empty keeps the results in the existing metadata.
        anew: whether to generate every row from the ledger. Otherwise the rows with unchanged episode files are copied
            from the existing table, which this process has written.

    Returns:
        The written metadata; `complete` states whether all planned episodes are archived.

    Raises:
        WorldError: the disk is full or unavailable; each file is complete, either the previous or the new version.
    """
    aggregates, former = TableAggregates(), _former(archive.root)
    listed = ListedEpisodes(episodes) if isinstance(episodes, Iterable) else episodes
    written = write_metadata(
        archive, METADATA_FILE, _METADATA_SCHEMA, SIDE_COLUMN, listed, sides, aggregates, anew=anew
    )
    failed = _write_rows(archive, ATTEMPTS_FILE, _ATTEMPTS_SCHEMA, map(plain_row, aggregates.count_failures(failures)))
    meta = DatasetMeta(
        **_of_plan(plan, written, aggregates),
        scenes=dict(scenes),
        failed_attempts=failed,
        software=software_versions(),
        git_commit=git_commit(Path(__file__).parents[2]),
        created_at=former.created_at if former else now.astimezone(UTC),
        updated_at=now,
        shared_instances=None if shared is None else dict(shared),
        gate=tuple(gate) or (former.gate if former else ()),
    )
    card = dataset_card(meta, aggregates, splits_at(archive.root))
    _write_text(archive, CARD_FILE, with_shards(card, len(archive.shards())))
    _write_text(archive, META_FILE, meta.model_dump_json(indent=1))  # last, because it describes the other files
    return meta


def _of_plan(plan: Plan, written: int, aggregates: TableAggregates) -> dict[str, Any]:
    """Returns the fields of the description that follow from the plan and the written rows."""
    complete = written == plan.episodes
    return {
        "run": plan.run,
        "plan_digest": plan.digest,
        "seed": plan.seed,
        "plan": plan,
        "episodes": written,
        "planned": plan.episodes,
        "complete": complete,
        "dataset_digest": dataset_digest(aggregates.digests) if complete else None,
        "renderers": tuple(sorted(aggregates.renderers)),
    }


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


def _write_rows(archive: Archive, name: str, schema: pa.Schema, rows: Iterable[dict[str, Any]]) -> int:
    source, count = iter(rows), 0
    with archive.replacing(name) as path, pq.ParquetWriter(path, schema, compression="zstd") as writer:
        while batch := list(islice(source, _BATCH_ROWS)):
            writer.write_batch(pa.RecordBatch.from_pylist(batch, schema=schema))
            count += len(batch)
    return count


def _write_text(archive: Archive, name: str, text: str) -> None:
    with archive.replacing(name) as path:
        path.write_text(text, encoding="utf-8")


def _former(root: Place) -> DatasetMeta | None:
    try:
        return read_dataset_meta(root)
    except WorldError:
        return None

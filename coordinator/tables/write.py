"""The tables beside the episodes: `metadata.parquet`, `attempts.parquet`, `dataset_meta.json` and the card.

Written anew from the ledger whenever asked, each file replaced as a whole; the ledger stays the truth.
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
from coordinator.tables.card import dataset_card
from coordinator.tables.card_configs import splits_at
from coordinator.tables.metadata_table import Episodes, ListedEpisodes, plain_row, write_metadata
from coordinator.tables.tally import Tally
from schemas.base import Model
from schemas.dataset import EpisodeSummary, FailedAttempt
from schemas.dataset_files import ATTEMPTS_FILE, CARD_FILE, META_FILE, METADATA_FILE
from schemas.dataset_meta import DatasetMeta, GateOutcome, git_commit, read_dataset_meta, software_versions
from schemas.encoding.digest import dataset_digest
from schemas.errors import WorldError
from schemas.plan import Plan
from schemas.storage.place import Place

__all__ = ["SIDE_COLUMN", "parquet_schema", "write_tables"]

SIDE_COLUMN = "instance_side"
"""Last column of `metadata.parquet`: who may name the target: `train`, `evaluation`, `shared`; null without promise."""
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
    """Writes all four files; streams the rows, so that memory grows by some hundred bytes an episode only.

    Args:
        archive: open, and thereby ours.
        plan: of the run.
        scenes: scene name -> digest of its compiled package.
        episodes: rows of all archived episodes in ascending order.
        failures: rows of all failed attempts, in the order they shall have.
        now: the time of writing, UTC.
        sides: scene name -> side of each instance, where the plan keeps training and evaluation apart.
        shared: scene name -> categories whose instances they share nevertheless; `None` without such a plan.
        gate: what the pilot found; empty keeps what the directory's description says already.
        anew: whether to make every row from the ledger; else those of `metadata.parquet` whose files are unchanged are
            taken from the table that is there, which this process has written.

    Returns:
        The description as written; `complete` and `dataset_digest` tell whether and with what the dataset is whole.

    Raises:
        WorldError: the disk is full or gone; the files are as they were.
    """
    tally, former = Tally(), _former(archive.root)
    listed = ListedEpisodes(episodes) if isinstance(episodes, Iterable) else episodes
    written = write_metadata(archive, METADATA_FILE, _METADATA_SCHEMA, SIDE_COLUMN, listed, sides, tally, anew=anew)
    failed = _write_rows(archive, ATTEMPTS_FILE, _ATTEMPTS_SCHEMA, map(plain_row, tally.watch_failures(failures)))
    meta = DatasetMeta(
        **_of_plan(plan, written, tally),
        scenes=dict(scenes),
        failed_attempts=failed,
        software=software_versions(),
        git_commit=git_commit(Path(__file__).parents[2]),
        created_at=former.created_at if former else now.astimezone(UTC),
        updated_at=now,
        shared_instances=None if shared is None else dict(shared),
        gate=tuple(gate) or (former.gate if former else ()),
    )
    _write_text(archive, CARD_FILE, dataset_card(meta, tally, splits_at(archive.root)))
    _write_text(archive, META_FILE, meta.model_dump_json(indent=1))  # last: it describes the others
    return meta


def _of_plan(plan: Plan, written: int, tally: Tally) -> dict[str, Any]:
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
        "dataset_digest": dataset_digest(tally.digests) if complete else None,
        "renderers": tuple(sorted(tally.renderers)),
    }


def parquet_schema(model: type[Model]) -> pa.Schema:
    """Returns the columns of a model of flat fields, in the order of the fields."""
    return pa.schema([(name, _column_type(info.annotation)) for name, info in model.model_fields.items()])


def _column_type(annotation: Any) -> pa.DataType:
    if type(None) in get_args(annotation):  # a column may be empty anyway
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

"""Reads the rows that statistics rest on, and says what it leaves out and why. Reads only; computes nothing."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import ValidationError

from coordinator.archive import EPISODES
from coordinator.dataset_meta import META_FILE, DatasetMeta
from coordinator.dataset_tables import ATTEMPTS_FILE, METADATA_FILE, FailedAttempt
from coordinator.summary import EpisodeSummary, file_name_of
from factory.dataset import Dataset
from factory.stats.model import Remark
from schemas.base import Model

__all__ = ["Rows", "read_rows"]

_NAMED = 3
"""Examples that a remark names."""
Row = TypeVar("Row", bound=Model)


@dataclass
class Rows:
    """What could be read."""

    meta: DatasetMeta
    episodes: list[EpisodeSummary] = field(default_factory=list)
    failures: list[FailedAttempt] | None = None
    """`None` when the record of attempts cannot be read."""
    remarks: list[Remark] = field(default_factory=list)

    def note(self, file: str, text: str) -> None:
        """Notes that something is unfinished."""
        self.remarks.append(Remark(is_damage=False, file=file, text=text))

    def blame(self, file: str, text: str) -> None:
        """Notes damage."""
        self.remarks.append(Remark(is_damage=True, file=file, text=text))


def read_rows(root: Path) -> Rows:
    """Reads the tables of a dataset; rows that are damaged or whose episode is not there are left out and said.

    Raises:
        WorldError: there is no dataset, or it is of a newer format.
        ArchiveCorrupt: its description or its table of episodes cannot be read at all.
    """
    dataset = Dataset(root)
    rows = Rows(dataset.meta)
    rows.episodes = _without_twins(rows, _parse(rows, METADATA_FILE, dataset.metadata, EpisodeSummary))
    rows.episodes = _with_files(rows, root)
    rows.failures = _read_failures(rows, root / ATTEMPTS_FILE)
    _compare_with_meta(rows, dataset.metadata.num_rows)
    return rows


def _parse(rows: Rows, file: str, table: pa.Table, model: type[Row]) -> list[Row]:
    found: list[Row] = []
    wrong: list[str] = []
    for number, values in enumerate(table.to_pylist(), 1):
        try:
            found.append(model.model_validate(values))
        except ValidationError as error:
            wrong.append(_say_wrong(number, values, error))
    if wrong:
        rows.blame(file, f"{len(wrong)} of {table.num_rows} rows left out: {_some(wrong)}")
    return found


def _say_wrong(number: int, values: dict[str, Any], error: ValidationError) -> str:
    columns = sorted({str(item["loc"][0]) for item in error.errors() if item["loc"]})
    return f"row {number} ({values.get('episode_id')}) has wrong values in {', '.join(columns)}"


def _without_twins(rows: Rows, episodes: list[EpisodeSummary]) -> list[EpisodeSummary]:
    first: dict[str, EpisodeSummary] = {}
    twins = [row.episode_id for row in episodes if first.setdefault(row.episode_id, row) is not row]
    if twins:
        rows.blame(METADATA_FILE, f"{len(twins)} rows left out that stand there twice: {_some(twins)}")
    return list(first.values())


def _with_files(rows: Rows, root: Path) -> list[EpisodeSummary]:
    if rows.episodes and not (root / EPISODES).is_dir():
        rows.note(EPISODES, "is not there; the statistics rest on the tables alone")
        return rows.episodes
    missing = [row for row in rows.episodes if not (root / file_name_of(row.episode_id)).is_file()]
    if missing:
        names = _some([row.episode_id for row in missing])
        rows.blame(EPISODES, f"{len(missing)} episodes left out whose file is not there: {names}")
    gone = {row.episode_id for row in missing}
    return [row for row in rows.episodes if row.episode_id not in gone]


def _read_failures(rows: Rows, path: Path) -> list[FailedAttempt] | None:
    try:
        table = pq.read_table(path).select(list(FailedAttempt.model_fields))
    except FileNotFoundError:
        rows.blame(ATTEMPTS_FILE, "is not there; attempts are left out; a resumed run writes it anew")
    except (pa.ArrowException, OSError, KeyError) as error:
        rows.blame(ATTEMPTS_FILE, f"cannot be read ({error}); attempts are left out; a resumed run writes it anew")
    else:
        if table.num_rows != rows.meta.failed_attempts:
            rows.blame(ATTEMPTS_FILE, f"has {table.num_rows} rows, {META_FILE} says {rows.meta.failed_attempts}")
        return _parse(rows, ATTEMPTS_FILE, table, FailedAttempt)
    return None


def _compare_with_meta(rows: Rows, table_rows: int) -> None:
    meta = rows.meta
    if table_rows != meta.episodes:
        rows.blame(METADATA_FILE, f"has {table_rows} rows, {META_FILE} says {meta.episodes} episodes")
    if not meta.complete:
        rows.note(META_FILE, f"the run is not finished: {meta.episodes} of {meta.planned} planned episodes")
    if not rows.episodes:
        rows.note(METADATA_FILE, "no episodes; every mean is left out")


def _some(names: list[str]) -> str:
    rest = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{rest}"

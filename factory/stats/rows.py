"""Reads the rows that statistics rest on, and says what it leaves out and why. Reads only; computes nothing."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, TypeVar

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import ValidationError

from coordinator.expansion.cells import cells
from factory.dataset.reader import Dataset
from factory.stats.model import Remark
from schemas.base import Model
from schemas.dataset import EpisodeSummary, FailedAttempt, file_name_of
from schemas.dataset_files import ATTEMPTS_FILE, EPISODES, META_FILE, METADATA_FILE
from schemas.dataset_meta import DatasetMeta
from schemas.storage.place import Place, children, table_of
from schemas.terms import Split

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


def read_rows(root: Place) -> Rows:
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
    _compare_with_plan(rows)
    _compare_with_promise(rows)
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
        rows.blame(file, f"{len(wrong)} of {table.num_rows} rows skipped: {_some(wrong)}")
    return found


def _say_wrong(number: int, values: dict[str, Any], error: ValidationError) -> str:
    columns = sorted({str(item["loc"][0]) for item in error.errors() if item["loc"]})
    return f"row {number} ({values.get('episode_id')}) has wrong values in {', '.join(columns)}"


def _without_twins(rows: Rows, episodes: list[EpisodeSummary]) -> list[EpisodeSummary]:
    first: dict[str, EpisodeSummary] = {}
    twins = [row.episode_id for row in episodes if first.setdefault(row.episode_id, row) is not row]
    if twins:
        rows.blame(METADATA_FILE, f"{len(twins)} duplicate rows skipped: {_some(twins)}")
    return list(first.values())


def _with_files(rows: Rows, root: Place) -> list[EpisodeSummary]:
    found = {f"{EPISODES}/{place.name}": place for place in children(root / EPISODES)}
    if rows.episodes and not found and not (root / EPISODES).is_dir():
        rows.note(EPISODES, "is not there; the statistics rest on the tables alone")
        return rows.episodes
    sizes = {row.episode_id: _size_of(found.get(file_name_of(row.episode_id))) for row in rows.episodes}
    missing = [name for name, size in sizes.items() if size is None]
    cut = [
        f"{row.episode_id} ({sizes[row.episode_id]} bytes, recorded {row.file_bytes})"
        for row in rows.episodes
        if sizes[row.episode_id] not in (None, row.file_bytes)
    ]
    if missing:
        rows.blame(EPISODES, f"{len(missing)} episodes skipped, because the file is missing: {_some(missing)}")
    if cut:
        rows.blame(EPISODES, f"{len(cut)} episodes skipped, because the file has another size: {_some(cut)}")
    return [row for row in rows.episodes if sizes[row.episode_id] == row.file_bytes]


def _size_of(place: Place | None) -> int | None:
    try:
        return None if place is None else place.stat().st_size
    except OSError:
        return None


def _read_failures(rows: Rows, path: Place) -> list[FailedAttempt] | None:
    try:
        table = pq.read_table(table_of(path)).select(list(FailedAttempt.model_fields))
    except FileNotFoundError:
        rows.blame(ATTEMPTS_FILE, "is missing; attempts are not counted; resume the run to rewrite it")
    except (pa.ArrowException, OSError, KeyError) as error:
        rows.blame(ATTEMPTS_FILE, f"cannot be read ({error}); attempts are not counted; resume the run to rewrite it")
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
        rows.note(METADATA_FILE, "no episodes; there are no means")


def _compare_with_plan(rows: Rows) -> None:
    """Blames cells that hold more than their quota, or less although the run says that it is complete."""
    plan = rows.meta.plan
    found = Counter((row.scene, row.split, row.spawn_tier) for row in rows.episodes)
    wanted = {(scene.name, *cell): count for scene in plan.scenes for cell, count in cells(plan, scene).items()}
    wrong = [
        f"{' / '.join(key)} has {found[key]} of {wanted.get(key, 0)}"
        for key in sorted(found.keys() | wanted.keys())
        if found[key] > wanted.get(key, 0) or (rows.meta.complete and found[key] < wanted.get(key, 0))
    ]
    if wrong:
        rows.blame(METADATA_FILE, f"{len(wrong)} cells differ from the plan: {_some(wrong)}")


def _compare_with_promise(rows: Rows) -> None:
    """Says which categories training and evaluation share, and blames instances that they were not to share."""
    shared = rows.meta.shared_instances
    if shared is None:
        return
    for scene, categories in shared.items():
        if categories:
            text = f"{scene} has too few of {', '.join(categories)} to keep training and evaluation apart"
            rows.note(META_FILE, text)
    train: set[tuple[str, str]] = set()
    evaluation: set[tuple[str, str]] = set()
    for row in rows.episodes:
        if row.target_category not in shared.get(row.scene, ()):
            (train if row.split is Split.TRAIN_ID else evaluation).add((row.scene, row.target_id))
    both = [" ".join(key) for key in sorted(train & evaluation)]
    if both:
        rows.blame(METADATA_FILE, f"{len(both)} instances in training and evaluation against the plan: {_some(both)}")


def _some(names: list[str]) -> str:
    rest = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{rest}"

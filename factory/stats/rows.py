"""Reads the rows for the statistics and records which rows are omitted and why. Computes nothing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import pyarrow as pa
from pydantic import ValidationError

from coordinator.expansion.cells import planned_cells
from factory.dataset.columns import read_table
from factory.dataset.reader import Dataset
from factory.stats.statistics import Remark
from schemas.base import Model
from schemas.dataset.meta import DatasetMeta
from schemas.dataset.rows import EpisodeSummary, FailedAttempt
from schemas.storage.dataset_files import ATTEMPTS_FILE, EPISODES, META_FILE, METADATA_FILE
from schemas.storage.episode_list import list_episodes
from schemas.storage.place import FilePlace, Place
from schemas.support.foreign import PARSER_ERRORS
from schemas.terms import Split

MOST_OPENED = 2000
"""Maximum number of episodes opened for frames, tracks and actions; statistics tables use the rows of all episodes."""
_ROWS_AT_A_TIME = 2000
_NAMED = 3
"""Maximum number of examples in a remark."""
Row = TypeVar("Row", bound=Model)


@dataclass
class Rows:
    """Rows read from a dataset, and remarks about omitted rows."""

    meta: DatasetMeta
    episodes: list[EpisodeSummary] = field(default_factory=list)
    failures: list[FailedAttempt] | None = None
    """Failed attempts; `None` when the table of attempts cannot be read."""
    remarks: list[Remark] = field(default_factory=list)

    def add_remark(self, file: str, text: str) -> None:
        """Adds a remark about unfinished or missing data, which is not damage."""
        self.remarks.append(Remark(is_damage=False, file=file, text=text))

    def add_damage(self, file: str, text: str) -> None:
        self.remarks.append(Remark(is_damage=True, file=file, text=text))


def read_rows(root: Place) -> Rows:
    """Reads the tables of a dataset; omits damaged rows and rows without an episode file, each with a remark.

    Raises:
        WorldError: The dataset does not exist, or its format is newer than this software.
        ArchiveCorrupt: `dataset_meta.json` or the table of episodes cannot be read.
    """
    dataset = Dataset(root)
    rows = Rows(dataset.meta)
    rows.episodes = _without_duplicates(rows, _parse(rows, METADATA_FILE, dataset.rows(), EpisodeSummary))
    rows.episodes = _with_files(rows, root)
    rows.failures = _read_failures(rows, root / ATTEMPTS_FILE)
    _compare_with_meta(rows, len(dataset))
    _compare_with_plan(rows)
    _compare_with_shared_instances(rows)
    return rows


def _parse(rows: Rows, file: str, values_of_rows: Iterable[dict[str, Any]], model: type[Row]) -> list[Row]:
    parsed: list[Row] = []
    wrong: list[str] = []
    number = 0
    for number, values in enumerate(values_of_rows, 1):
        try:
            parsed.append(model.model_validate(values))
        except ValidationError as error:
            wrong.append(_describe_invalid_row(number, values, error))
    if wrong:
        rows.add_damage(file, f"{len(wrong)} of {number} rows skipped: {_some(wrong)}")
    return parsed


def _values(table: pa.Table) -> Iterator[dict[str, Any]]:
    for batch in table.to_batches(max_chunksize=_ROWS_AT_A_TIME):
        yield from batch.to_pylist()


def _describe_invalid_row(number: int, values: dict[str, Any], error: ValidationError) -> str:
    columns = sorted({str(item["loc"][0]) for item in error.errors() if item["loc"]})
    return f"row {number} ({values.get('episode_id')}) has wrong values in {', '.join(columns)}"


def _without_duplicates(rows: Rows, episodes: list[EpisodeSummary]) -> list[EpisodeSummary]:
    first: dict[str, EpisodeSummary] = {}
    duplicates = [row.episode_id for row in episodes if first.setdefault(row.episode_id, row) is not row]
    if duplicates:
        rows.add_damage(METADATA_FILE, f"{len(duplicates)} duplicate rows skipped: {_some(duplicates)}")
    return list(first.values())


def _with_files(rows: Rows, root: Place) -> list[EpisodeSummary]:
    summaries = list_episodes(root).episodes
    if rows.episodes and not summaries and not (root / EPISODES).is_dir():
        rows.add_remark(EPISODES, "does not exist; the statistics use the tables only")
        return rows.episodes
    sizes = {row.episode_id: _size_of(summaries.get(row.index)) for row in rows.episodes}
    missing = [name for name, size in sizes.items() if size is None]
    cut = [
        f"{row.episode_id} ({sizes[row.episode_id]} bytes instead of {row.file_bytes})"
        for row in rows.episodes
        if sizes[row.episode_id] not in (None, row.file_bytes)
    ]
    if missing:
        rows.add_damage(EPISODES, f"{len(missing)} episodes skipped, because the file is missing: {_some(missing)}")
    if cut:
        rows.add_damage(EPISODES, f"{len(cut)} episodes skipped, because the file size is wrong: {_some(cut)}")
    return [row for row in rows.episodes if sizes[row.episode_id] == row.file_bytes]


def _size_of(place: FilePlace | None) -> int | None:
    try:
        return None if place is None else place.stat().st_size
    except OSError:
        return None


def _read_failures(rows: Rows, path: Place) -> list[FailedAttempt] | None:
    try:
        table = read_table(path, list(FailedAttempt.model_fields))
    except FileNotFoundError:
        rows.add_damage(ATTEMPTS_FILE, "is missing; attempts are not counted; resume the run to rewrite it")
    except (pa.ArrowException, *PARSER_ERRORS) as error:
        rows.add_damage(
            ATTEMPTS_FILE, f"cannot be read ({error}); attempts are not counted; resume the run to rewrite it"
        )
    else:
        if table.num_rows != rows.meta.failed_attempts:
            failed = rows.meta.failed_attempts
            rows.add_damage(ATTEMPTS_FILE, f"has {table.num_rows} rows, but {META_FILE} has {failed} failed attempts")
        return _parse(rows, ATTEMPTS_FILE, _values(table), FailedAttempt)
    return None


def _compare_with_meta(rows: Rows, table_rows: int) -> None:
    meta = rows.meta
    if table_rows != meta.episodes:
        rows.add_damage(METADATA_FILE, f"has {table_rows} rows, but {META_FILE} has {meta.episodes} episodes")
    if not meta.complete:
        rows.add_remark(META_FILE, f"the run is not finished: {meta.episodes} of {meta.planned} planned episodes")
    if not rows.episodes:
        rows.add_remark(METADATA_FILE, "no episodes, so no means can be computed")


def _compare_with_plan(rows: Rows) -> None:
    """Adds a remark about cells above their quota and, if the run is complete, also about cells below it."""
    counts = Counter((row.scene, row.split, row.spawn_tier) for row in rows.episodes)
    wanted = planned_cells(rows.meta.plans)
    wrong = [
        f"{' / '.join(key)} has {counts[key]} of {wanted.get(key, 0)} episodes"
        for key in sorted(counts.keys() | wanted.keys())
        if counts[key] > wanted.get(key, 0) or (rows.meta.complete and counts[key] < wanted.get(key, 0))
    ]
    if wrong:
        rows.add_damage(METADATA_FILE, f"{len(wrong)} cells differ from the plan: {_some(wrong)}")


def _compare_with_shared_instances(rows: Rows) -> None:
    """Adds remarks about instances that training and evaluation share.

    Categories with too few instances to separate training from evaluation are not damage; other shared instances are.
    """
    shared = rows.meta.shared_instances
    if shared is None:
        return
    for scene, categories in shared.items():
        if categories:
            text = f"{scene} has too few instances of {', '.join(categories)} to separate training from evaluation"
            rows.add_remark(META_FILE, text)
    train: set[tuple[str, str]] = set()
    evaluation: set[tuple[str, str]] = set()
    for row in rows.episodes:
        if row.target_category not in shared.get(row.scene, ()):
            (train if row.split is Split.TRAIN_ID else evaluation).add((row.scene, row.target_id))
    both = [" ".join(key) for key in sorted(train & evaluation)]
    if both:
        rows.add_damage(
            METADATA_FILE, f"{len(both)} instances are in training and evaluation, contrary to the plan: {_some(both)}"
        )


def _some(names: list[str]) -> str:
    rest = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{', '.join(names[:_NAMED])}{rest}"


def spread_evenly(episodes: Sequence[EpisodeSummary], count: int) -> list[EpisodeSummary]:
    """Returns all episodes, or `count` of them evenly spaced from the first to the last."""
    if len(episodes) <= count:
        return list(episodes)
    return [episodes[place * (len(episodes) - 1) // max(count - 1, 1)] for place in range(count)]


def format_error(error: Exception, root: Place) -> str:
    """Returns an error message on one line with paths relative to the dataset, so pages are reproducible."""
    return " ".join(str(error).replace(f"{root}/", "").split())

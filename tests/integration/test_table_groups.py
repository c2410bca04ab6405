"""Tables in row groups: copying unchanged groups of the previous table gives the same bytes as writing a new table."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from functools import cache
from io import BytesIO
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from coordinator.archive.opening import open_archive
from coordinator.tables import row_groups
from coordinator.tables.row_groups import GROUP_ROWS, ListedRows, RowGroupWriter
from coordinator.tables.write import DatasetTables, TableChanges, TableContent
from schemas.base import Model
from schemas.dataset.rows import EpisodeSummary, FailedAttempt, summary_of
from tests.builders.bundle import parts_for
from tests.builders.dataset import failure
from tests.builders.ledger import room_plan

NOW = datetime(2026, 1, 2, tzinfo=UTC)
PLAN = room_plan(3 * GROUP_ROWS)
FILES = ("metadata.parquet", "attempts.parquet", "README.md", "dataset_meta.json")


class Watched(ListedRows):
    """Rows that count how many of them are read."""

    read = 0

    def rows(self, first: int, last: int) -> Iterable[Model]:
        found = list(super().rows(first, last))
        self.read += len(found)
        return found


class Run:
    """Tables of one directory, written by one process."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._tables = DatasetTables()

    def write(
        self,
        found: list[EpisodeSummary],
        changed: Iterable[int] | None = None,
        failures: list[FailedAttempt] | None = None,
        failed: Iterable[int] = (),
    ) -> int:
        """Writes the tables; returns the number of rows that were read."""
        episodes, attempts = Watched(found), Watched(failures or [])
        changes = None if changed is None else TableChanges(set(changed), set(failed))
        with open_archive(self.root) as archive:
            self._tables.write(archive, TableContent(PLAN, {}, episodes, attempts), NOW, changes)
        return episodes.read + attempts.read

    def read(self) -> dict[str, bytes]:
        return {name: (self.root / name).read_bytes() for name in FILES}


@cache
def one_summary() -> EpisodeSummary:
    return summary_of(parts_for().meta, "0" * 64, 1000)


def rows(numbers: Iterable[int], salt: int = 0) -> list[EpisodeSummary]:
    return [
        one_summary().model_copy(
            update={
                "index": index,
                "episode_id": f"ep_{index:06d}",
                "file_sha256": f"{index + salt:064x}",
                "content_digest": f"{index + salt:032x}",
                "trajectory_length_m": 0.1 * (index + salt),
            }
        )
        for index in numbers
    ]


FIRST = range(1, GROUP_ROWS + 1)
STEPS: dict[str, Callable[[], tuple[list[EpisodeSummary], Iterable[int]]]] = {
    "the next ones": lambda: (rows(range(1, GROUP_ROWS + 51)), range(GROUP_ROWS + 1, GROUP_ROWS + 51)),
    "gaps": lambda: (rows([*FIRST[:99], *FIRST[199:], GROUP_ROWS * 2 + 5]), [*range(100, 200), GROUP_ROWS * 2 + 5]),
    "one lost": lambda: (rows([*range(1, 41), *range(42, GROUP_ROWS + 1)]), [41]),
    "one made again": lambda: (rows(range(1, 41)) + rows([41], salt=10**6) + rows(range(42, GROUP_ROWS + 1)), [41]),
    "none left": lambda: ([], FIRST),
    "all": lambda: (rows(range(1, 3 * GROUP_ROWS + 1)), range(GROUP_ROWS + 1, 3 * GROUP_ROWS + 1)),
    "nothing": lambda: (rows(FIRST), ()),
}


@pytest.mark.parametrize("step", list(STEPS))
def test_an_updated_table_has_the_bytes_of_a_new_one(tmp_path, step):
    found, changed = STEPS[step]()
    old, new = Run(tmp_path / "old"), Run(tmp_path / "new")
    old.write(rows(FIRST))
    old.write(found, changed)
    new.write(found)
    assert old.read() == new.read()


def test_a_group_is_copied_to_another_place_when_an_earlier_group_changes(tmp_path):
    found = rows(range(1, 2 * GROUP_ROWS + 1))
    old, new = Run(tmp_path / "old"), Run(tmp_path / "new")
    old.write(found)
    assert old.write(found[5:], range(1, 6)) == GROUP_ROWS - 5
    new.write(found[5:])
    assert old.read() == new.read()


def test_only_changed_groups_are_read_from_the_ledger(tmp_path):
    run, found = Run(tmp_path), rows(range(1, 2 * GROUP_ROWS + 1))
    assert run.write(found) == 2 * GROUP_ROWS
    assert run.write(found, ()) == 0
    more = found + rows(range(2 * GROUP_ROWS + 1, 2 * GROUP_ROWS + 11))
    assert run.write(more, range(2 * GROUP_ROWS + 1, 2 * GROUP_ROWS + 11)) == 10
    assert run.write(more, ()) == 0
    assert run.write(more) == len(more)


def test_failed_attempts_are_read_for_the_changed_groups_only(tmp_path):
    failures = [failure(1), failure(GROUP_ROWS + 1)]
    old, new = Run(tmp_path / "old"), Run(tmp_path / "new")
    assert old.write([], failures=failures) == 2
    assert old.write([], (), [*failures, failure(GROUP_ROWS + 1, 2)], [GROUP_ROWS + 1]) == 2
    new.write([], failures=[*failures, failure(GROUP_ROWS + 1, 2)])
    assert old.read() == new.read()


@pytest.mark.parametrize(
    "harm",
    [
        Path.unlink,
        lambda path: path.write_bytes(b"PAR1 no table PAR1"),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(path.read_bytes().replace(b"office", b"ofFice")),
    ],
)
def test_all_rows_are_read_again_if_the_previous_table_is_missing_or_changed(tmp_path, harm):
    run, found = Run(tmp_path), rows(range(1, 31))
    run.write(found)
    whole = run.read()
    harm(tmp_path / "metadata.parquet")
    assert run.write(found, ()) == len(found)
    assert run.read() == whole


def test_the_first_write_of_a_process_copies_nothing(tmp_path):
    found = rows(range(1, 31))
    Run(tmp_path).write(found)
    assert Run(tmp_path).write(found, ()) == len(found)


def test_a_table_of_row_groups_has_the_bytes_that_one_parquet_writer_writes(tmp_path):
    Run(tmp_path).write(rows(range(1, 2 * GROUP_ROWS + 1)))
    path = tmp_path / "metadata.parquet"
    with pq.ParquetFile(path) as file, pq.ParquetWriter(tmp_path / "one", file.schema_arrow, compression="zstd") as one:
        for group in range(file.num_row_groups):
            one.write_table(file.read_row_group(group).cast(file.schema_arrow))
    assert (tmp_path / "one").read_bytes() == path.read_bytes()


def test_a_table_of_no_rows_can_be_read(tmp_path):
    Run(tmp_path).write([])
    table = pq.read_table(tmp_path / "metadata.parquet")
    file = BytesIO()
    RowGroupWriter(file, table.schema).close()
    assert (table.num_rows, pq.read_table(file).schema) == (0, table.schema)


def test_a_group_contains_a_range_of_plan_indices():
    assert row_groups.GROUP_ROWS == 2000  # changing it changes the bytes of every dataset

"""`metadata.parquet` in row groups: reusing groups of the former table gives the bytes of a new table."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

import pytest

from coordinator.archive.opening import open_archive
from coordinator.tables import metadata_table
from coordinator.tables.metadata_table import GROUP_ROWS, ListedEpisodes
from coordinator.tables.write import write_tables
from schemas.dataset import EpisodeSummary, summary_of
from tests.builders.bundle import parts_for
from tests.builders.ledger import room_plan

NOW = datetime(2026, 1, 2, tzinfo=UTC)
PLAN = room_plan(3 * GROUP_ROWS)
FILES = ("metadata.parquet", "attempts.parquet", "README.md", "dataset_meta.json")


class Watched(ListedEpisodes):
    """Counts the requested rows."""

    asked = 0

    def rows(self, first: int, last: int) -> Iterable[EpisodeSummary]:
        found = list(super().rows(first, last))
        self.asked += len(found)
        return found


def rows(numbers: Iterable[int], salt: int = 0) -> list[EpisodeSummary]:
    summary = summary_of(parts_for().meta, "0" * 64, 1000)
    return [
        summary.model_copy(
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


def write(root: Path, found: list[EpisodeSummary], *, anew: bool) -> int:
    """Writes the tables; returns the number of rows read from the ledger."""
    episodes = Watched(found)
    with open_archive(root) as archive:
        write_tables(archive, PLAN, {}, episodes, [], NOW, anew=anew)
    return episodes.asked


def read(root: Path) -> dict[str, bytes]:
    return {name: (root / name).read_bytes() for name in FILES}


STEPS = {
    "the next ones": rows(range(1, GROUP_ROWS + 51)),
    "gaps": rows([*range(1, 100), *range(200, GROUP_ROWS + 20), GROUP_ROWS * 2 + 5]),
    "one lost": rows([*range(1, 41), *range(42, GROUP_ROWS + 1)]),
    "one made again": rows(range(1, 41)) + rows([41], salt=10**6) + rows(range(42, GROUP_ROWS + 1)),
    "none left": [],
    "all": rows(range(1, 3 * GROUP_ROWS + 1)),
}


@pytest.mark.parametrize("step", list(STEPS))
def test_an_updated_table_has_the_bytes_of_a_new_one(tmp_path, step):
    (tmp_path / "new").mkdir()
    write(tmp_path / "old", rows(range(1, GROUP_ROWS + 1)), anew=True)
    write(tmp_path / "old", STEPS[step], anew=False)
    write(tmp_path / "new", STEPS[step], anew=True)
    assert read(tmp_path / "old") == read(tmp_path / "new")


def test_only_changed_groups_are_read_from_the_ledger(tmp_path):
    found = rows(range(1, 2 * GROUP_ROWS + 1))
    assert write(tmp_path, found, anew=True) == 2 * GROUP_ROWS
    assert write(tmp_path, found, anew=False) == 0
    more = found + rows(range(2 * GROUP_ROWS + 1, 2 * GROUP_ROWS + 11))
    assert write(tmp_path, more, anew=False) == 10
    assert write(tmp_path, more, anew=True) == len(more)


@pytest.mark.parametrize("harm", [Path.unlink, lambda path: path.write_bytes(b"PAR1 no table PAR1"), Path.touch])
def test_a_missing_or_damaged_former_table_is_rewritten(tmp_path, harm):
    found = rows(range(1, 31))
    write(tmp_path, found, anew=True)
    whole = read(tmp_path)
    harm(tmp_path / "metadata.parquet")
    write(tmp_path, found, anew=False)
    assert read(tmp_path) == whole


def test_a_group_contains_a_range_of_plan_indices():
    assert metadata_table.GROUP_ROWS == 2000  # changing it changes the bytes of every dataset

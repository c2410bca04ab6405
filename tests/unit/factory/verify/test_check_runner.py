"""How many processes check the episodes of a dataset."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from factory.dataset.reader import Dataset
from factory.verify.dataset import run_checks, useful_processes
from factory.verify.episode import EpisodeCheck
from schemas.dataset.rows import EpisodeSummary
from tests.builders.dataset import make_dataset

MB = 10**6


@pytest.fixture(scope="module")
def row(tmp_path_factory: pytest.TempPathFactory) -> EpisodeSummary:
    """Metadata row of an episode that has frames."""
    root = tmp_path_factory.mktemp("one") / "data"
    make_dataset(root, 1)
    return EpisodeSummary.model_validate(next(Dataset(root).rows()))


def checks(
    row: EpisodeSummary, count: int, size: int, *, deep: bool = True, render: bool = False
) -> list[EpisodeCheck]:
    sized = row.model_copy(update={"file_bytes": size})
    return [EpisodeCheck(Path(), sized, (), deep, render)] * count


def test_episodes_that_are_checked_within_seconds_need_no_process(row: EpisodeSummary) -> None:
    assert useful_processes(checks(row, 5, 16 * MB), cores=8) == 1
    assert useful_processes(checks(row, 100, 30_000), cores=8) == 1
    assert useful_processes([], cores=8) == 1


def test_many_episodes_of_frames_use_every_core(row: EpisodeSummary) -> None:
    assert useful_processes(checks(row, 4, 130 * MB), cores=8) == 3
    assert useful_processes(checks(row, 1174, 130 * MB), cores=8) == 8


def test_many_episodes_of_states_use_every_core(row: EpisodeSummary) -> None:
    assert useful_processes(checks(row, 2000, 30_000), cores=8) == 8


def test_rendered_episodes_use_one_process_each_up_to_the_number_of_cores(row: EpisodeSummary) -> None:
    assert useful_processes(checks(row, 3, 30_000, deep=False, render=True), cores=8) == 3
    assert useful_processes(checks(row, 20, 30_000, deep=False, render=True), cores=8) == 8


def test_results_have_the_order_of_the_checks_for_any_number_of_processes(tmp_path: Path) -> None:
    make_dataset(tmp_path / "data", 3)
    (tmp_path / "data" / "episodes" / "ep_000002.zip").unlink()
    rows = [EpisodeSummary.model_validate(row) for row in Dataset(tmp_path / "data").rows()]
    asked = [EpisodeCheck(tmp_path / "data", row, (), deep=True) for row in rows]
    found = {processes: [*run_checks(iter(asked), processes)] for processes in (None, 1, 2)}
    plain = {
        count: [[dataclasses.astuple(one) for one in each.findings] for each in results]
        for count, results in found.items()
    }
    assert plain[None] == plain[1] == plain[2]
    assert [[file for _, file, _ in each] for each in plain[1]] == [[], ["episodes/ep_000002.zip"], []]

"""A new run gets its tables with its first episode, so it can be read before the first regular checkpoint."""

from __future__ import annotations

from pathlib import Path

from coordinator.options import CoordinatorOptions
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.dataset.reader import Dataset
from schemas.dataset.meta import read_dataset_meta
from schemas.errors import WorldError
from schemas.terms import FailReason
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.shared_validator import SharedValidator
from tests.builders.wire_worker import WireWorker, bundle_for, until

EPISODES = 3
SETTINGS = CoordinatorSettings(reserve_bytes=0, retry_after_s=0.1, pullers=1, checkpoint_s=3600.0)


def opened(folder: Path, checker: SharedValidator) -> Coordinator:
    options = CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=SETTINGS, checker=checker)
    return Coordinator(folder / "out", room_plan(EPISODES), room_catalog(folder), options)


def deliver_one(coordinator: Coordinator) -> None:
    archived = coordinator.progress().jobs.get("archived", 0)
    with WireWorker(coordinator.endpoints, coordinator.run) as worker:
        job, lease = worker.job()
        assert worker.deliver(lease, bundle_for(job))
        until(lambda: coordinator.progress().jobs.get("archived", 0) == archived + 1)


def number_in_tables(folder: Path) -> int:
    try:
        return read_dataset_meta(folder / "out").episodes
    except WorldError:
        return 0


def failures_in_tables(folder: Path) -> int:
    return read_dataset_meta(folder / "out").failed_attempts


def test_the_first_tables_are_written_after_the_first_episode_and_later_tables_at_the_interval(tmp_path, checker):
    with opened(tmp_path, checker) as coordinator:
        assert number_in_tables(tmp_path) == 0
        deliver_one(coordinator)
        until(lambda: number_in_tables(tmp_path) == 1)
        assert len(Dataset(tmp_path / "out")) == 1
        deliver_one(coordinator)
        coordinator._tables.write_first()
        assert number_in_tables(tmp_path) == 1
    assert number_in_tables(tmp_path) == 2  # written at the end of the run


def test_failed_attempts_after_the_last_episode_are_in_the_tables(tmp_path, checker):
    with opened(tmp_path, checker) as coordinator:
        deliver_one(coordinator)
        until(lambda: number_in_tables(tmp_path) == 1)
        with WireWorker(coordinator.endpoints, coordinator.run) as worker:
            assert worker.fail(worker.job()[1], FailReason.TIMEOUT)
    assert failures_in_tables(tmp_path) == 1
    with opened(tmp_path, checker) as coordinator, WireWorker(coordinator.endpoints, coordinator.run) as worker:
        assert worker.fail(worker.job()[1], FailReason.TIMEOUT)
    assert failures_in_tables(tmp_path) == 2


def test_a_resumed_run_keeps_its_tables_until_the_interval_has_passed(tmp_path, checker):
    with opened(tmp_path, checker) as coordinator:
        deliver_one(coordinator)
    with opened(tmp_path, checker) as coordinator:
        deliver_one(coordinator)
        coordinator._tables.write_first()
        assert number_in_tables(tmp_path) == 1
    assert number_in_tables(tmp_path) == 2

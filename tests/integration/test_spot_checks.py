"""Workers that announce invalid bundles as validated are barred, and their accepted episodes are checked."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import select
from structlog.testing import capture_logs

from coordinator.ledger.database.engine import open_reader
from coordinator.ledger.opening import ledger_url_of
from coordinator.ledger.tables import unchecked_episodes
from coordinator.options import CoordinatorOptions
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from coordinator.validation.messages import Scope
from coordinator.validation.validator import Validator
from factory.dataset.reader import Dataset
from schemas.errors import InvalidBundle
from schemas.job import Job
from schemas.protocol.messages import HelloReply
from schemas.support.product import product_version
from tests.builders.bundle import job_for, parts_for
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.wire_worker import WireWorker, bundle_for, until

EPISODES = 3


def forged_for(job: Job) -> bytes:
    """Returns a bundle with an unknown instance ID in one frame; all digests agree with the frames."""
    parts = parts_for(job)
    rgb, depth, ids = parts.frames[5]
    wrong = ids.copy()
    wrong[400:405] = np.uint16(77)
    return parts.with_frame(5, (rgb, depth, wrong)).write()


@contextmanager
def started(root: Path, share: float | None) -> Iterator[Coordinator]:
    settings = CoordinatorSettings(lease_ttl_s=30.0, retry_after_s=0.1, reserve_bytes=0, spot_checks=share)
    options = CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=settings)
    with Coordinator(root / "out", room_plan(EPISODES), room_catalog(root), options) as coordinator:
        yield coordinator


def archived(coordinator: Coordinator) -> int:
    return coordinator.progress().jobs.get("archived", 0)


def unchecked(root: Path) -> list[int]:
    engine = open_reader(ledger_url_of(root / "out"))
    try:
        with engine.connect() as connection:
            return list(connection.execute(select(unchecked_episodes.c.idx)).scalars())
    finally:
        engine.dispose()


def test_a_host_that_falsely_announces_a_validation_is_barred_and_its_invalid_episodes_are_generated_again(
    tmp_path: Path,
) -> None:
    with (
        started(tmp_path, 0.0) as coordinator,
        WireWorker(coordinator.endpoints, coordinator.run, "false-peer") as false_peer,
    ):
        hello = false_peer.hello(product_version())
        assert isinstance(hello, HelloReply)
        assert hello.validates
        for number, make in enumerate((bundle_for, forged_for), 1):
            job, lease = false_peer.job()
            assert false_peer.deliver(lease, make(job), is_validated=True)
            until(lambda number=number: archived(coordinator) == number)  # type: ignore[misc]
        accepted = unchecked(tmp_path)
        assert len(accepted) == 1  # the first bundle of a host is always validated completely
    with (
        started(tmp_path, 0.0) as coordinator,
        WireWorker(coordinator.endpoints, coordinator.run, "false-peer") as false_peer,
        WireWorker(coordinator.endpoints, coordinator.run, "honest") as honest,
    ):
        assert unchecked(tmp_path) == accepted
        job, lease = false_peer.job()
        assert false_peer.deliver(lease, forged_for(job), is_validated=True)
        until(lambda: archived(coordinator) == 1 and unchecked(tmp_path) == [])
        (barred,) = coordinator.progress().hosts
        assert barred.host == "false-peer"
        assert barred.barred_at is not None
        assert "announced as valid" in barred.reason
        for _ in range(2):
            job, lease = honest.job()
            assert honest.deliver(lease, bundle_for(job))
        assert coordinator.wait(60)
    reasons = sorted((tmp_path / "out" / "quarantine").glob("*.reason.txt"))
    assert len(reasons) == 1
    assert "its worker announced it as valid" in reasons[0].read_text()
    with Validator() as validator:
        episodes = Dataset(tmp_path / "out")
        assert len(episodes) == EPISODES
        for episode in episodes:
            validator.check(tmp_path / "out" / "episodes" / f"{episode.episode_id}.zip", episode.meta.job)


def test_without_spot_checks_workers_do_not_validate_and_announced_validations_are_ignored(tmp_path: Path) -> None:
    with (
        capture_logs() as lines,
        started(tmp_path, None) as coordinator,
        WireWorker(coordinator.endpoints, coordinator.run, "false-peer") as false_peer,
    ):
        for _ in range(2):
            hello = false_peer.hello(product_version())
            assert isinstance(hello, HelloReply)
            assert not hello.validates
        until(lambda: any(line["event"] == "worker_joined" for line in lines))
        joined = [(line["host"], line["worker"], line["cores"]) for line in lines if line["event"] == "worker_joined"]
        assert joined == [("false-peer", false_peer.sid, 2)]
        for make in (bundle_for, forged_for):
            job, lease = false_peer.job()
            assert false_peer.deliver(lease, make(job), is_validated=True)
        # the two bundles finish in any order
        until(lambda: archived(coordinator) == 1 and bool(coordinator.progress().hosts))
        assert unchecked(tmp_path) == []


def test_the_forged_bundle_passes_the_reduced_validation_and_fails_the_complete_one(tmp_path: Path) -> None:
    path = tmp_path / "ep_000001.zip"
    path.write_bytes(forged_for(job_for()))
    with Validator() as validator:
        assert validator.check(path, job_for(), scope=Scope.CLAIM).num_steps == 12
        with pytest.raises(InvalidBundle, match="frame 5"):
            validator.check(path, job_for())
        with pytest.raises(InvalidBundle, match=r"job\.index"):
            validator.check(path, job_for(2), scope=Scope.CLAIM)

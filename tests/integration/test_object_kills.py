"""Kills a coordinator at every step between the put of an object and the commit of the ledger, and restarts it."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from sqlalchemy import func, select

from coordinator.ledger.reading.audit import ledger_trouble
from coordinator.ledger.reading.reader import open_ledger
from coordinator.ledger.states import Event
from coordinator.ledger.tables import events
from coordinator.options import CoordinatorOptions
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from coordinator.tables.split_tables import find_faults
from factory.dataset.reader import Dataset
from schemas.protocol.address_file import read_address
from schemas.storage.object_path import ObjectPath
from schemas.storage.place import Place, children
from schemas.support.child import python_module
from schemas.terms import Recording
from tests.builders.fake_coordinator import free_endpoint
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.object_server import ObjectServer
from tests.builders.store_relay import Moment, StoreRelay
from tests.builders.wire_worker import WireWorker, bundle_for, until

EPISODES = 2
RUN = room_plan(EPISODES, crashes=20)
"""The plan that `tests.builders.room_coordinator` uses."""
LEASE_S = 60.0
SETTINGS = CoordinatorSettings(reserve_bytes=0, retry_after_s=0.1, pullers=1, pull_timeout_s=1.0, lease_ttl_s=3.0)
EPISODE, TABLE, META = ".zip", "metadata.parquet", "dataset_meta.json"


@dataclass(frozen=True)
class Step:
    """Moment of the kill: a stage of the first request with this method and key.

    Requests before the put of the first episode are ignored.
    """

    moment: Moment
    method: str
    key: str
    is_kept: bool
    """Whether the first episode is in the bucket at the moment of the kill."""

    def __str__(self) -> str:
        return f"{self.method} {self.key} {self.moment}"


STEPS = [
    Step(Moment.STARTED, "PUT", EPISODE, is_kept=False),
    Step(Moment.PASSED_ON, "PUT", EPISODE, is_kept=True),
    Step(Moment.ANSWERED, "PUT", EPISODE, is_kept=True),
    Step(Moment.PASSED_ON, "HEAD", EPISODE, is_kept=True),
    Step(Moment.ANSWERED, "HEAD", EPISODE, is_kept=True),
    Step(Moment.STARTED, "PUT", TABLE, is_kept=True),
    Step(Moment.PASSED_ON, "PUT", TABLE, is_kept=True),
    Step(Moment.STARTED, "PUT", META, is_kept=True),
    Step(Moment.PASSED_ON, "PUT", META, is_kept=True),
]


class Killer:
    """Kills a process at a step and waits for its exit before the request continues."""

    def __init__(self, step: Step, process: subprocess.Popen[bytes]) -> None:
        self._step, self._process = step, process
        self._is_under_way = False

    def __call__(self, moment: Moment, method: str, path: str) -> bool:
        key = path.partition("?")[0]
        self._is_under_way = self._is_under_way or (method == "PUT" and key.endswith(EPISODE) and "/episodes/" in key)
        step = self._step
        if self._is_under_way and (moment, method) == (step.moment, step.method) and key.endswith(step.key):
            self._process.kill()
            self._process.wait()
        return self._process.poll() is not None


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Dataset directory of the same run without kills and without object storage."""
    folder = tmp_path_factory.mktemp("reference")
    with (
        Coordinator(
            folder / "out",
            RUN,
            room_catalog(folder),
            CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=SETTINGS),
        ) as running,
        WireWorker(running.endpoints, running.run) as worker,
    ):
        finish(running, worker)
    return folder / "out"


@contextmanager
def coordinator(root: Path, endpoint: str, store: ObjectPath) -> Iterator[subprocess.Popen[bytes]]:
    """Runs a coordinator in a separate process; yields the process once it listens."""
    words = (root, EPISODES, endpoint, LEASE_S, 0.1, 20, Recording.FRAMES, store)
    command = python_module("tests.builders.room_coordinator", *map(str, words))
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        until(lambda: read_address(root / "out") is not None, 60)
        yield process
    finally:
        process.kill()
        process.wait()


def finish(running: Coordinator, worker: WireWorker) -> None:
    """Claims jobs, delivers bundles and sends heartbeats until the run is finished."""

    def is_finished() -> bool:
        reply = worker.claim()
        if reply.job is not None and reply.lease is not None:
            worker.deliver(reply.lease, bundle_for(reply.job))
        worker.beat()
        return running.is_finished()

    until(is_finished, 60)


def episodes(root: Place) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in children(root / "episodes")}


@pytest.mark.slow
@pytest.mark.parametrize("step", STEPS, ids=str)
def test_a_coordinator_killed_between_put_and_commit_neither_loses_nor_repeats_an_episode(
    step: Step,
    store: ObjectPath,
    relay: StoreRelay,
    object_store: ObjectServer,
    reference: Path,
    tmp_path: Path,
) -> None:
    endpoint = free_endpoint()
    with coordinator(tmp_path, endpoint, store) as process, WireWorker((endpoint,), RUN.run) as worker:
        relay.watch = Killer(step, process)
        job, lease = worker.job()
        assert worker.deliver(lease, bundle_for(job))
        process.wait(60)
    relay.watch = lambda _moment, _method, _path: False
    wanted, kept = episodes(reference), episodes(store)
    assert kept.items() <= wanted.items()
    assert len(kept) == step.is_kept
    home = tmp_path / "out"
    with (
        Coordinator(
            home, RUN, room_catalog(tmp_path), CoordinatorOptions(listen=(endpoint,), settings=SETTINGS, store=store)
        ) as running,
        WireWorker(running.endpoints, running.run) as worker,
    ):
        assert list((home / ".staging").iterdir()) == []
        assert running.progress().jobs["archived"] == len(kept)
        finish(running, worker)
        with open_ledger(f"sqlite:///{home / 'ledger.db'}") as ledger:
            ends = events.c.event.in_((Event.ARCHIVED, Event.ADOPTED))
            counts = select(func.count()).where(ends).group_by(events.c.job_id)
            assert ledger.execute(counts).scalars().all() == [1] * EPISODES
    assert episodes(store) == wanted
    assert Dataset(store).digest == Dataset(reference).digest
    assert Dataset(store).meta.complete
    assert list(find_faults(store, deep=True)) == []
    assert list((store / "quarantine").walk()) == []
    assert "Uploads" not in object_store.client.list_multipart_uploads(Bucket=store.objects.url.split("/")[2])
    assert ledger_trouble(f"sqlite:///{home / 'ledger.db'}", room_catalog(tmp_path)) == ""

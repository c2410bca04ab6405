"""Gateways between workers and a coordinator, over zenoh on loopback with real directories, ledger and validator."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path

import pytest
from sqlalchemy import select

from coordinator.gateway.gather import GatherReport, gather
from coordinator.gateway.service import Gateway
from coordinator.ledger.archived import gateways_by_episode
from coordinator.ledger.reading.reader import open_ledger
from coordinator.ledger.tables import events
from coordinator.options import CoordinatorOptions
from coordinator.recovery.repair_dataset import RepairInput
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from schemas.errors import UsageError, WorldError
from schemas.job import Job
from schemas.protocol.administration import AdminAction, AdminRequest
from schemas.terms import FailReason
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.ports import free_endpoint
from tests.builders.shared_validator import SharedValidator
from tests.builders.wire_worker import WireWorker, bundle_for, until

ANY_PORT = ("tcp/127.0.0.1:0",)
SETTINGS = CoordinatorSettings(
    reserve_bytes=0, retry_after_s=0.1, pullers=1, pull_timeout_s=1.0, lease_ttl_s=60.0, transport_lease_s=2.0
)
EPISODES = 3


class Site:
    """A coordinator, gateways and workers; each of them can be closed and opened again."""

    def __init__(self, folder: Path, checker: SharedValidator, stack: ExitStack) -> None:
        self.folder, self.checker, self._stack = folder, checker, stack
        self.endpoint = free_endpoint()
        self.core = self.open_core()

    @property
    def url(self) -> str:
        return f"sqlite:///{self.folder / 'out' / 'ledger.db'}"

    def open_core(self, settings: CoordinatorSettings = SETTINGS) -> Coordinator:
        plan, catalog = room_plan(EPISODES), room_catalog(self.folder)
        self.core = self._stack.enter_context(
            Coordinator(
                self.folder / "out",
                plan,
                catalog,
                CoordinatorOptions(listen=(self.endpoint,), settings=settings, checker=self.checker),
            )
        )
        return self.core

    def open_gateway(self, name: str, folder: str | None = None) -> Gateway:
        root = self.folder / (folder or name)
        return self._stack.enter_context(
            Gateway(root, name, (self.endpoint,), ANY_PORT, SETTINGS, checker=self.checker)
        )

    def open_worker(self, endpoints: tuple[str, ...]) -> WireWorker:
        return self._stack.enter_context(WireWorker(endpoints, self.core.run))

    def gather(self, *names: str, requeue_missing: bool = False) -> GatherReport:
        """Gathers the episodes of gateways as `factory gather` does; the coordinator must be closed."""
        out = self.folder / "out"
        repair_input = RepairInput(out, out, self.url, room_plan(EPISODES), room_catalog(self.folder), {})
        sources = [self.folder / name for name in names]
        return gather(repair_input, sources, datetime.now(UTC), requeue_missing=requeue_missing)

    def gateway_of_episodes(self) -> dict[int, str]:
        with open_ledger(self.url) as ledger:
            return dict(gateways_by_episode(ledger))

    def files(self, name: str) -> list[str]:
        return sorted(path.name for path in (self.folder / name / "episodes").iterdir())


@pytest.fixture
def site(tmp_path: Path, checker: SharedValidator) -> Iterator[Site]:
    with ExitStack() as stack:
        yield Site(tmp_path, checker, stack)


def deliver_jobs(worker: WireWorker, count: int = 1) -> list[Job]:
    """Claims and delivers `count` episodes; returns their jobs."""
    jobs = []
    for _ in range(count):
        job, lease = worker.job()
        assert worker.deliver(lease, bundle_for(job))
        jobs.append(job)
    return jobs


def name_of(job: Job) -> str:
    return f"{job.episode_id}.zip"


def deliver_and_record(worker: WireWorker, site: Site, count: int = 1) -> list[Job]:
    """Delivers episodes and waits until the ledger has recorded them."""
    before = site.core.progress().jobs["archived"]
    jobs = deliver_jobs(worker, count)
    until(lambda: site.core.progress().jobs["archived"] == before + count)
    return jobs


def test_bundles_delivered_through_a_gateway_are_archived_only_there(site):
    gateway = site.open_gateway("gw1")
    worker = site.open_worker(gateway.endpoints)
    deliver_and_record(worker, site, EPISODES)
    assert len(worker.beat().drop) == EPISODES
    assert worker.claim().finished
    assert site.files("out") == []
    assert site.files("gw1") == [f"ep_{index:06d}.zip" for index in range(1, EPISODES + 1)]
    assert site.core.progress().by_gateway == {"gw1": EPISODES}
    assert site.core.progress().attempts == {"success": EPISODES}
    assert gateway.is_alive()
    assert gateway.troubles() == ()


def test_a_gateway_learns_that_the_run_is_finished_and_that_jobs_are_queued_again(site):
    gateway = site.open_gateway("gw1")
    deliver_and_record(site.open_worker(gateway.endpoints), site, EPISODES - 1)
    assert not site.core.is_finished()
    assert not gateway.is_finished
    cancelled = site.core.administer(AdminRequest(action=AdminAction.CANCEL)).changed
    until(site.core.is_finished)
    until(lambda: gateway.is_finished)
    site.core.administer(AdminRequest(action=AdminAction.RETRY, indices=cancelled))
    assert not site.core.is_finished()
    until(lambda: not gateway.is_finished)


def test_workers_connected_to_the_coordinator_deliver_to_it(site):
    site.open_gateway("gw1")
    deliver_and_record(site.open_worker((site.endpoint,)), site)
    assert site.files("gw1") == []
    assert len(site.files("out")) == 1
    assert site.core.progress().by_gateway == {}


def test_a_gateway_refuses_a_bundle_of_another_job(site):
    worker = site.open_worker(site.open_gateway("gw1").endpoints)
    job, lease = worker.job()
    worker.deliver(lease, bundle_for(job.model_copy(update={"index": 9})))
    until(lambda: site.core.progress().attempts.get(FailReason.INVALID) == 1)
    assert site.files("gw1") == []


def test_a_gathered_dataset_is_whole_and_can_be_gathered_again(site):
    first, second = site.open_gateway("gw1"), site.open_gateway("gw2")
    (one,) = deliver_and_record(site.open_worker(first.endpoints), site)
    (two,) = deliver_and_record(site.open_worker(second.endpoints), site)
    (three,) = deliver_and_record(site.open_worker((site.endpoint,)), site)
    assert site.gateway_of_episodes() == {one.index: "gw1", two.index: "gw2"}
    site.core.close()
    some = site.gather("gw1")
    assert (some.gathered, [(gone.episode, gone.gateway) for gone in some.missing]) == (1, [(two.episode_id, "gw2")])
    report = site.gather("gw1", "gw2")
    assert (report.gathered, report.missing, report.episodes) == (1, (), EPISODES)
    assert site.gateway_of_episodes() == {}
    assert site.files("out") == sorted(map(name_of, (one, two, three)))
    assert site.gather("gw1", "gw2").gathered == 0
    assert site.open_core().progress().jobs["archived"] == EPISODES  # no episode counts as lost


def test_gather_refuses_unknown_files_and_requeues_missing_ones_on_request(site):
    gateway = site.open_gateway("gw1")
    (job,) = deliver_and_record(site.open_worker(gateway.endpoints), site)
    gateway.close()
    site.core.close()
    path = site.folder / "gw1" / "episodes" / name_of(job)
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    (missing,) = site.gather("gw1").missing
    assert "SHA-256" in missing.why
    assert site.files("out") == []
    assert site.gather("gw1", requeue_missing=True).requeued
    assert site.gateway_of_episodes() == {}
    again = site.open_core()
    assert (again.progress().jobs["archived"], again.progress().jobs["pending"]) == (0, EPISODES)


def test_a_gather_interrupted_before_the_ledger_commit_is_completed_at_the_next_start(site):
    gateway = site.open_gateway("gw1")
    (job,) = deliver_and_record(site.open_worker(gateway.endpoints), site)
    site.core.close()
    whole = (site.folder / "gw1" / "episodes" / name_of(job)).read_bytes()
    (site.folder / "out" / "episodes" / name_of(job)).write_bytes(whole)
    assert site.open_core().progress().by_gateway == {}
    assert site.files("out") == [name_of(job)]


def test_a_restarted_coordinator_does_not_requeue_episodes_of_gateways(site):
    deliver_and_record(site.open_worker(site.open_gateway("gw1").endpoints), site)
    site.core.close()
    progress = site.open_core().progress()
    assert (progress.jobs["archived"], progress.by_gateway) == (1, {"gw1": 1})


def test_a_restarted_gateway_reports_its_files_and_releases_missing_ones(site):
    gateway = site.open_gateway("gw1")
    worker = site.open_worker(gateway.endpoints)
    kept, gone = deliver_and_record(worker, site, 2)
    worker.close()
    gateway.close()
    (site.folder / "gw1" / "episodes" / name_of(gone)).unlink()
    (site.folder / "gw1" / "episodes" / "notes.txt").touch()
    again = site.open_gateway("gw1")
    assert site.core.progress().by_gateway == {"gw1": 1}
    assert site.files("gw1") == [name_of(kept)]
    deliver_and_record(site.open_worker(again.endpoints), site, 2)
    assert site.core.progress().by_gateway == {"gw1": EPISODES}


@pytest.mark.parametrize("lease", ["in force", "lost"])
def test_episodes_published_before_a_gateway_crash_are_adopted_while_the_job_is_open(site, lease):
    if lease == "lost":
        site.core.close()
        site.open_core(SETTINGS.model_copy(update={"lease_ttl_s": 4.0}))
    site.open_gateway("gw1").close()
    worker = site.open_worker((site.endpoint,))
    worker.is_frozen = True  # otherwise the coordinator would pull the bundle
    (job,) = deliver_jobs(worker)
    (bundle,) = (data for _, data in worker.spool.values())
    if lease == "lost":
        worker.close()
        until(lambda: site.core.progress().attempts.get("expired", 0) == 1)
    (site.folder / "gw1" / "episodes" / name_of(job)).write_bytes(bundle)
    site.open_gateway("gw1")
    progress = site.core.progress()
    assert (progress.jobs["archived"], progress.by_gateway) == (1, {"gw1": 1})
    assert progress.attempts["success"] == 1
    assert site.files("gw1") == [name_of(job)]


def test_a_gateway_quarantines_an_episode_that_another_process_archived(site):
    gateway = site.open_gateway("gw1")
    gateway.close()
    (job,) = deliver_and_record(site.open_worker((site.endpoint,)), site)
    (site.folder / "gw1" / "episodes" / name_of(job)).write_bytes(bundle_for(job))
    site.open_gateway("gw1")
    assert site.files("gw1") == []
    assert any(path.name.startswith(name_of(job)) for path in (site.folder / "gw1" / "quarantine").iterdir())
    assert site.core.progress().by_gateway == {}


def test_a_second_directory_under_the_name_of_a_gateway_is_refused(site):
    gateway = site.open_gateway("gw1")
    deliver_and_record(site.open_worker(gateway.endpoints), site)
    gateway.close()
    with pytest.raises(WorldError, match="the ledger has 1 episodes at gateway gw1"):
        site.open_gateway("gw1", "another")
    assert site.core.progress().by_gateway == {"gw1": 1}


def test_a_directory_of_another_gateway_is_refused(site):
    site.open_gateway("gw1").close()
    with pytest.raises(UsageError, match="belongs to"):
        site.open_gateway("gw2", "gw1")


def test_two_concurrent_pulls_of_one_bundle_end_with_one_owner(site):
    worker = site.open_worker(site.open_gateway("gw1").endpoints)
    for number in range(1, EPISODES + 1):
        deliver_jobs(worker)  # the gateway pulls the bundle
        worker.knows_router = False
        worker.beat()  # the coordinator pulls it too, as after a restart before gateways have reported
        worker.knows_router = True
        until(lambda: site.core.progress().jobs["archived"] == number)  # noqa: B023 - joined within the iteration
    worker.close()
    until(lambda: len(site.files("out")) + len(site.files("gw1")) == EPISODES)  # the loser removes its copy
    with open_ledger(site.url) as ledger:
        archived = [row.job_id for row in ledger.execute(select(events.c.job_id).where(events.c.event == "archived"))]
    assert len(archived) == len(set(archived)) == EPISODES
    assert site.core.progress().by_gateway.get("gw1", 0) == len(site.files("gw1"))

"""The lease protocol end to end: a real coordinator on loopback with a real archive, and a scripted worker."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
from click.testing import CliRunner

from coordinator.admin import administer
from coordinator.options import CoordinatorOptions
from coordinator.protocol.ask import ask_progress
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.cli.jobs import command as jobs
from factory.cli.status import command as status
from schemas.errors import UsageError, WorldError
from schemas.protocol.address_file import mark_finished, read_address
from schemas.protocol.administration import AdminAction, AdminReply, AdminRequest
from schemas.protocol.keys import Chunk, Verb, scene_selector
from schemas.protocol.messages import Beat, BeatReply, Claim, ClaimReply, HelloReply, Refusal
from schemas.support.product import product_version
from schemas.terms import FailReason, Recording
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.shared_validator import SharedValidator
from tests.builders.wire_worker import WireWorker, bundle_for, until

ANY_PORT = ("tcp/127.0.0.1:0",)
VERSION = product_version()


def settings(**changes: object) -> CoordinatorSettings:
    values = {"reserve_bytes": 0, "retry_after_s": 0.1, "pullers": 1, "pull_timeout_s": 1.0}
    return CoordinatorSettings.model_validate(values | changes)


@pytest.fixture
def opened(tmp_path: Path, checker: SharedValidator) -> Iterator[Coordinator]:
    options = CoordinatorOptions(listen=ANY_PORT, settings=settings(), checker=checker)
    with Coordinator(tmp_path / "out", room_plan(2), room_catalog(tmp_path), options) as running:
        yield running


@pytest.fixture
def worker(opened: Coordinator) -> Iterator[WireWorker]:
    with WireWorker(opened.endpoints, opened.run) as speaking:
        yield speaking


def test_a_run_of_two_episodes_is_archived_and_its_worker_drops_its_bundles_and_exits(opened, worker, tmp_path):
    hello = worker.hello(VERSION)
    assert isinstance(hello, HelloReply)
    assert hello.run == opened.run
    for _ in range(2):
        job, lease = worker.job()
        assert worker.deliver(lease, bundle_for(job))
    until(opened.is_finished)
    assert len(worker.beat().drop) == 2
    assert not worker.spool
    assert worker.claim().finished
    assert sorted(path.name for path in (tmp_path / "out" / "episodes").iterdir()) == ["ep_000001.zip", "ep_000002.zip"]
    progress = opened.progress()
    assert progress.jobs["archived"] == progress.planned == 2
    assert progress.attempts == {"success": 2}
    assert progress.eta_s == 0
    assert [(status.sid, status.archived, status.alive) for status in progress.workers] == [(worker.sid, 2, True)]


def test_status_of_a_run_whose_coordinator_has_ended_says_so_without_rate_and_time_left(tmp_path, checker):
    options = CoordinatorOptions(listen=ANY_PORT, settings=settings(), checker=checker)
    root = tmp_path / "out"
    with Coordinator(root, room_plan(2), room_catalog(tmp_path), options) as opened:
        with WireWorker(opened.endpoints, opened.run) as worker:
            job, lease = worker.job()
            assert worker.deliver(lease, bundle_for(job))
            until(lambda: opened.progress().jobs["archived"] == 1)
        assert "No coordinator" not in CliRunner().invoke(status, [str(root)]).output
    shown = CliRunner().invoke(status, [str(root)]).output
    assert "1 of 2 episodes archived\n" in shown
    assert f"No coordinator is running since {datetime.now(UTC):%Y-%m-%d}" in shown
    assert "/h" not in shown
    assert "ETA" not in shown


def test_a_repeated_claim_returns_the_same_job(worker):
    token = "a" * 32
    assert worker.claim(token) == worker.claim(token)


def test_bundles_are_pulled_in_chunks_of_bounded_size(tmp_path):
    small = settings(chunk_bytes=64 << 10)
    with (
        Coordinator(
            tmp_path / "out", room_plan(1), room_catalog(tmp_path), CoordinatorOptions(listen=ANY_PORT, settings=small)
        ) as opened,
        WireWorker(opened.endpoints, opened.run) as worker,
    ):
        job, lease = worker.job()
        bundle = bundle_for(job)
        worker.deliver(lease, bundle)
        until(opened.is_finished)
        assert worker.served == list(range(0, len(bundle), 64 << 10))


def test_small_bundles_that_wait_together_are_fetched_in_one_request(tmp_path):
    states, options = room_plan(5, Recording.STATES), CoordinatorOptions(listen=ANY_PORT, settings=settings())
    with (
        Coordinator(tmp_path / "out", states, room_catalog(tmp_path), options) as hub,
        WireWorker(hub.endpoints, hub.run) as worker,
    ):
        jobs = [worker.job() for _ in range(5)]
        for job, lease in jobs:  # they wait while the first bundle starts the validating process
            assert worker.deliver(lease, bundle_for(job))
        until(lambda: hub.progress().jobs["archived"] == 5)
    assert sum(worker.served_together) == 5
    assert max(worker.served_together) > 1


def test_a_bundle_of_another_job_is_refused_as_invalid_and_dropped(opened, worker):
    job, lease = worker.job()
    worker.deliver(lease, bundle_for(job.model_copy(update={"index": 9})))
    until(lambda: opened.progress().attempts == {"invalid": 1})
    assert worker.beat().drop == (lease,)
    assert opened.progress().jobs["archived"] == 0


def test_a_bundle_damaged_in_transfer_is_refused(opened, worker):
    job, lease = worker.job()
    worker.deliver(lease, bundle_for(job), sha256="0" * 64)
    until(lambda: opened.progress().attempts == {"invalid": 1})


def test_a_bundle_that_its_worker_does_not_serve_is_requested_again_after_the_next_heartbeat(opened, worker):
    job, lease = worker.job()
    worker.is_frozen = True
    worker.deliver(lease, bundle_for(job))
    worker.is_frozen = False

    def is_archived() -> bool:
        worker.beat()
        return opened.progress().jobs["archived"] == 1

    until(is_archived)


def test_a_silent_worker_loses_its_job_to_another_worker_and_its_late_result_is_refused(tmp_path):
    short = settings(lease_ttl_s=0.3, sweep_s=0.05)
    with (
        Coordinator(
            tmp_path / "out", room_plan(1), room_catalog(tmp_path), CoordinatorOptions(listen=ANY_PORT, settings=short)
        ) as opened,
        WireWorker(opened.endpoints, opened.run, "slow") as slow,
        WireWorker(opened.endpoints, opened.run, "fast") as fast,
    ):
        job, stale = slow.job()
        until(lambda: opened.progress().jobs["pending"] == 1)
        again, lease = fast.job()
        assert again == job
        assert not slow.deliver(stale, bundle_for(job))
        assert slow.beat().drop == (stale,)
        assert lease.fence > stale.fence


def test_a_task_failure_starts_the_next_attempt_and_a_repeated_report_has_no_effect(worker):
    job, lease = worker.job()
    assert worker.fail(lease, FailReason.TIMEOUT)
    assert worker.fail(lease, FailReason.TIMEOUT)
    other, _ = worker.job()
    again, _ = worker.job()
    assert (other.index, other.attempt) != (job.index, 2)
    assert (again.index, again.attempt) == (job.index, 2)


def test_a_restarted_coordinator_resumes_the_run(tmp_path):
    catalog, plan, out = room_catalog(tmp_path), room_plan(2), tmp_path / "out"
    with (
        Coordinator(out, plan, catalog, CoordinatorOptions(listen=ANY_PORT, settings=settings())) as opened,
        WireWorker(opened.endpoints, opened.run) as worker,
    ):
        job, lease = worker.job()
        worker.deliver(lease, bundle_for(job))
        until(lambda: opened.progress().jobs["archived"] == 1)
        _, unfinished = worker.job()
    with (
        Coordinator(out, plan, catalog, CoordinatorOptions(listen=ANY_PORT, settings=settings())) as opened,
        WireWorker(opened.endpoints, opened.run) as worker,
    ):
        assert opened.progress().jobs["archived"] == 1
        assert worker.beat([unfinished]).lost == ()


def test_a_lost_episode_is_generated_again_with_the_same_attempt_number(tmp_path):
    catalog, plan, out = room_catalog(tmp_path), room_plan(1), tmp_path / "out"
    with (
        Coordinator(out, plan, catalog, CoordinatorOptions(listen=ANY_PORT, settings=settings())) as opened,
        WireWorker(opened.endpoints, opened.run) as worker,
    ):
        first, lease = worker.job()
        worker.deliver(lease, bundle_for(first))
        until(opened.is_finished)
    (out / "episodes" / "ep_000001.zip").unlink()
    with (
        Coordinator(out, plan, catalog, CoordinatorOptions(listen=ANY_PORT, settings=settings())) as opened,
        WireWorker(opened.endpoints, opened.run) as worker,
    ):
        again, lease = worker.job()
        assert again == first
        worker.deliver(lease, bundle_for(again))
        until(opened.is_finished)


def test_no_jobs_are_leased_while_the_disk_is_full(tmp_path):
    greedy = settings(reserve_bytes=1 << 60)
    with (
        Coordinator(
            tmp_path / "out", room_plan(1), room_catalog(tmp_path), CoordinatorOptions(listen=ANY_PORT, settings=greedy)
        ) as opened,
        WireWorker(opened.endpoints, opened.run) as worker,
    ):
        reply = worker.claim()
        assert reply.job is None
        assert reply.retry_after_s > 0
        assert not reply.finished


def test_a_draining_coordinator_requests_its_workers_to_drain_and_leases_no_job(opened, worker):
    assert worker.ask(Verb.ADMIN, AdminRequest(action=AdminAction.DRAIN), AdminReply) == AdminReply(changed=())
    assert worker.beat().drain
    assert worker.claim().job is None


def test_the_drain_command_ends_the_workers(worker, tmp_path):
    done = CliRunner().invoke(jobs, ["drain", str(tmp_path / "out")], standalone_mode=False)
    assert done.exception is None
    said = f"the workers of {tmp_path / 'out'} finish their current jobs and exit"
    assert " ".join(done.output.split()).endswith(said)  # the output starts with log lines of the coordinator
    assert worker.beat().drain


def test_scenes_are_served_in_chunks(opened, worker, tmp_path):
    (entry,) = room_catalog(tmp_path).values()
    data = entry.path.read_bytes()
    tail = worker.fetch(scene_selector(opened.run, entry.sha256, Chunk(entry.size - 10, 100)))
    assert worker.fetch(scene_selector(opened.run, entry.sha256, Chunk(0, 1 << 20))) == data[: 1 << 20]
    assert tail == data[-10:]
    assert worker.fetch(scene_selector(opened.run, "f" * 64, Chunk(0, 10))) is None
    assert worker.fetch(scene_selector(opened.run, entry.sha256, Chunk(0, 2 << 20))) is None


@pytest.mark.parametrize(
    ("verb", "payload", "reason"),
    [
        ("claim", b"not json", "invalid message"),
        ("claim", b'{"sid": "host-1", "token": "short"}', "token"),
        ("steal", b"{}", "unknown verb"),
        ("beat", b"x" * ((1 << 20) + 1), "more than"),
        ("claim", Claim(sid="other-1", token="b" * 32).model_dump_json().encode(), "does not belong to host"),
    ],
)
def test_a_bad_message_is_refused_with_the_reason(worker, verb, payload, reason):
    refusal = worker.ask(verb, payload, ClaimReply)
    assert isinstance(refusal, Refusal)
    assert reason in refusal.error


def test_a_worker_of_another_version_is_refused_by_name(worker):
    refusal = worker.hello("0.0.1")
    assert isinstance(refusal, Refusal)
    assert "0.0.1" in refusal.error
    assert VERSION in refusal.error


def test_a_heartbeat_reply_lists_bundles_that_need_no_further_announcement(worker):
    _, lease = worker.job()
    worker.is_frozen = True  # the bundle cannot be pulled and stays announced
    worker.deliver(lease, b"x")
    reply = worker.beat()
    assert (reply.waiting, reply.drop) == ((lease,), ())


def test_a_heartbeat_reply_lists_the_bundles_of_unknown_leases_to_be_dropped(worker):
    _, lease = worker.job()
    stale = lease.model_copy(update={"fence": lease.fence + 1})
    assert worker.ask(Verb.BEAT, Beat(sid=worker.sid, spool=(stale, lease)), BeatReply) == BeatReply(drop=(stale,))


def test_any_client_can_request_the_progress_without_the_name_of_the_run(opened):
    assert ask_progress(opened.endpoints).run == opened.run


def test_operator_requests_run_with_or_without_a_coordinator_except_drain_which_needs_one(tmp_path):
    out, now = tmp_path / "out", datetime.now(UTC)
    with Coordinator(
        out, room_plan(2), room_catalog(tmp_path), CoordinatorOptions(listen=ANY_PORT, settings=settings())
    ) as opened:
        cancelled = administer(out, AdminRequest(action=AdminAction.CANCEL, indices=(1, 7)), now)
        assert opened.progress().jobs["cancelled"] == 1
    assert cancelled.changed == (1,)
    assert list(cancelled.refused) == [7]
    assert read_address(out) is None
    mark_finished(out, "run-1")
    assert administer(out, AdminRequest(action=AdminAction.RETRY, indices=(1,)), now).changed == (1,)
    assert read_address(out) is None, "the address file still states that the run is finished"
    with pytest.raises(UsageError, match="only a running coordinator can drain workers"):
        administer(out, AdminRequest(action=AdminAction.DRAIN), now)


def test_a_taken_endpoint_is_named_with_the_remedy(opened, tmp_path):
    with pytest.raises(WorldError, match=f"cannot listen on {opened.endpoints[0]}.*--listen"):
        Coordinator(
            tmp_path / "other", room_plan(1), room_catalog(tmp_path), CoordinatorOptions(listen=opened.endpoints)
        )


def test_a_directory_of_another_plan_is_refused_with_the_names_of_both_runs(tmp_path):
    catalog, out = room_catalog(tmp_path), tmp_path / "out"
    with Coordinator(out, room_plan(1), catalog, CoordinatorOptions(listen=ANY_PORT)):
        pass
    with pytest.raises(UsageError, match=f"{room_plan(1).run}.*{room_plan(2).run}.*--out"):
        Coordinator(out, room_plan(2), catalog, CoordinatorOptions(listen=ANY_PORT))


def test_a_changed_scene_is_refused(tmp_path):
    catalog, out = room_catalog(tmp_path), tmp_path / "out"
    with Coordinator(out, room_plan(1), catalog, CoordinatorOptions(listen=ANY_PORT)):
        pass
    (tmp_path / "other").mkdir()
    changed = room_catalog(tmp_path / "other", seed=1)
    with pytest.raises(WorldError, match=r"scene 'room' has SHA-256 .*, but had .* when run"):
        Coordinator(out, room_plan(1), changed, CoordinatorOptions(listen=ANY_PORT))

"""The worker against a minimal coordinator over zenoh, with scripted simulation processes."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from schemas.errors import WorldError
from schemas.protocol.keys import Verb
from schemas.protocol.messages import MAX_LEASES, Beat, Claim, Done, Fail, Hello, Lease
from schemas.terms import FailReason
from tests.builders.fake_coordinator import RUN, FakeCoordinator, jobs_with_instructions
from tests.builders.fake_simulation import bundle_for
from tests.builders.ports import free_endpoint
from tests.builders.worker import WorkerThread, fake_command, settings_for, started_worker
from workers.client.spool import Spool, folder_of
from workers.client.supervisor import STOPPED


@contextmanager
def coordinator(*instructions: str) -> Iterator[FakeCoordinator]:
    with FakeCoordinator(jobs_with_instructions(*instructions)) as opened:
        yield opened


def wait_until(holds: Callable[[], object], what: str) -> None:
    deadline = time.monotonic() + 30
    while not holds():
        assert time.monotonic() < deadline, f"timed out waiting for {what}"
        time.sleep(0.02)


def started(folder: Path) -> dict[int, int]:
    """Returns the ID of the simulation process of each started job."""
    names = [path.name.split(".") for path in (folder / "started").iterdir()]
    return {int(job): int(pid) for job, pid in names}


def is_alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def test_worker_delivers_every_bundle_intact_and_exits_when_the_run_is_finished(tmp_path):
    with (
        coordinator(*["bundle"] * 5) as hub,
        WorkerThread(settings_for(hub.endpoint, tmp_path, cores=2)) as worker,
    ):
        assert worker.join() == 0
        expected = {number: bundle_for(job.model_dump(mode="json")) for number, job in hub.jobs.items()}
        assert hub.archived == expected
    assert not list((tmp_path / "spool").rglob("*.zip"))


def test_a_task_failure_is_reported_with_the_reason_and_details_of_the_simulation(tmp_path):
    with coordinator("miss") as hub, WorkerThread(settings_for(hub.endpoint, tmp_path)) as worker:
        assert worker.join() == 0
        (fail,) = hub.ended.values()
    assert (fail.reason, fail.detail, fail.steps, fail.seconds) == (
        FailReason.COLLISION,
        "stalled at 0.3 m",
        77,
        1.5,
    )


def test_claim_whose_reply_was_lost_is_repeated_under_its_token(tmp_path):
    with coordinator("bundle") as hub:
        hub.dropped_replies[Verb.CLAIM] = 2
        with WorkerThread(settings_for(hub.endpoint, tmp_path)) as worker:
            assert worker.join() == 0
        claims = hub.of(Claim)
        assert len({claim.token for claim in claims[:3]}) == 1
        assert {done.lease.fence for done in hub.of(Done)} == {1}
        assert len(hub.archived) == 1


def test_failure_whose_acknowledgement_was_lost_is_repeated(tmp_path):
    with FakeCoordinator(jobs_with_instructions("miss"), lease_ttl_s=60) as hub:
        hub.dropped_replies |= {Verb.FAIL: 2, Verb.BEAT: 100}  # no heartbeat reply reports the end of the lease
        with WorkerThread(settings_for(hub.endpoint, tmp_path)) as worker:
            assert worker.join() == 0
        assert len({fail.lease for fail in hub.of(Fail)}) == 1
        assert len(hub.of(Fail)) == 3


def test_announcement_whose_reply_was_lost_is_repeated_by_the_heartbeat(tmp_path):
    with coordinator("bundle") as hub:
        hub.pulls = False
        with WorkerThread(settings_for(hub.endpoint, tmp_path)) as worker:
            hub.wait_until(lambda: len(hub.of(Done)) >= 3, "three announcements")
            hub.pulls = True
            assert worker.join() == 0
        assert len(hub.archived) == 1


def test_killed_simulation_is_a_crash_and_the_next_job_gets_a_fresh_process(tmp_path):
    with (
        coordinator("die", "bundle") as hub,
        WorkerThread(settings_for(hub.endpoint, tmp_path, pause_s=0.1)) as worker,
    ):
        assert worker.join() == 0
        fail = hub.ended[1]
        assert (fail.reason, fail.detail) == (FailReason.CRASH, "killed by SIGKILL")
        assert set(hub.archived) == {2}
        assert len(set(started(tmp_path).values())) == 2


def test_crash_report_contains_exit_status_and_last_output(tmp_path):
    with (
        coordinator("exit") as hub,
        WorkerThread(settings_for(hub.endpoint, tmp_path, pause_s=0.1)) as worker,
    ):
        assert worker.join() == 0
        assert hub.ended[1].detail == "exit status 3; last output: EGL: the driver is missing"


def test_simulation_without_progress_is_killed_and_reported_as_hung(tmp_path):
    with (
        coordinator("hang", "bundle") as hub,
        WorkerThread(settings_for(hub.endpoint, tmp_path, hang_s=3.0, pause_s=0.1)) as worker,
    ):
        assert worker.join() == 0
        assert hub.ended[1].reason is FailReason.HANG
        assert set(hub.archived) == {2}
        assert not is_alive(started(tmp_path)[1])


def test_heartbeats_report_progress_to_the_coordinator(tmp_path):
    with coordinator("slow") as hub, WorkerThread(settings_for(hub.endpoint, tmp_path)):
        hub.wait_until(lambda: any(item.step > 3 for beat in hub.of(Beat) for item in beat.live), "a step")


def test_a_lost_lease_ends_the_attempt_without_an_announcement(tmp_path):
    with coordinator("slow", "bundle") as hub, WorkerThread(settings_for(hub.endpoint, tmp_path)) as worker:
        wait_until(lambda: (tmp_path / "started").is_dir() and started(tmp_path), "the attempt")
        hub.take_away(1)
        assert worker.join() == 0
        assert not is_alive(started(tmp_path)[1])
        assert set(hub.archived) == {2}
        assert {message.lease.job_id for message in (*hub.of(Done), *hub.of(Fail))} == {2}


def test_a_worker_that_receives_sigterm_releases_its_jobs_and_exits_within_five_seconds(tmp_path):
    with (
        coordinator("slow", "slow") as hub,
        started_worker(settings_for(hub.endpoint, tmp_path, cores=2)) as worker,
    ):
        wait_until(lambda: len(started(tmp_path)) == 2, "both attempts")
        worker.send_signal(signal.SIGTERM)
        assert worker.wait(5) == STOPPED
        assert {fail.reason for fail in hub.of(Fail)} == {FailReason.RELEASED}
        assert {hub.lease_of(1), hub.lease_of(2)} == {None}
        assert not any(is_alive(pid) for pid in started(tmp_path).values())


def test_a_worker_that_receives_sigterm_without_a_coordinator_exits_and_keeps_spooled_bundles(tmp_path):
    with coordinator("bundle", "slow") as hub:
        hub.pulls = False
        with started_worker(settings_for(hub.endpoint, tmp_path)) as worker:
            wait_until(lambda: len(started(tmp_path)) == 2, "the second attempt")
            hub.close()
            worker.send_signal(signal.SIGTERM)
            assert worker.wait(5) == STOPPED
    assert len(list((tmp_path / "spool").rglob("*.zip"))) == 1
    assert len(list((tmp_path / "spool").rglob("*.json"))) == 1


def test_a_worker_that_receives_ctrl_c_after_sigterm_does_not_wait_for_its_spool(tmp_path):
    with coordinator("bundle", "slow") as hub:
        hub.pulls = False
        with started_worker(settings_for(hub.endpoint, tmp_path)) as worker:
            wait_until(lambda: len(started(tmp_path)) == 2, "the second attempt")
            worker.send_signal(signal.SIGTERM)
            hub.wait_until(lambda: bool(hub.of(Fail)), "the release")
            worker.send_signal(signal.SIGINT)
            assert worker.wait(5) == STOPPED
            assert not hub.archived


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGUSR1])
def test_further_signals_of_a_batch_system_do_not_shorten_the_drain(tmp_path, number):
    with coordinator("bundle", "slow") as hub:
        hub.pulls = False
        with started_worker(settings_for(hub.endpoint, tmp_path)) as worker:
            wait_until(lambda: len(started(tmp_path)) == 2, "the second attempt")
            worker.send_signal(number)
            hub.wait_until(lambda: bool(hub.of(Fail)), "the release")
            for _ in range(3):
                worker.send_signal(number)
            hub.pulls = True
            assert worker.wait(5) == STOPPED
            assert set(hub.archived) == {1}
            assert {fail.reason for fail in hub.of(Fail)} == {FailReason.RELEASED}


@pytest.fixture(params=[signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGUSR1])
def number(request):
    """Signal that ends a child process; sets its default action, because nohup or a background shell may ignore it."""
    before = signal.signal(request.param, signal.SIG_DFL)
    yield request.param
    signal.signal(request.param, before)


def test_a_job_whose_simulation_is_ended_by_an_external_signal_is_released_without_a_crash_report(tmp_path, number):
    with coordinator("slow", "bundle") as hub, WorkerThread(settings_for(hub.endpoint, tmp_path)) as worker:
        wait_until(lambda: 1 in started(tmp_path), "the attempt")
        os.kill(started(tmp_path)[1], number)
        hub.wait_until(lambda: bool(hub.of(Fail)), "the report")
        assert {fail.reason for fail in hub.of(Fail)} == {FailReason.RELEASED}
        assert f"killed by {number.name}" in hub.of(Fail)[0].detail
        worker.stop.set()


@pytest.mark.parametrize("order", ["simulation first", "worker first"])
def test_the_job_of_a_simulation_killed_while_its_worker_stops_is_released(tmp_path, order):
    with (
        coordinator("slow") as hub,
        started_worker(settings_for(hub.endpoint, tmp_path)) as worker,
    ):
        wait_until(lambda: 1 in started(tmp_path), "the attempt")
        kills = [
            lambda: os.kill(started(tmp_path)[1], signal.SIGKILL),
            lambda: worker.send_signal(signal.SIGTERM),
        ]
        for kill in kills if order == "simulation first" else reversed(kills):
            kill()
        assert worker.wait(8) == STOPPED
        assert {fail.reason for fail in hub.of(Fail)} == {FailReason.RELEASED}


def test_spooled_bundles_are_announced_again_after_a_restart_of_the_worker(tmp_path):
    with coordinator("bundle") as hub:
        hub.pulls = False
        settings = settings_for(hub.endpoint, tmp_path)
        with WorkerThread(settings):
            hub.wait_until(lambda: bool(hub.of(Done)), "an announcement")
        first = hub.of(Done)[0]
        hub.pulls = True
        with WorkerThread(settings) as again:
            assert again.join() == 0
        last = hub.of(Done)[-1]
        assert last.lease == first.lease
        assert last.sid != first.sid
        assert len(hub.archived) == 1
        assert len(started(tmp_path)) == 1


def test_simulations_die_with_a_supervisor_that_is_killed(tmp_path):
    with (
        coordinator("slow", "hang") as hub,
        started_worker(settings_for(hub.endpoint, tmp_path, cores=2)) as worker,
    ):
        wait_until(lambda: len(started(tmp_path)) == 2, "both attempts")
        os.kill(worker.pid, signal.SIGKILL)
        worker.wait()
        wait_until(lambda: not any(is_alive(pid) for pid in started(tmp_path).values()), "their end")


def test_a_worker_resumes_when_the_coordinator_returns(tmp_path):
    with coordinator("bundle", "bundle", "bundle") as hub:
        hub.pulls = False
        with WorkerThread(settings_for(hub.endpoint, tmp_path)) as worker:
            hub.wait_until(lambda: bool(hub.of(Done)), "an announcement")
            hub.close()
            hub.pulls = True
            hub.open()
            assert worker.join() == 0
        assert set(hub.archived) == {1, 2, 3}


def test_full_spool_stops_claims_until_bundles_are_fetched(tmp_path):
    with coordinator("bundle", "bundle", "bundle") as hub:
        hub.pulls = False
        with WorkerThread(settings_for(hub.endpoint, tmp_path, max_bundles=1)) as worker:
            hub.wait_until(lambda: len(hub.of(Done)) >= 4, "several beats with a full spool")
            assert len(hub.of(Claim)) == 1
            hub.pulls = True
            assert worker.join() == 0
        assert set(hub.archived) == {1, 2, 3}


def test_a_worker_whose_spool_fills_up_does_not_wait_for_the_next_heartbeat(tmp_path):
    with (
        # with this lease, there is one heartbeat every 15 minutes
        FakeCoordinator(jobs_with_instructions(*["bundle"] * 12), lease_ttl_s=3600) as hub,
        WorkerThread(settings_for(hub.endpoint, tmp_path, max_bundles=4)) as worker,
    ):
        hub.wait_until(lambda: len(hub.archived) == 12, "twelve bundles")
        assert worker.join() == 0


def test_a_draining_worker_finishes_its_jobs_and_claims_no_more(tmp_path):
    with coordinator("bundle", "bundle", "bundle") as hub:
        hub.pulls = False
        with WorkerThread(settings_for(hub.endpoint, tmp_path, max_bundles=1)) as worker:
            hub.wait_until(lambda: bool(hub.of(Done)), "an announcement")
            hub.drains = hub.pulls = True
            assert worker.join() == 0
        assert set(hub.archived) == {1}


def test_two_workers_on_one_host_share_scenes_but_not_a_spool(tmp_path):
    with coordinator(*["bundle"] * 6) as hub:
        settings = settings_for(hub.endpoint, tmp_path)
        with WorkerThread(settings) as one, WorkerThread(settings) as other:
            assert (one.join(), other.join()) == (0, 0)
        assert len(hub.archived) == 6
    assert len(list((tmp_path / "scenes").glob("*.scene"))) == 1


def test_a_worker_without_a_coordinator_names_the_endpoints_it_tried(tmp_path):
    endpoint = free_endpoint()
    with (
        WorkerThread(settings_for(endpoint, tmp_path, wait_s=0.1)) as worker,
        pytest.raises(WorldError, match=f"no coordinator answered at {endpoint}.*factory coordinator start"),
    ):
        worker.join()


def test_a_worker_stopped_before_it_found_a_coordinator_exits_cleanly(tmp_path):
    with WorkerThread(settings_for(free_endpoint(), tmp_path)) as worker:
        worker.stop.set()
        assert worker.join() == STOPPED


def test_a_refused_worker_reports_the_reason(tmp_path):
    with coordinator() as hub:
        hub.refuses = "hello: version 0 here, 1 there"
        with (
            WorkerThread(settings_for(hub.endpoint, tmp_path)) as worker,
            pytest.raises(WorldError, match="refuses this worker: hello: version 0 here"),
        ):
            worker.join()
        assert len(hub.of(Hello)) == 1


def test_a_worker_whose_simulations_do_not_start_claims_no_job(tmp_path):
    broken = fake_command(tmp_path, "broken")
    with coordinator("bundle") as hub:
        with (
            WorkerThread(settings_for(hub.endpoint, tmp_path, command=broken)) as worker,
            pytest.raises(WorldError, match=r"did not start after 3 tries.*no EGL on this machine"),
        ):
            worker.join()
        assert not hub.of(Claim)


def test_a_worker_whose_only_slot_pauses_learns_of_the_end_of_the_run_from_a_heartbeat(tmp_path):
    """The only slot of the worker pauses after a crash, so the worker claims no job for some time."""
    with coordinator("die") as hub:
        hub.tells_end_by_beat = True
        hub.dropped_replies[Verb.CLAIM] = 0
        with WorkerThread(settings_for(hub.endpoint, tmp_path, pause_s=30.0)) as worker:
            hub.wait_until(lambda: len(hub.ended) == 1, "a crash")
            claims = len(hub.of(Claim))
            assert worker.join() == 0
            assert len(hub.of(Claim)) == claims


def test_a_worker_exits_after_the_end_of_the_run_with_undelivered_bundles(tmp_path):
    with coordinator("bundle", "die") as hub:
        hub.pulls = False
        hub.tells_end_by_beat = True
        with WorkerThread(settings_for(hub.endpoint, tmp_path)) as worker:
            hub.wait_until(lambda: bool(hub.of(Done)) and len(hub.ended) == 1, "a bundle and a crash")
            with hub.changed:
                hub.archived[1] = b"brought by another"
            hub.wait_until(lambda: not hub.lease_of(7) and isinstance(hub.heard[-1], Beat), "a beat")
            hub.dropped_replies[Verb.BEAT] = 1
            hub.close()
            hub.open()
            hub.dropped_replies[Verb.BEAT] = 10**6
            assert worker.join() == 0


def test_a_large_spool_is_reported_in_several_heartbeats(tmp_path):
    with Spool(folder_of(tmp_path / "spool", RUN), 1000, 1 << 30) as spool:
        for number in range(1, 2 * MAX_LEASES + 50):
            stale = Lease(job_id=number, fence=9, token="9" * 32)
            spool.path_for(stale).write_bytes(b"x")
            spool.add(stale, "0" * 64, 1)
        waiting = len(spool)
    with coordinator("bundle") as hub, WorkerThread(settings_for(hub.endpoint, tmp_path)) as worker:
        assert worker.join() == 0
        beats = [beat for beat in hub.of(Beat) if isinstance(beat, Beat)]
    assert max(len(beat.spool) for beat in beats) == MAX_LEASES
    assert len({lease for beat in beats for lease in beat.spool if lease.fence == 9}) == waiting
    assert not list((tmp_path / "spool").rglob("*.zip"))

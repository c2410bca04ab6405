"""The functions of the ledger on a real database with a test clock."""

from __future__ import annotations

import os
import sqlite3
import stat
from collections.abc import Iterator
from datetime import timedelta

import pytest
from sqlalchemy import select

from coordinator.ledger import administration, claims, hosts, outcomes
from coordinator.ledger.claims import lease_of
from coordinator.ledger.database.engine import open_reader, open_writer, share_finished
from coordinator.ledger.opening import note_opened, open_run
from coordinator.ledger.reading.progress import read_progress, without_coordinator
from coordinator.ledger.reading.records import (
    JobFilter,
    LedgerEpisodes,
    count_jobs,
    list_jobs,
    read_attempts,
    read_events,
)
from coordinator.ledger.states import JobState
from coordinator.ledger.tables import attempts, episodes
from schemas.errors import UsageError, WorldError
from schemas.protocol.messages import Beat, Hello, Lease, LeaseProgress
from schemas.terms import FailReason
from tests.builders.ledger import TTL_S, TimedLedger, room_catalog, room_plan, summary_for

WORLD = [reason for reason in FailReason if reason.is_task_failure]
WORKER = [reason for reason in FailReason if reason.is_worker_failure]


PLAN = room_plan(3, attempts_per_draw=2, draws=2, crashes=2)


@pytest.fixture(params=["sqlite", "postgresql"])
def timed_ledger(request: pytest.FixtureRequest) -> Iterator[TimedLedger]:
    """A ledger on SQLite and on PostgreSQL; every test runs on both."""
    is_server = request.param == "postgresql"
    opened = TimedLedger(PLAN, request.getfixturevalue("postgres_server").new_database() if is_server else "sqlite://")
    yield opened
    opened.engine.dispose()


def outcomes_at(timed_ledger: TimedLedger) -> list[tuple[int, int, str, bool]]:
    with timed_ledger.open() as connection:
        rows = connection.execute(select(attempts).order_by(attempts.c.id)).all()
    return [(row.idx, row.attempt, row.outcome, row.settles) for row in rows]


def test_jobs_are_claimed_in_the_order_of_the_plan_under_rising_fences(timed_ledger):
    rows = [timed_ledger.claim() for _ in range(4)]
    assert [row and (row.idx, row.attempt, row.fence, row.state) for row in rows] == [
        (1, 1, 1, "leased"),
        (2, 1, 1, "leased"),
        (3, 1, 1, "leased"),
        None,
    ]


def test_a_repeated_claim_returns_the_same_lease_until_it_ends(timed_ledger):
    token = timed_ledger.new_token()
    first = timed_ledger.claim(token=token)
    assert timed_ledger.claim(token=token) == first
    lease = lease_of(first)
    assert timed_ledger.done(lease)
    assert lease_of(timed_ledger.claim(token=token)) == lease
    assert timed_ledger.archive(lease)
    assert timed_ledger.claim(token=token) is None


def test_an_expired_lease_returns_the_job_to_pending_with_the_same_attempt(timed_ledger):
    lease = timed_ledger.lease()
    assert timed_ledger.tick(TTL_S - 1) == 0
    assert timed_ledger.tick(1.1) == 1
    row = timed_ledger.row(lease.job_id)
    assert (row.state, row.attempt, row.token, row.lease_until) == ("pending", 1, None, None)
    assert outcomes_at(timed_ledger) == [(1, 1, "expired", False)]


def test_a_job_that_keeps_losing_its_lease_waits_longer_each_time(timed_ledger):
    waits = []
    for _ in range(12):
        while (row := timed_ledger.claim()) is None or row.idx != 1:
            timed_ledger.tick(1)
        timed_ledger.tick(TTL_S + 1)
        waits.append(timed_ledger.row(1).not_before - timed_ledger.now.timestamp())
    assert waits == sorted(waits)
    assert waits[0] < 1
    assert waits[-1] == pytest.approx(30)


def test_heartbeats_renew_leases_and_report_steps(timed_ledger):
    lease = timed_ledger.lease()
    for step in range(5):
        assert timed_ledger.tick(TTL_S / 2) == 0
        with timed_ledger.open() as connection:
            beat = Beat(sid="host-1", live=(LeaseProgress(lease=lease, step=step),))
            outcome = claims.beat(connection, beat, timed_ledger.now, TTL_S)
        assert outcome == claims.BeatOutcome((), (), ())
    assert timed_ledger.row(lease.job_id).step == 4


def test_a_heartbeat_reply_lists_lost_leases_unwanted_bundles_and_waiting_bundles(timed_ledger):
    archived, waiting, lost = (timed_ledger.lease() for _ in range(3))
    timed_ledger.done(archived)
    timed_ledger.archive(archived)
    timed_ledger.done(waiting)
    stale = lost.model_copy(update={"fence": 7})
    unknown = Lease(job_id=99, fence=1, token="f" * 32)
    with timed_ledger.open() as connection:
        beat = Beat(
            sid="host-1",
            live=(LeaseProgress(lease=stale, step=1), LeaseProgress(lease=unknown, step=1)),
            spool=(archived, waiting, lost, stale),
        )
        outcome = claims.beat(connection, beat, timed_ledger.now, TTL_S)
    assert outcome.lost == (stale, unknown)
    assert outcome.drop == (archived, stale)
    assert [row.id for row in outcome.waiting] == [waiting.job_id]


def test_only_the_leases_of_a_vanished_worker_are_shortened(timed_ledger):
    mine, theirs = timed_ledger.lease("host-1"), timed_ledger.lease("other-1")
    with timed_ledger.open() as connection:
        assert claims.shorten(connection, "host-1", timed_ledger.now, 2.0) == 1
    assert timed_ledger.tick(2.5) == 1
    assert timed_ledger.row(mine.job_id).state == "pending"
    assert timed_ledger.row(theirs.job_id).state == "leased"


def test_leases_get_a_grace_period_after_a_restart(timed_ledger):
    timed_ledger.lease()
    timed_ledger.now += timedelta(hours=1)
    with timed_ledger.open() as connection:
        assert claims.grant_grace(connection, timed_ledger.now, TTL_S) == 1
    assert timed_ledger.tick(1.4 * TTL_S) == 0
    assert timed_ledger.tick(0.2 * TTL_S) == 1


def test_done_is_idempotent_and_fenced(timed_ledger):
    lease = timed_ledger.lease()
    assert timed_ledger.done(lease)
    assert timed_ledger.done(lease)
    assert timed_ledger.archive(lease)
    assert timed_ledger.done(lease)
    assert not timed_ledger.archive(lease)
    assert timed_ledger.row(lease.job_id).state == "archived"
    assert not timed_ledger.done(lease.model_copy(update={"fence": 2}))
    assert not timed_ledger.done(lease.model_copy(update={"token": "e" * 32}))


def test_a_late_result_of_a_lost_lease_changes_nothing(timed_ledger):
    stale = timed_ledger.lease()
    timed_ledger.done(stale)
    timed_ledger.tick(TTL_S + 1)
    before = timed_ledger.rows()
    assert not timed_ledger.done(stale)
    assert not timed_ledger.archive(stale)
    assert not timed_ledger.fail(stale, FailReason.TIMEOUT)
    assert timed_ledger.rows() == before


@pytest.mark.parametrize("reason", WORLD)
def test_a_task_failure_starts_the_next_attempt(timed_ledger, reason):
    lease = timed_ledger.lease()
    assert timed_ledger.fail(lease, reason)
    row = timed_ledger.row(lease.job_id)
    assert (row.state, row.attempt, row.misses) == ("pending", 2, 1)
    assert outcomes_at(timed_ledger) == [(1, 1, reason, True)]


def test_a_repeated_failure_report_counts_once_and_gets_the_same_answer(timed_ledger):
    lease = timed_ledger.lease()
    assert timed_ledger.fail(lease, FailReason.COLLISION)
    assert timed_ledger.fail(lease, FailReason.COLLISION)
    assert timed_ledger.row(lease.job_id).attempt == 2
    assert len(outcomes_at(timed_ledger)) == 1


def exhaust(timed_ledger: TimedLedger, index: int, times: int) -> None:
    while times:
        row = timed_ledger.claim()
        if row is None:
            timed_ledger.tick(1)
        elif row.idx == index:
            assert timed_ledger.fail(lease_of(row), FailReason.TIMEOUT)
            times -= 1
        else:
            assert timed_ledger.fail(lease_of(row), FailReason.RELEASED)
            timed_ledger.tick(0.01)


def test_an_exhausted_draw_is_superseded_and_attempt_numbers_continue(timed_ledger):
    exhaust(timed_ledger, 1, 2)
    first, second = timed_ledger.rows(1)
    assert (first.state, first.superseded, first.draw) == ("failed", True, 0)
    assert (second.state, second.superseded, second.draw, second.attempt) == ("pending", False, 1, 3)
    assert second.target_id != first.target_id
    assert (second.tier, second.split, second.scene) == (first.tier, first.split, first.scene)


def test_the_last_draw_fails_the_episode_with_its_reason(timed_ledger):
    exhaust(timed_ledger, 1, 4)
    first, second = timed_ledger.rows(1)
    assert [first.state, second.state] == ["failed", "failed"]
    assert not second.superseded
    assert second.reason == "timeout: measured"
    assert [(attempt, outcome) for index, attempt, outcome, _ in outcomes_at(timed_ledger) if index == 1] == [
        (1, "timeout"),
        (2, "timeout"),
        (3, "timeout"),
        (4, "timeout"),
    ]


@pytest.mark.parametrize("reason", WORKER)
def test_a_job_that_crashes_workers_is_quarantined_without_a_redraw(timed_ledger, reason):
    for sid in ("one.1", "two.1"):
        while (row := timed_ledger.claim(sid)) is None or row.idx != 1:
            timed_ledger.tick(0.5)
        assert timed_ledger.fail(lease_of(row), reason, sid)
    (row,) = timed_ledger.rows(1)
    assert (row.state, row.attempt, row.crashes) == ("failed", 1, 2)
    assert row.reason.startswith("quarantined")


def test_a_released_job_is_pending_immediately_and_uses_no_budget(timed_ledger):
    lease = timed_ledger.lease()
    assert timed_ledger.fail(lease, FailReason.RELEASED)
    row = timed_ledger.row(lease.job_id)
    assert (row.state, row.attempt, row.misses, row.crashes) == ("pending", 1, 0, 0)


def test_an_archived_episode_is_recorded_with_its_summary(timed_ledger):
    lease = timed_ledger.lease()
    timed_ledger.done(lease)
    assert timed_ledger.archive(lease)
    with timed_ledger.open() as connection:
        (summary,) = LedgerEpisodes(connection).rows(1, timed_ledger.plan.episodes)
        assert outcomes.is_recorded(connection, 1)
        assert not outcomes.is_recorded(connection, 2)
    assert (summary.index, summary.attempt, summary.file_bytes) == (1, 1, 1000)
    assert outcomes_at(timed_ledger) == [(1, 1, "success", True)]


def test_an_announced_bundle_is_adopted_once(timed_ledger):
    lease = timed_ledger.lease()
    timed_ledger.done(lease)
    summary = summary_for(timed_ledger.row(lease.job_id))
    with timed_ledger.open() as connection:
        assert outcomes.adopt(connection, lease.job_id, summary, timed_ledger.now)
        assert not outcomes.adopt(connection, lease.job_id, summary, timed_ledger.now)


def test_a_lost_file_requeues_the_same_attempt(timed_ledger):
    lease = timed_ledger.lease()
    timed_ledger.done(lease)
    timed_ledger.archive(lease)
    with timed_ledger.open() as connection:
        assert outcomes.lose(connection, 1, timed_ledger.now, "gone")
        assert not outcomes.lose(connection, 1, timed_ledger.now, "gone")
    again = timed_ledger.lease()
    assert (again.job_id, again.fence) == (lease.job_id, 2)
    assert timed_ledger.row(lease.job_id).attempt == 1
    timed_ledger.done(again)
    assert timed_ledger.archive(again)
    assert [(outcome, settles) for _, _, outcome, settles in outcomes_at(timed_ledger)] == [
        ("lost", False),
        ("success", True),
    ]


def test_retry_resets_budgets_and_attempt_numbers_continue(timed_ledger):
    exhaust(timed_ledger, 1, 4)
    with timed_ledger.open() as connection:
        reply = administration.retry(connection, (1, 2, 9), timed_ledger.now)
    assert reply.changed == (1,)
    assert reply.refused == {
        9: "the plan has no episode of that number",
        2: "a job that is pending cannot be retried; it must be in one of the states: failed, cancelled",
    }
    _, row = timed_ledger.rows(1)
    assert (row.state, row.attempt, row.misses, row.reason) == ("pending", 5, 0, "")


def test_retry_without_numbers_selects_every_failed_episode(timed_ledger):
    exhaust(timed_ledger, 1, 4)
    with timed_ledger.open() as connection:
        administration.cancel(connection, (2,), timed_ledger.now)
        assert administration.retry(connection, (), timed_ledger.now).changed == (1,)


def test_cancel_ends_the_lease(timed_ledger):
    lease = timed_ledger.lease()
    with timed_ledger.open() as connection:
        assert administration.cancel(connection, (), timed_ledger.now).changed == (1, 2, 3)
        assert not claims.has_open_jobs(connection)
    assert not timed_ledger.done(lease)
    assert timed_ledger.claim() is None


def test_every_transition_is_in_the_history_of_the_episode(timed_ledger):
    lease = timed_ledger.lease()
    timed_ledger.done(lease)
    timed_ledger.archive(lease)
    with timed_ledger.open() as connection:
        history = [(line.event, line.state, line.worker) for line in read_events(connection, 1)]
        (attempt,) = read_attempts(connection, 1)
    assert history == [
        ("claimed", "leased", "host-1"),
        ("announced", "submitted", "host-1"),
        ("archived", "archived", ""),
    ]
    assert (attempt.outcome, attempt.worker) == ("success", "host-1")


def test_jobs_can_be_listed_by_state(timed_ledger):
    timed_ledger.lease()
    with timed_ledger.open() as connection:
        held = JobFilter(states=(JobState.LEASED,))
        assert [job.index for job in list_jobs(connection, held)] == [1]
        assert count_jobs(connection, JobFilter()) == 3
        assert [job.index for job in list_jobs(connection, JobFilter(), limit=1, offset=1)] == [2]


def test_progress_counts_only_current_draws_and_is_consistent(timed_ledger):
    exhaust(timed_ledger, 1, 2)
    timed_ledger.lease()
    with timed_ledger.open() as connection:
        progress = read_progress(connection, timed_ledger.now)
    assert progress.planned == sum(progress.jobs.values()) == 3
    assert progress.redrawn == 1
    assert progress.by_scene["room"] == progress.by_tier["near"] == progress.by_split["train_id"] == progress.jobs
    assert progress.attempts["timeout"] == 2
    assert progress.episodes_per_hour is None
    assert progress.eta_s is None
    assert not progress.finished


def test_rate_and_remaining_time_are_estimated_from_the_last_ten_minutes(timed_ledger):
    for _ in range(2):
        lease = timed_ledger.lease()
        timed_ledger.done(lease)
        timed_ledger.archive(lease)
        timed_ledger.now += timedelta(seconds=60)
    with timed_ledger.open() as connection:
        hosts.note_alive(connection, "host-1", "host-1", timed_ledger.now)
        progress = read_progress(connection, timed_ledger.now)
    assert progress.episodes_per_hour == pytest.approx(60)
    assert progress.eta_s == pytest.approx(60)


def test_rate_counts_the_whole_time_and_a_stalled_run_has_no_time_left(timed_ledger):
    timed_ledger.now += timedelta(seconds=16)
    for _ in range(2):
        lease = timed_ledger.lease()
        timed_ledger.done(lease)
        timed_ledger.archive(lease)
        timed_ledger.now += timedelta(seconds=1)
    with timed_ledger.open() as connection:
        hosts.note_alive(connection, "host-1", "host-1", timed_ledger.now)
        assert read_progress(connection, timed_ledger.now).episodes_per_hour == pytest.approx(2 * 3600 / 18)
        later = timed_ledger.now + timedelta(seconds=182)
        unattended = read_progress(connection, later)
        hosts.note_alive(connection, "host-1", "host-1", later)
        stalled = read_progress(connection, later)
    assert (unattended.episodes_per_hour, unattended.eta_s) == (None, None)
    assert stalled.episodes_per_hour == pytest.approx(2 * 3600 / 200)
    assert stalled.eta_s is None


def test_the_rate_does_not_count_episodes_that_were_adopted_before_the_run_was_opened(timed_ledger):
    for _ in range(2):
        lease = timed_ledger.lease()
        timed_ledger.done(lease)
        timed_ledger.archive(lease)
    with timed_ledger.open() as connection:
        hosts.note_alive(connection, "host-1", "host-1", timed_ledger.now + timedelta(seconds=11))
        counted = read_progress(connection, timed_ledger.now + timedelta(seconds=11))
        note_opened(connection, timed_ledger.now + timedelta(seconds=1))
        opened = read_progress(connection, timed_ledger.now + timedelta(seconds=11))
    assert counted.episodes_per_hour == pytest.approx(2 * 3600 / 11)
    assert opened.episodes_per_hour is None
    assert opened.eta_s is None


def test_a_run_without_a_coordinator_has_no_rate_and_names_its_last_activity(timed_ledger):
    for _ in range(2):
        lease = timed_ledger.lease()
        timed_ledger.done(lease)
        timed_ledger.archive(lease)
        timed_ledger.now += timedelta(seconds=20)
    last = timed_ledger.now
    with timed_ledger.open() as connection:
        hosts.note_alive(connection, "host-1", "host-1", last)
        running = read_progress(connection, last + timedelta(seconds=5))
        ended = without_coordinator(connection, running)
    assert running.episodes_per_hour is not None
    assert running.eta_s is not None
    assert (ended.episodes_per_hour, ended.eta_s, ended.stopped_at) == (None, None, last)
    assert [worker.alive for worker in ended.workers] == [False]


def test_a_reader_cannot_write(tmp_path):
    url = f"sqlite:///{tmp_path / 'ledger.db'}"
    engine = open_writer(url)
    open_run(engine, room_plan(1), room_catalog(), TTL_S, TimedLedger().now)
    reader = open_reader(url)
    with reader.connect() as connection:
        assert connection.execute(select(episodes)).all() == []
        with pytest.raises(Exception, match="readonly"):
            connection.execute(episodes.delete())
    engine.dispose()
    reader.dispose()


def test_a_missing_ledger_is_named_with_the_remedy(tmp_path):
    with pytest.raises(WorldError, match=r"no ledger at .*ledger.db; start a run"):
        open_reader(f"sqlite:///{tmp_path / 'ledger.db'}")


def test_an_unknown_database_is_refused_with_the_remedy():
    with pytest.raises(UsageError, match=r"examples: sqlite:///"):
        open_writer("nosuch://place")


def test_a_committed_claim_survives_in_the_write_ahead_log(tmp_path):
    file = tmp_path / "ledger.db"
    timed_ledger = TimedLedger(url=f"sqlite:///{file}")
    timed_ledger.lease()
    with sqlite3.connect(file) as other:
        assert other.execute("PRAGMA journal_mode").fetchone() == ("wal",)
        assert other.execute("SELECT count(*) FROM jobs WHERE state = 'leased'").fetchone() == (1,)
    other.close()
    timed_ledger.engine.dispose()


@pytest.mark.parametrize(
    ("statement", "index"),
    [
        (claims.NEXT_ID, "ix_jobs_queue"),
        (claims.BY_TOKEN, "ux_jobs_token"),
        (claims.OVERDUE, "ix_jobs_lease"),
        (claims.ANY_OPEN, "ix_jobs_queue"),
    ],
)
def test_queries_of_a_claim_use_an_index(statement, index):
    timed_ledger = TimedLedger(PLAN)
    with timed_ledger.open() as connection:
        text = str(statement.compile(connection, compile_kwargs={"render_postcompile": True}))
        plan = connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {text}", (1,) * text.count("?")).all()
    assert all(index in row.detail for row in plan if "jobs" in row.detail), plan
    assert not any("TEMP B-TREE" in row.detail for row in plan), plan


@pytest.mark.parametrize("former", [None, 0o644, 0o664])
def test_a_ledger_is_readable_only_by_its_owner(tmp_path, former):
    file = tmp_path / "ledger.db"
    if former is not None:
        file.touch()
        file.chmod(former)
    umask = os.umask(0)
    try:
        timed_ledger = TimedLedger(url=f"sqlite:///{file}")
        timed_ledger.lease()
        modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()}
        timed_ledger.engine.dispose()
    finally:
        os.umask(umask)
    assert set(modes) == {"ledger.db", "ledger.db-wal", "ledger.db-shm"}
    assert set(modes.values()) == {0o600 if former is None else former & ~0o007}


@pytest.mark.parametrize(("folder", "mode"), [(0o755, 0o644), (0o750, 0o640), (0o700, 0o600)])
def test_a_finished_ledger_has_the_reading_permissions_of_its_folder(tmp_path, folder, mode):
    file = tmp_path / "ledger.db"
    timed_ledger = TimedLedger(url=f"sqlite:///{file}")
    timed_ledger.engine.dispose()
    tmp_path.chmod(folder)
    share_finished(f"sqlite:///{file}")
    assert {stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()} == {mode}


def test_a_missing_permission_is_not_reported_as_damage(tmp_path, monkeypatch):
    url = f"sqlite:///{tmp_path / 'ledger.db'}"
    TimedLedger(url=url).engine.dispose()
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may read every file
    with pytest.raises(WorldError, match=r"no permission to read the ledger .*`chmod a[+]r ") as error:
        open_reader(url)
    assert "repair" not in str(error.value)


def test_a_lease_belongs_to_the_host_that_claimed_it(timed_ledger):
    token = timed_ledger.new_token()
    lease = lease_of(timed_ledger.claim("host-1.a", token))
    before = timed_ledger.rows()
    assert timed_ledger.claim("thief.a", token) is None
    assert not timed_ledger.done(lease, "thief.a")
    assert not timed_ledger.fail(lease, FailReason.RELEASED, "thief.a")
    with timed_ledger.open() as connection:
        beat = Beat(sid="thief.a", live=(LeaseProgress(lease=lease, step=1),), spool=(lease,))
        assert claims.beat(connection, beat, timed_ledger.now, TTL_S) == claims.BeatOutcome((lease,), (lease,), ())
    assert timed_ledger.rows() == before
    assert timed_ledger.done(lease, "host-1.b")
    assert not timed_ledger.fail(lease, FailReason.CRASH, "host-10.a")
    assert timed_ledger.archive(lease)
    assert not timed_ledger.done(lease, "thief.a")


def test_the_number_of_sessions_is_bounded_and_silent_sessions_are_removed(timed_ledger, monkeypatch):
    def hello(host: str, number: int) -> bool:
        with timed_ledger.open() as connection:
            return hosts.register(
                connection, Hello(sid=f"{host}.{number}", host=host, slots=1, version="1"), timed_ledger.now
            )

    monkeypatch.setattr(hosts, "SESSIONS_OF_HOST", 5)
    monkeypatch.setattr(hosts, "SESSIONS", 8)
    assert [hello("one", number) for number in range(7)] == [True] * 5 + [False] * 2
    assert hello("one", 3)
    assert [hello("two", number) for number in range(4)] == [True] * 3 + [False]
    with timed_ledger.open() as connection:
        hosts.note_alive(connection, "one.9", "one", timed_ledger.now)
        assert len(read_progress(connection, timed_ledger.now).workers) == 8
    timed_ledger.now += timedelta(hours=1)
    assert [hello("three", number) for number in range(6)] == [True] * 5 + [False]

"""Small parts of the worker: pauses, names, active leases, phases."""

from __future__ import annotations

import pytest

from schemas.protocol.keys import sid_belongs_to
from schemas.protocol.messages import Hello, Lease, LeaseProgress, PolicyWait
from workers.client.host import Backoff, LeaseBook, Phase, make_sid, valid_host_name
from workers.client.settings import WorkerSettings

LEASE = Lease(job_id=1, fence=1, token="0" * 32)
OTHER = Lease(job_id=2, fence=1, token="1" * 32)


def test_pauses_double_up_to_the_longest_and_start_again_after_a_success():
    backoff = Backoff(0.1, 0.5)
    assert [backoff.fail() for _ in range(5)] == pytest.approx([0.1, 0.2, 0.4, 0.5, 0.5])
    backoff.succeed()
    assert backoff.fail() == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("name", "tidy"),
    [("Node_07.cluster.local", "node-07-cluster-local"), ("-x-", "x"), ("***", "host"), ("a" * 99, "a" * 48)],
)
def test_host_names_are_converted_to_valid_keys(name, tidy):
    assert valid_host_name(name) == tidy


def test_session_id_is_fresh_and_belongs_to_its_host():
    one, other = make_sid("node-1"), make_sid("node-1")
    assert one != other
    assert sid_belongs_to(one, "node-1")
    assert not sid_belongs_to(one, "node")
    assert not sid_belongs_to(make_sid("node-1"), "node-1.x")
    assert not sid_belongs_to("a.b.1", "a.b")
    assert Hello(sid=one, host="node-1", slots=1, version="0").sid == one


def test_lease_is_live_while_it_is_held():
    book = LeaseBook()
    with book.held(LEASE):
        book.note_progress(LEASE, 7, PolicyWait.ANSWER)
        assert book.live() == (LeaseProgress(lease=LEASE, step=7, waits=PolicyWait.ANSWER),)
        book.note_progress(LEASE, 8, None)
        assert book.live() == (LeaseProgress(lease=LEASE, step=8),)
    assert not book.live()


def test_only_held_leases_can_be_lost():
    book = LeaseBook()
    with book.held(LEASE):
        book.lose([LEASE, OTHER])
        assert book.is_lost(LEASE)
        assert not book.is_lost(OTHER)
    with book.held(LEASE):
        assert not book.is_lost(LEASE)


def test_stopping_begins_the_closing_phase_and_sets_a_deadline():
    phase = Phase()
    assert phase.left_s == float("inf")
    phase.stop(0.0)
    assert phase.closing.is_set()
    assert phase.left_s == 0.0


def test_the_first_error_is_kept():
    phase = Phase()
    first = ValueError("first")
    phase.fail(first)
    phase.fail(ValueError("second"))
    assert phase.error is first


def test_caches_are_below_the_chosen_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("MINIVLA_CACHE", str(tmp_path))
    settings = WorkerSettings(connect=("tcp/127.0.0.1:7447",), cores=3)
    assert settings.spool_dir.parent == settings.scene_dir.parent == tmp_path
    assert settings.spool_limit == 14
    assert settings.simulation_command[-2:] == ("--renderer", "auto")

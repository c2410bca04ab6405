"""Admin requests are executed and recorded in one transaction; a paused run leases no job."""

from __future__ import annotations

from coordinator.ledger.administration import execute, is_paused, read_requests
from coordinator.ledger.reading.audit import ledger_trouble
from schemas.protocol.administration import AdminAction, AdminReply, AdminRequest
from tests.builders.ledger import TimedLedger


def ask(timed_ledger: TimedLedger, action: AdminAction, *indices: int) -> AdminReply:
    with timed_ledger.open() as connection:
        return execute(connection, AdminRequest(action=action, indices=indices), timed_ledger.now)


def test_a_run_is_paused_until_it_is_resumed():
    timed_ledger = TimedLedger()
    with timed_ledger.open() as connection:
        assert not is_paused(connection)
    for action, paused in ((AdminAction.PAUSE, True), (AdminAction.PAUSE, True), (AdminAction.RESUME, False)):
        assert ask(timed_ledger, action) == AdminReply(changed=())
        with timed_ledger.open() as connection:
            assert is_paused(connection) == paused


def test_every_request_is_recorded_with_the_number_of_changes():
    timed_ledger = TimedLedger()
    ask(timed_ledger, AdminAction.CANCEL, 1, 2)
    ask(timed_ledger, AdminAction.RETRY, 1)
    ask(timed_ledger, AdminAction.DRAIN)
    with timed_ledger.open() as connection:
        found = read_requests(connection)
    assert [(one.action, one.changed, one.time) for one in found] == [
        ("cancel", 2, timed_ledger.now),
        ("retry", 1, timed_ledger.now),
        ("drain", 0, timed_ledger.now),
    ]


def test_the_oldest_of_many_requests_are_forgotten(tmp_path):
    timed_ledger = TimedLedger(url=f"sqlite:///{tmp_path / 'ledger.db'}")
    for _ in range(60):
        ask(timed_ledger, AdminAction.PAUSE)
        ask(timed_ledger, AdminAction.RESUME)
    with timed_ledger.open() as connection:
        assert len(read_requests(connection)) == 100
    timed_ledger.engine.dispose()
    assert not ledger_trouble(f"sqlite:///{tmp_path / 'ledger.db'}")

"""Admin requests are executed and recorded in one transaction; a paused run leases no job."""

from __future__ import annotations

from coordinator.ledger.reading.audit import ledger_trouble
from coordinator.ledger.requests import execute, is_paused, read_requests
from schemas.protocol.administration import AdminAction, AdminReply, AdminRequest
from tests.builders.ledger import Desk


def ask(desk: Desk, action: AdminAction, *indices: int) -> AdminReply:
    with desk.open() as connection:
        return execute(connection, AdminRequest(action=action, indices=indices), desk.now)


def test_a_run_is_paused_until_it_is_resumed():
    desk = Desk()
    with desk.open() as connection:
        assert not is_paused(connection)
    for action, paused in ((AdminAction.PAUSE, True), (AdminAction.PAUSE, True), (AdminAction.RESUME, False)):
        assert ask(desk, action) == AdminReply(changed=())
        with desk.open() as connection:
            assert is_paused(connection) == paused


def test_every_request_is_recorded_with_the_number_of_changes():
    desk = Desk()
    ask(desk, AdminAction.CANCEL, 1, 2)
    ask(desk, AdminAction.RETRY, 1)
    ask(desk, AdminAction.DRAIN)
    with desk.open() as connection:
        found = read_requests(connection)
    assert [(one.action, one.changed, one.time) for one in found] == [
        ("cancel", 2, desk.now),
        ("retry", 1, desk.now),
        ("drain", 0, desk.now),
    ]


def test_the_oldest_of_many_requests_are_forgotten(tmp_path):
    desk = Desk(url=f"sqlite:///{tmp_path / 'ledger.db'}")
    for _ in range(60):
        ask(desk, AdminAction.PAUSE)
        ask(desk, AdminAction.RESUME)
    with desk.open() as connection:
        assert len(read_requests(connection)) == 100
    desk.engine.dispose()
    assert not ledger_trouble(f"sqlite:///{tmp_path / 'ledger.db'}")

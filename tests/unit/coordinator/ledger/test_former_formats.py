"""A ledger of an older format is refused; the message names the format, its version of the software and the remedy."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from sqlalchemy import update

from coordinator.ledger.opening import FormerFormat, open_run, read_info, require_current_format
from coordinator.ledger.reading.audit import find_damage
from coordinator.ledger.tables import FORMER_FORMATS, LEDGER_FORMAT, info
from schemas.errors import UsageError, WorldError
from schemas.terms import FailReason
from tests.builders.former_ledger import make_former
from tests.builders.ledger import TTL_S, TimedLedger, room_plan

SAID = (
    r"^the ledger has format {} of minivla-factory 0\.1\.0, and this version reads format 4 only: rebuild it from the "
    r"episodes with `factory repair DIR`, or finish the run with version 0\.1\.0$"
)


@pytest.fixture
def ledger() -> Iterator[TimedLedger]:
    """A ledger of the current format with a failed and a crashed attempt."""
    made = TimedLedger(room_plan(1, crashes=5))
    for reason in (FailReason.TIMEOUT, FailReason.CRASH):
        assert made.fail(made.lease(), reason)
    yield made
    made.engine.dispose()


@pytest.fixture(params=FORMER_FORMATS)
def former(request: pytest.FixtureRequest, ledger: TimedLedger) -> tuple[TimedLedger, int]:
    """A ledger of an older format, and the format."""
    with ledger.open() as connection:
        make_former(connection, request.param)
    return ledger, request.param


def test_every_older_format_has_a_version() -> None:
    assert list(FORMER_FORMATS) == list(range(1, LEDGER_FORMAT))


def test_readers_refuse_an_older_format(former: tuple[TimedLedger, int]) -> None:
    ledger, form = former
    for read in (read_info, require_current_format, find_damage):
        with ledger.open() as connection, pytest.raises(FormerFormat, match=SAID.format(form)):
            read(connection)


def test_an_older_format_is_not_opened_for_writing(former: tuple[TimedLedger, int]) -> None:
    ledger, form = former
    with pytest.raises(FormerFormat, match=SAID.format(form)):
        open_run(ledger.engine, ledger.plan, ledger.catalog, TTL_S, ledger.now)


def test_the_remedy_for_a_database_server_names_an_empty_database() -> None:
    assert "`factory repair DIR` with an empty database as --ledger" in str(FormerFormat(3, on_server=True))


def test_a_newer_format_is_refused(ledger: TimedLedger) -> None:
    with ledger.open() as connection:
        connection.execute(update(info).where(info.c.key == "format").values(value=str(LEDGER_FORMAT + 1)))
        with pytest.raises(UsageError, match=f"format {LEDGER_FORMAT + 1}.*newer") as said:
            read_info(connection)
    assert not isinstance(said.value, FormerFormat)


@pytest.mark.parametrize("value", ["", "0", "-1", "four", "4.0", "9" * 30])
def test_a_format_that_does_not_exist_is_damage(ledger: TimedLedger, value: str) -> None:
    with ledger.open() as connection:
        connection.execute(update(info).where(info.c.key == "format").values(value=value))
        assert "is damaged" in find_damage(connection)
        with pytest.raises(WorldError, match="is damaged"):
            read_info(connection)


def test_a_database_without_a_ledger_passes(ledger: TimedLedger) -> None:
    with ledger.open() as connection:
        info.drop(connection)
        require_current_format(connection)

"""Reading an invalid or damaged ledger: an error with a remedy, never a traceback of the database."""

from __future__ import annotations

from pathlib import Path

import pytest

from coordinator.ledger.database.engine import sqlite_url
from coordinator.ledger.opening import read_info
from coordinator.ledger.reading.reader import open_ledger
from coordinator.ledger.reading.records import JobFilter, list_jobs
from schemas.errors import UsageError, WorldError


@pytest.mark.parametrize("content", [b"garbage, and more of it", b""])
def test_a_file_that_is_not_a_ledger_is_refused_with_the_repair_command(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "ledger.db"
    file.write_bytes(content)
    with (
        pytest.raises(WorldError, match=r"ledger\.db cannot be read: .*factory repair"),
        open_ledger(sqlite_url(file)) as connection,
    ):
        list_jobs(connection, JobFilter())


def test_an_empty_database_holds_no_ledger_yet(tmp_path: Path) -> None:
    (tmp_path / "ledger.db").touch()
    with pytest.raises(UsageError, match="factory run"), open_ledger(sqlite_url(tmp_path / "ledger.db")) as connection:
        read_info(connection)

"""Tables that temporarily cannot be written: the run continues, the log stays short, and the recovery is logged."""

from __future__ import annotations

import threading
from pathlib import Path

from structlog.testing import capture_logs

from coordinator.options import CoordinatorOptions
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.wire_worker import until

ENOUGH_S = 5.0
"""Time in which there would be hundreds of tries if the pauses between them did not grow, seconds."""


def test_a_failed_table_write_is_logged_once_and_retried(tmp_path: Path) -> None:
    root = tmp_path / "out"
    settings = CoordinatorSettings(reserve_bytes=0, pullers=1, checkpoint_s=0.01)
    obstacle = root / "metadata.parquet" / "in the way"
    obstacle.mkdir(parents=True)
    with (
        capture_logs() as lines,
        Coordinator(
            root,
            room_plan(1),
            room_catalog(tmp_path),
            CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=settings),
        ),
    ):
        until(lambda: any(line["event"] == "periodic_task_failed" for line in lines))
        threading.Event().wait(ENOUGH_S)
        obstacle.rmdir()
        obstacle.parent.rmdir()
        until(lambda: any(line["event"] == "periodic_task_failed_recovered" for line in lines))
    told = [line for line in lines if line["event"] == "periodic_task_failed"]
    assert len(told) == 1
    assert "exc_info" not in told[0]
    assert "metadata.parquet" in told[0]["error"]
    assert (root / "metadata.parquet").is_file()

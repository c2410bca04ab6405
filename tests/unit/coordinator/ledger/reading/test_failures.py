"""Failed attempts with their locations, as the maps of the web page draw them."""

from __future__ import annotations

import pytest

from coordinator.ledger.hosts import read_memory, write_memory
from coordinator.ledger.reading.failures import count_failures, place_in, read_failures
from schemas.protocol.messages import HostMemory
from schemas.terms import FailReason
from tests.builders.ledger import TimedLedger, room_plan


@pytest.mark.parametrize(
    ("detail", "xy_m"),
    [
        ("collision after 101 steps at (12.09, -1.49) m, 5.01 m from monitor_001", (12.09, -1.49)),
        ("no drivable path to picture_003 from (-0.50, 1.00) m, yaw 2.59 rad", (-0.5, 1.0)),
        ("timeout after 1000 steps, 1.22 m from chair_004", None),
        ("at (1, 2) of (9999999999.0, 0.0) m", None),
        ("", None),
    ],
)
def test_the_location_of_a_failure_is_read_from_its_description(detail: str, xy_m: tuple[float, float] | None) -> None:
    assert place_in(detail) == xy_m


def test_failures_of_a_scene_are_read_newest_first_without_successes_and_releases() -> None:
    timed_ledger = TimedLedger(room_plan(3, draws=2, attempts_per_draw=2))
    for reason, detail in (
        (FailReason.COLLISION, "collision after 7 steps at (1.00, 2.00) m, 3.00 m from chair_001"),
        (FailReason.RELEASED, ""),
        (FailReason.TIMEOUT, "timeout"),
    ):
        timed_ledger.fail(timed_ledger.lease(), reason, detail=detail)
    with timed_ledger.open() as connection:
        found = read_failures(connection)
        scene = found[0].scene
        assert [(one.reason, one.xy_m) for one in found] == [("timeout", None), ("collision", (1.0, 2.0))]
        assert read_failures(connection, scene) == found
        assert read_failures(connection, "elsewhere") == []
        assert read_failures(connection, limit=1) == found[:1]
        assert count_failures(connection) == {scene: 2}


def test_the_memory_of_hosts_is_replaced_as_a_whole() -> None:
    timed_ledger = TimedLedger()
    one, two = HostMemory(used_bytes=1, total_bytes=4), HostMemory(used_bytes=2, total_bytes=4)
    with timed_ledger.open() as connection:
        assert read_memory(connection) == {}
        write_memory(connection, {"a": one, "b": one})
        write_memory(connection, {"a": two})
        assert read_memory(connection) == {"a": two}

"""The time limits of a simulation process."""

from __future__ import annotations

import sys

from schemas.terms import FailReason
from workers.process.messages import SimulationReportKind
from workers.process.simulation import ProcessEnd, Simulation

SLOW_START = """
import sys, time
time.sleep(0.4)
print('{"kind": "ready"}', flush=True)
sys.stdin.read()
"""


def first_report(simulation: Simulation) -> object:
    simulation.start()
    while (report := simulation.receive(0.02)) is None:
        pass
    simulation.kill()
    return report


def test_a_start_may_take_longer_than_the_permitted_silence_of_a_busy_process() -> None:
    report = first_report(Simulation((sys.executable, "-S", "-c", SLOW_START), hang_s=0.1))
    assert getattr(report, "kind", None) is SimulationReportKind.READY


def test_a_process_that_does_not_start_within_its_limit_is_killed_as_hung() -> None:
    report = first_report(Simulation((sys.executable, "-S", "-c", "import sys; sys.stdin.read()"), 60.0, start_s=0.1))
    assert isinstance(report, ProcessEnd)
    assert report.reason is FailReason.HANG
    assert "(limit 0.1 s), killed" in report.detail

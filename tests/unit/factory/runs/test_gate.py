"""The gate: every first attempt runs once and is counted by tier and reason; real processes, no physics."""

from __future__ import annotations

import sys
import threading
from collections import defaultdict
from pathlib import Path

import pytest

from factory.runs.gate import GateRun, Trial, consequence_of, evaluate_gate, run_gate
from schemas.errors import WorldError
from schemas.plan import Budget
from schemas.support.child import python_module
from schemas.terms import FailReason, Tier
from tests.builders.bundle import job_for
from tests.builders.ledger import room_catalog, room_plan

QUICK = python_module("tests.builders.small_simulation", "0.01")
"""A simulation that succeeds or stalls immediately, depending on the number of the job."""
NOISY_DEATH = (sys.executable, "-c", "raise SystemExit('no renderer')")
DIES_AT_WORK = (
    sys.executable,
    "-c",
    """import sys; print('{"kind": "ready"}', flush=True); sys.stdin.readline(); sys.exit('broken')""",
)


def gate_run_of(count: int, command: tuple[str, ...] = QUICK, processes: int = 2) -> GateRun:
    return GateRun(
        tuple(job_for(index) for index in range(1, count + 1)), defaultdict(lambda: Path("unused")), command, processes
    )


def try_all(gate_run: GateRun) -> list[Trial]:
    return run_gate(gate_run, threading.Event(), lambda _done: None)


def test_a_gate_run_is_the_first_attempt_at_every_episode_of_the_plan() -> None:
    gate_run = GateRun.of(room_plan(5), room_catalog(), (), 1)
    assert [job.index for job in gate_run.jobs] == [1, 2, 3, 4, 5]
    assert {(job.draw, job.attempt) for job in gate_run.jobs} == {(0, 1)}


@pytest.mark.parametrize("processes", [1, 3])
def test_every_job_is_tried_once_and_the_outcome_does_not_depend_on_processes(processes: int) -> None:
    told: list[int] = []
    trials = run_gate(gate_run_of(8, processes=processes), threading.Event(), told.append)
    assert told == list(range(1, 9))
    assert sorted(trial.job.index for trial in trials) == list(range(1, 9))
    outcome = {trial.job.index: trial.reason for trial in trials}
    assert outcome == {trial.job.index: trial.reason for trial in try_all(gate_run_of(8, processes=2))}
    assert set(outcome.values()) == {None, FailReason.COLLISION}


def test_no_bundle_remains_after_the_gate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    try_all(gate_run_of(3))
    assert list(tmp_path.iterdir()) == []


def test_a_crash_is_a_failed_attempt_and_the_others_continue() -> None:
    trials = try_all(gate_run_of(2, DIES_AT_WORK, processes=1))
    assert [trial.reason for trial in trials] == [FailReason.CRASH] * 2
    assert "broken" in trials[0].detail


def test_simulations_that_do_not_start_are_an_error_with_their_last_output() -> None:
    with pytest.raises(WorldError, match=r"did not start after 3 tries.*no renderer"):
        try_all(gate_run_of(2, NOISY_DEATH, processes=1))


def test_a_stopped_gate_run_returns_its_finished_trials() -> None:
    stop = threading.Event()
    trials = run_gate(gate_run_of(20, processes=1), stop, lambda done: stop.set() if done == 2 else None)
    assert len(trials) == 2


def test_the_report_of_a_gate_counts_trials_by_tier_and_reason() -> None:
    trials = [
        Trial(job_for(3, tier=Tier.FAR), FailReason.TIMEOUT, "1000 steps"),
        Trial(job_for(2, tier=Tier.FAR), FailReason.COLLISION, "stalled"),
        *(Trial(job_for(index)) for index in range(4, 12)),
    ]
    report = evaluate_gate("office", "proportional", trials, 0.8)
    assert report.passed
    assert (report.success.count, report.success.of, report.success.share) == (8, 10, 0.8)
    assert report.success.low == pytest.approx(0.4902, abs=1e-4)  # Wilson interval of 8 of 10
    assert report.by_tier[Tier.FAR].share == 0.0
    assert Tier.MID not in report.by_tier
    assert report.reasons == {FailReason.COLLISION: 1, FailReason.TIMEOUT: 1}
    assert [row.episode_id for row in report.lost] == ["ep_000002", "ep_000003"]


@pytest.mark.parametrize(("min_success", "passed"), [(0.5, True), (0.51, False)])
def test_the_gate_passes_at_the_required_share(min_success: float, passed: bool) -> None:
    trials = [Trial(job_for(1)), Trial(job_for(2), FailReason.SPAWN, "")]
    assert evaluate_gate("office", "proportional", trials, min_success).passed is passed


def test_a_gate_run_without_trials_does_not_pass() -> None:
    assert not evaluate_gate("office", "proportional", [], 0.0).passed


def test_a_failed_gate_says_how_many_attempts_and_failed_episodes_follow() -> None:
    budget = Budget(attempts_per_draw=1, draws=2)
    trials = [Trial(job_for(1)), Trial(job_for(2), FailReason.SPAWN, "")]
    text = consequence_of(evaluate_gate("office", "planner", trials, 0.8, budget))
    assert "about 2.0 attempts for each episode" in text
    assert "after 2 attempts, which happens to about 25 % of the episodes" in text
    assert "no attempt succeeded" in consequence_of(evaluate_gate("office", "planner", trials[1:], 0.8, budget))

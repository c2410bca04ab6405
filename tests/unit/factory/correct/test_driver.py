"""Policies as drivers of corrections: their answers, their failures, and the policies that are refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from factory.correct.driver import EvaluatedPolicy
from factory.eval.models.messages import PolicyLimits
from schemas.config import CorrectionConfig
from schemas.errors import UsageError
from schemas.job import Job
from schemas.terms import ExpertName
from tests.builders.bundle import job_for
from workers.geometry.slew import Twist
from workers.sim.correct import PolicyError, PolicyUnavailable

SOURCE = """
class Drives:
    def reset(self, instruction, info): self.said = instruction
    def act(self, observation): return [[0.5, 0.1], [9.0, -9.0]]
class Raises(Drives):
    def act(self, observation): raise ValueError("no idea")
class Nan(Drives):
    def act(self, observation): return [float("nan"), 0.0]
class Shape(Drives):
    def act(self, observation): return [1.0, 2.0, 3.0]
class FailsAtReset(Drives):
    def reset(self, instruction, info): raise RuntimeError("not ready")
"""
TRACK = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])


@pytest.fixture
def driver(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], EvaluatedPolicy]:
    (tmp_path / "drivers_of_a_test.py").write_text(SOURCE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return lambda name: EvaluatedPolicy(f"drivers_of_a_test:{name}", PolicyLimits(), pytest.fail)


def job_of(driver: EvaluatedPolicy, made_from: str | None = None) -> Job:
    correction = CorrectionConfig(policy="p", made_from=made_from or driver.made_from)
    return job_for(expert=ExpertName.PLANNER, correction=correction)


def test_answers_are_limited_to_the_range_of_the_robot(driver: Callable[[str], EvaluatedPolicy]) -> None:
    policy = driver("Drives")
    job = job_of(policy)
    policy.begin(job, "Go.")
    limits = job.robot.max_speed_mps, -job.robot.max_yaw_rate_rps
    assert policy.act(None, TRACK) == [Twist(0.5, 0.1), Twist(*limits)]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("FailsAtReset", "policy_raised: reset: RuntimeError: not ready"),
        ("Nan", "policy_invalid: expected finite numbers"),
        ("Raises", "policy_raised: act: ValueError: no idea (drivers_of_a_test.py:"),
        ("Shape", "policy_invalid: expected the shape (2,) or (H, 2)"),
    ],
)
def test_a_failure_of_the_policy_has_its_kind_and_its_reason(
    driver: Callable[[str], EvaluatedPolicy], name: str, reason: str
) -> None:
    policy = driver(name)

    def drive() -> None:
        policy.begin(job_of(policy), "Go.")
        policy.act(None, TRACK)  # type: ignore[arg-type]

    with pytest.raises(PolicyError, match="policy_") as caught:
        drive()
    assert reason in str(caught.value)


def test_another_policy_than_that_of_the_round_is_refused_without_blaming_an_episode(
    driver: Callable[[str], EvaluatedPolicy],
) -> None:
    policy = driver("Drives")
    with pytest.raises(PolicyUnavailable, match=f"{policy.made_from[:12]}.*{'0' * 12}: copy the same files"):
        policy.begin(job_of(policy, "0" * 64), "Go.")


@pytest.mark.parametrize("name", ["expert:planner", "planner", "playback", "replay"])
def test_policies_with_nothing_to_correct_are_refused(name: str) -> None:
    with pytest.raises(UsageError, match="nothing to correct"):
        EvaluatedPolicy(name, PolicyLimits(), pytest.fail)

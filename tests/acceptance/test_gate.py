"""`factory gate` from the command line: real attempts, a verdict, and no leftover files."""

from __future__ import annotations

import json

import pytest

PILOT = """
[tiers]
near = 1.0
[splits]
train_id = 1.0
[[scenes]]
name = "hospital"
episodes = 50
"""


def test_gate_passes_a_pilot_that_reaches_the_required_share(factory, tmp_path):
    plan = tmp_path / "pilot.toml"
    plan.write_text(PILOT)
    report = factory.json(*("gate", plan, "--scene", "hospital", "--episodes", 2, "--min-success", 0.5, "--workers", 2))
    assert report["passed"] is True
    assert report["success"]["of"] == report["by_tier"]["near"]["of"] == 2
    assert list(tmp_path.iterdir()) == [plan]


def test_gate_fails_below_the_required_share_and_names_the_reasons(factory, tmp_path):
    plan = tmp_path / "hasty.toml"
    plan.write_text("[task]\nmax_steps = 20\n" + PILOT)
    done = factory("gate", plan, "--scene", "hospital", "--episodes", 2, "--workers", 1, expect=1)
    assert "failures: 2 timeout" in done.stdout
    assert "80 % required" in done.stdout


def test_gate_refuses_a_scene_that_the_plan_does_not_have(command):
    assert "office" in command("gate", "--scene", "garage", expect=2).stderr


SHORT_EPISODES = "[task]\nmax_steps = 20\n[budget]\nattempts_per_draw = 1\ndraws = 1\n" + PILOT.replace("50", "2")
"""Part of a plan with which every attempt times out and is not repeated."""


@pytest.mark.parametrize("verb", [("run", "--workers", 2), ("coordinator", "start", "--listen", "tcp/127.0.0.1:0")])
def test_an_enforced_gate_blocks_a_plan_with_a_low_success_rate(factory, tmp_path, verb):
    plan, root = tmp_path / "hasty.toml", tmp_path / "dataset"
    plan.write_text(SHORT_EPISODES)
    err = factory(*verb, plan, "--out", root, "--gate", "enforce", expect=1).stderr
    assert "2 timeout" in err
    assert "gate failed: less than 80 % of first attempts succeed in hospital" in err
    assert not (root / "dataset_meta.json").exists()
    assert not (root / "ledger.db").exists()


def test_a_gate_in_report_mode_is_recorded_and_not_repeated(factory, tmp_path):
    plan, root = tmp_path / "hasty.toml", tmp_path / "dataset"
    plan.write_text(SHORT_EPISODES)
    factory("run", plan, "--out", root, "--workers", 2, "--gate", "report", expect=1)
    (found,) = json.loads((root / "dataset_meta.json").read_text())["gate"]
    assert (found["scene"], found["attempts"], found["succeeded"], found["passed"]) == ("hospital", 2, 0, False)
    assert found["reasons"] == {"timeout": 2}
    again = factory("run", "--out", root, "--workers", 1, "--gate", "enforce", expect=1)
    assert "first attempts" not in again.stderr
    assert json.loads((root / "dataset_meta.json").read_text())["gate"] == [found]

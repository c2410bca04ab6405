"""`factory gate` as a user runs it: real attempts, a verdict, and nothing left behind."""

from __future__ import annotations

PILOT = """
[tiers]
near = 1.0
[splits]
train_id = 1.0
[[scenes]]
name = "hospital"
episodes = 50
"""


def test_gate_passes_a_pilot_that_reaches_the_share(factory, tmp_path):
    plan = tmp_path / "pilot.toml"
    plan.write_text(PILOT)
    report = factory.json(
        *("gate", "--scene", "hospital", "--plan", plan, "--episodes", 2, "--min-success", 0.5, "--workers", 2)
    )
    assert report["passed"] is True
    assert report["success"]["of"] == report["by_tier"]["near"]["of"] == 2
    assert list(tmp_path.iterdir()) == [plan]


def test_gate_fails_under_the_share_and_names_the_reasons(factory, tmp_path):
    plan = tmp_path / "hasty.toml"
    plan.write_text("[task]\nmax_steps = 20\n" + PILOT)
    done = factory("gate", "--scene", "hospital", "--plan", plan, "--episodes", 2, "--workers", 1, expect=1)
    assert "failed by: 2 timeout" in done.stdout
    assert "80 % of first attempts asked for" in done.stdout


def test_gate_refuses_a_scene_that_the_plan_does_not_have(factory):
    assert "office" in factory("gate", "--scene", "garage", expect=2).stderr

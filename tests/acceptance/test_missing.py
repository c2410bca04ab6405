"""A finished run with missing episodes ends with exit code 1 and the reason, whatever command runs it."""

from __future__ import annotations

from pathlib import Path

from tests.acceptance.factory_cli import Command, FactoryCli, wait_for

ENDPOINT = ("--listen", "tcp/127.0.0.1:0")


def test_missing_episodes_end_a_run_with_exit_code_1_and_the_reason(
    factory: FactoryCli, command: Command, plan: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    hub = factory.start("coordinator", "start", plan, "--out", out, *ENDPOINT)
    wait_for((out / ".coordinator.json").exists, 400)  # it builds the scenes first
    command("jobs", "cancel", out, "--all")
    _, said = hub.communicate(timeout=120)
    assert hub.returncode == 1
    assert "5 of 5 episodes are missing (5 cancelled)" in said
    assert f"factory jobs list {out} --state cancelled" in said
    for words in (("run", "--out", out), ("coordinator", "start", "--out", out, *ENDPOINT)):
        assert "5 of 5 episodes are missing" in factory(*words, expect=1).stderr


def test_a_complete_run_ends_with_exit_code_0(factory: FactoryCli, reference_copy: Path) -> None:
    assert "missing" not in factory("coordinator", "start", "--out", reference_copy, *ENDPOINT).stderr

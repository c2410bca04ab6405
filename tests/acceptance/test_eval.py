"""`factory eval` from the command line: tables, files, resuming, and errors."""

from __future__ import annotations

import json
import shutil
import signal
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.acceptance.factory_cli import Command, FactoryCli, wait_for


@pytest.fixture(scope="module")
def out(factory: FactoryCli, command: Command, drives: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of `replay` and `stop` on two episodes."""
    folder = tmp_path_factory.mktemp("eval") / "out"
    specs = folder.parent / "specs.json"
    command("eval", "specs", drives, "--split", "all", "--episodes", 2, "-o", specs)
    shorten(specs, 50)
    words = ("eval", drives, "--specs", specs, "--policy", "replay", "--policy", "stop", "-o", folder)
    found = factory(*words, "--videos", "1", "--workers", 2)
    assert "replay" in found.stdout
    assert "By split" in found.stdout
    return folder


def shorten(path: Path, steps: int) -> None:
    """Lowers the step limit in a spec file to save time."""
    data = json.loads(path.read_text())
    data["settings"]["task"]["max_steps"] = steps
    path.write_text(json.dumps(data))


def test_replay_succeeds_in_every_episode_and_stop_in_none(out: Path) -> None:
    results = json.loads((out / "results.json").read_text())
    replay, stop = results["policies"]
    assert results["complete"] is True
    assert (replay["overall"]["success"]["count"], replay["overall"]["n"]) == (2, 2)
    assert stop["overall"]["success"]["count"] == 0
    assert {group["group"] for group in replay["groups"] if group["by"] == "split"} == {"train_id", "test_id"}


def test_the_result_files_have_the_expected_content(out: Path) -> None:
    table = pq.read_table(out / "episodes.parquet")
    assert table.num_rows == 4
    assert {"spec_id", "policy", "success", "spl", "final_ne_m", "track_x_m"} <= set(table.column_names)
    page = (out / "index.html").read_text()
    assert page.count("<video controls") == page.count("data:video/mp4;base64,") == 2  # a failure, and a pair
    assert page.count("data:image/jpeg;base64,") == 2
    assert "http" not in page.replace("http-equiv", "")
    assert "Failures of stop" in page


def test_the_page_is_rewritten_byte_for_byte(command: Command, drives: Path, out: Path) -> None:
    before = (out / "index.html").read_bytes()
    shutil.rmtree(out / "policies" / "stop" / "videos")
    specs = out.parent / "specs.json"
    words = ("eval", drives, "--specs", specs, "--policy", "replay", "--policy", "stop", "-o", out)
    command(*words, "--videos", "1")
    assert (out / "index.html").read_bytes() == before


def test_a_repeated_command_runs_no_episode_twice(command: Command, drives: Path, out: Path) -> None:
    before = {path: path.read_bytes() for path in out.rglob("episodes.jsonl")}
    specs = out.parent / "specs.json"
    found = command.json("eval", drives, "--specs", specs, "--policy", "replay", "--policy", "stop", "-o", out)
    assert found["policies"][0]["overall"]["success"]["count"] == 2
    assert {path: path.read_bytes() for path in out.rglob("episodes.jsonl")} == before


def test_two_policies_are_compared_by_paired_episodes(command: Command, out: Path) -> None:
    found = command.json("eval", "compare", out / "policies" / "stop", out / "policies" / "replay")
    assert (found["pairs"], found["only_second"], found["only_first"]) == (2, 2, 0)
    assert found["success_difference"]["mean"] == 1.0
    assert found["p"] == pytest.approx(2 * 0.5**2)


def test_ctrl_c_keeps_finished_episodes(factory: FactoryCli, drives: Path, out: Path, tmp_path: Path) -> None:
    slow = "tests.builders.policies:Slow"  # slow, so the second episode still runs when the first is written
    words = (drives, "--specs", out.parent / "specs.json", "--policy", slow, "--workers", 1)
    process = factory.start("eval", *words, "-o", tmp_path / "out")
    wait_for(lambda: any(log.stat().st_size for log in tmp_path.rglob("episodes.jsonl")))
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "run the same command again to continue" in err
    (log,) = tmp_path.rglob("episodes.jsonl")
    assert log.read_bytes().count(b"\n") == 1
    assert log.read_bytes().endswith(b"\n")


def test_the_error_of_a_failing_policy_is_quoted_and_the_policy_can_be_run_again(
    command: Command, drives: Path, out: Path, tmp_path: Path
) -> None:
    specs = out.parent / "specs.json"
    words = ("eval", drives, "--specs", specs, "--policy", "tests.builders.policies:Raises", "--videos", 0)
    first = command(*words, "-o", tmp_path / "out", expect=1)
    assert "2 of 2 episodes ended with policy_raised" in first.stdout
    assert "KeyError: 'depth_front' (policies.py:" in first.stdout
    assert "had a fault in every episode, so it was not evaluated" in first.stderr
    (log,) = tmp_path.rglob("episodes.jsonl")
    assert "to evaluate a corrected policy, add --restart" in first.stderr
    (policy,) = command.json(*words, "-o", tmp_path / "out", "--restart", expect=1)["policies"]
    assert (tmp_path / "out/former" / f"{log.parent.name}-1" / log.name).exists()
    assert [(fault["end"], fault["drives"]) for fault in policy["faults"]] == [("policy_raised", 2)]
    assert log.read_bytes().count(b"\n") == 2


def test_unfiltered_starts_are_written_as_a_spec_file(command: Command, drives: Path, tmp_path: Path) -> None:
    path = tmp_path / "u.json"
    found = command.json("eval", "specs", drives, "--split", "all", "--unfiltered", "--episodes", 2, "-o", path)
    assert (found["episodes"], found["starts"]) == (2, {"drawn": 2})

"""`factory eval` as a user runs it: tables, files, resuming, and what it says when it cannot."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.acceptance.factory_cli import FactoryCli, wait_for

EXAMPLES = Path(__file__).parent.parent.parent / "docs" / "evaluation"


@pytest.fixture(scope="module")
def out(factory: FactoryCli, calm: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Replay and a stop over all episodes of the calm dataset, kept."""
    folder = tmp_path_factory.mktemp("eval") / "out"
    specs = folder.parent / "specs.json"
    factory("eval", "specs", calm, "--split", "all", "-o", specs)
    shorten(specs, 200)
    words = ("eval", "--data", calm, "--specs", specs, "--policy", "replay", "--policy", "stop", "-o", folder)
    found = factory(*words, "--videos", "1", "--workers", 2)
    assert "replay" in found.stdout
    assert "By split" in found.stdout
    return folder


def shorten(path: Path, steps: int) -> None:
    """Lowers the limit of steps in a file of specs; the CPU of the tests is not free."""
    data = json.loads(path.read_text())
    data["settings"]["task"]["max_steps"] = steps
    path.write_text(json.dumps(data))


def test_replay_succeeds_everywhere_and_stop_nowhere(out: Path) -> None:
    results = json.loads((out / "results.json").read_text())
    replay, stop = results["policies"]
    assert results["complete"] is True
    assert (replay["overall"]["success"]["count"], replay["overall"]["n"]) == (5, 5)
    assert stop["overall"]["success"]["count"] == 0
    assert {group["group"] for group in replay["groups"] if group["by"] == "split"} == {"train_id", "test_ood_obj"}


def test_the_files_are_what_they_are_called(out: Path) -> None:
    table = pq.read_table(out / "episodes.parquet")
    assert table.num_rows == 10
    assert {"spec_id", "policy", "success", "spl", "final_ne_m", "track_x_m"} <= set(table.column_names)
    page = (out / "index.html").read_text()
    assert page.count("data:image/webp;base64,") == 1
    assert "http" not in page.replace("http-equiv", "")
    assert "Failures of stop" in page


def test_the_same_command_drives_nothing_twice(factory: FactoryCli, calm: Path, out: Path) -> None:
    before = {path: path.read_bytes() for path in out.rglob("episodes.jsonl")}
    specs = out.parent / "specs.json"
    found = factory.json("eval", "--data", calm, "--specs", specs, "--policy", "replay", "--policy", "stop", "-o", out)
    assert found["policies"][0]["overall"]["success"]["count"] == 5
    assert {path: path.read_bytes() for path in out.rglob("episodes.jsonl")} == before


def test_two_policies_are_compared_pair_by_pair(factory: FactoryCli, out: Path) -> None:
    found = factory.json("eval", "compare", out / "policies" / "stop", out / "policies" / "replay")
    assert (found["pairs"], found["only_second"], found["only_first"]) == (5, 5, 0)
    assert found["success_difference"]["mean"] == 1.0
    assert found["p"] == pytest.approx(2 * 0.5**5)
    said = factory("eval", "compare", out, out, expect=2).stderr
    assert "holds 2 policies" in said


def test_ctrl_c_keeps_what_is_done(factory: FactoryCli, calm: Path, out: Path, tmp_path: Path) -> None:
    words = ("--data", calm, "--specs", out.parent / "specs.json", "--policy", "stop", "--workers", 1)
    process = factory.start("eval", *words, "-o", tmp_path / "out")
    log = tmp_path / "out" / "policies" / "stop" / "episodes.jsonl"
    wait_for(lambda: log.exists() and log.stat().st_size > 0)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "run the same command to go on" in err
    assert log.read_bytes().endswith(b"\n")


def test_the_example_server_drives_over_loopback(factory: FactoryCli, calm: Path, out: Path) -> None:
    process = subprocess.Popen([sys.executable, EXAMPLES / "policy_server.py", "0"], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        address = process.stdout.readline().split()[-1]
        words = ("--data", calm, "--specs", out.parent / "specs.json", "--policy", address, "--episodes", 2)
        found = factory.json("eval", *words)
    finally:
        process.kill()
        process.communicate()
    (policy,) = found["policies"]
    assert policy["overall"]["policy_failure"]["count"] == 0, policy["ends"]
    assert policy["overall"]["trajectory_length_m"]["mean"] > 0.2


def test_the_example_class_drives_in_process(factory: FactoryCli, calm: Path, out: Path, tmp_path: Path) -> None:
    # an own policy need not be installed: the working directory is enough
    shutil.copy(EXAMPLES / "my_policy.py", tmp_path)
    words = ("--data", calm, "--specs", out.parent / "specs.json", "--policy", "my_policy:TowardsOpenFloor")
    environment = {**os.environ, "MINIVLA_CACHE": str(tmp_path / "cache")}
    found = subprocess.run(
        [sys.executable, "-m", "factory", "eval", *map(str, words), "--episodes", "1", "--json"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert found.returncode == 0, found.stderr
    assert json.loads(found.stdout)["policies"][0]["overall"]["policy_failure"]["count"] == 0


def test_unfiltered_starts_are_a_file_of_specs(factory: FactoryCli, calm: Path, tmp_path: Path) -> None:
    path = tmp_path / "u.json"
    found = factory.json("eval", "specs", calm, "--split", "all", "--unfiltered", "--episodes", 4, "-o", path)
    assert (found["episodes"], found["starts"]) == (4, {"drawn": 4})
    said = factory("eval", "--data", calm, "--specs", path, "--policy", "replay", expect=2).stderr
    assert "freshly drawn" in said


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ((), 2, "give the dataset and a policy"),
        (("--split", "test"), 2, "no split test"),
        (("--split", "val_id", "--policy", "stop"), 2, "no episodes in val_id; splits with episodes: test_ood_obj"),
        (("--policy", "oracle"), 2, "no policy 'oracle'; there are expert"),
        (("--policy", "expert:best"), 2, "no expert 'best'"),
        (("--policy", "nowhere.to:Go"), 2, "No module named 'nowhere'"),
        (("--policy", "ws://127.0.0.1:9", "--split", "all", "--load-timeout", "1"), 1, "no policy server"),
        (("--policy", "stop", "--specs", "/nowhere.json"), 2, "factory eval specs"),
    ],
)
def test_mistakes_are_named(factory: FactoryCli, calm: Path, words: tuple[str, ...], code: int, said: str) -> None:
    found = factory("eval", "--data", calm, *words, expect=code)
    assert said in found.stderr
    assert "Traceback" not in found.stderr


def test_a_directory_that_is_no_dataset_is_named(factory: FactoryCli, tmp_path: Path) -> None:
    assert "holds no dataset" in factory("eval", "--data", tmp_path, "--policy", "stop", expect=1).stderr

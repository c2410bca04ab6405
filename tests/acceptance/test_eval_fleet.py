"""`factory eval --listen`: an evaluation on workers that are killed has the same results as one on a single machine."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.acceptance.factory_cli import Command, FactoryCli, kill_group, wait_for
from tests.builders.ports import free_endpoint

SLOW = "tests.builders.policies:Slow"  # evaluated last, so the coordinator is killed before the end
POLICIES = ("expert", "replay", "random", SLOW)


@pytest.fixture(scope="module")
def specs(command: Command, drives: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Spec file of the two episodes of `drives`, with a low step limit."""
    path = tmp_path_factory.mktemp("specs") / "specs.json"
    command("eval", "specs", drives, "--split", "all", "-o", path)
    data = json.loads(path.read_text())
    data["settings"]["task"]["max_steps"] = 20
    path.write_text(json.dumps(data))
    return path


@pytest.fixture
def endpoint() -> str:
    """A fixed address, at which the evaluation can be restarted."""
    return free_endpoint()


def rows_in(out: Path) -> Iterator[dict[str, Any]]:
    """Yields the results of the finished episodes without their wall times."""
    for log in sorted(out.glob("policies/*/episodes.jsonl")):
        for line in log.read_bytes().splitlines(keepends=True):
            if line.endswith(b"\n"):
                yield {name: value for name, value in json.loads(line).items() if name not in {"act_ms", "seconds"}}


def by_name(out: Path) -> dict[tuple[str, str], dict[str, Any]]:
    """Returns the results by policy and spec; each pair must occur only once."""
    rows = list(rows_in(out))
    found = {(row["policy"], row["spec_id"]): row for row in rows}
    assert len(found) == len(rows)
    return found


@pytest.mark.slow
def test_kills_of_workers_and_coordinators_neither_lose_nor_duplicate_episodes(
    factory: FactoryCli, drives: Path, specs: Path, endpoint: str, tmp_path: Path
) -> None:
    words: tuple[object, ...] = ("eval", drives, "--specs", specs, "--videos", 0)
    words += tuple(word for policy in POLICIES for word in ("--policy", policy))
    worker: tuple[object, ...] = ("worker", "--cores", 1, "--connect", endpoint, "--spool", tmp_path / "spool")
    worker += ("--connect-timeout", 120, "--import-policies")
    out, reference = tmp_path / "fleet", tmp_path / "reference"

    run = factory.start(*words, "--listen", endpoint, "-o", out)
    first = factory.start(*worker)
    wait_for(lambda: len(list(rows_in(out))) >= 1)
    kill_group(first)
    second = factory.start(*worker)
    wait_for(lambda: len(list(rows_in(out))) >= 2)
    kill_group(run)
    assert len(list(rows_in(out))) < 8
    run = factory.start(*words, "--listen", endpoint, "-o", out)
    said, log = run.communicate(timeout=240)
    assert run.returncode == 0, log
    assert "All episodes" in said
    assert second.wait(60) == 0  # the evaluation has told the worker that it has ended
    factory(*words, "--workers", 1, "-o", reference)

    assert by_name(out) == by_name(reference)
    assert len(by_name(out)) == 8
    assert [path.name for path in sorted(out.iterdir())] == [path.name for path in sorted(reference.iterdir())]


def test_a_policy_that_no_worker_can_construct_ends_the_evaluation_with_the_reason(
    factory: FactoryCli, drives: Path, specs: Path, endpoint: str, tmp_path: Path
) -> None:
    words = ("eval", drives, "--specs", specs, "--episodes", 1, "--policy", "nowhere.to_be:Found")
    run = factory.start(*words, "--listen", endpoint, "-o", tmp_path / "out")
    factory.start(
        "worker", "--import-policies", "--connect", endpoint, "--spool", tmp_path / "spool", "--connect-timeout", 120
    )
    _, log = run.communicate(timeout=240)
    assert run.returncode == 1
    assert "no module 'nowhere'; looked in" in log
    assert "run the same command again" in log

"""`factory submit slurm` with a stub of sbatch: the run folder, and that a refused run leaves no files."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from tests.acceptance.factory_cli import Command, FactoryCli

_SBATCH = """#!/bin/bash
if grep -q partition=cpu "${@: -1}"; then echo 7; else echo "no such partition" >&2; exit 1; fi
"""


@pytest.fixture
def site(cache: Path, tmp_path: Path, plan: Path) -> Command:
    """The commands on a login node where Slurm accepts only the partition `cpu`."""
    (tmp_path / "bin").mkdir()
    sbatch = tmp_path / "bin" / "sbatch"
    sbatch.write_text(_SBATCH)
    sbatch.chmod(0o755)
    return Command(cache, {"PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}"})


@pytest.mark.parametrize("mode", ["shards", "workers"])
def test_a_refused_run_leaves_nothing_so_that_the_command_can_be_repeated(
    site: Command, plan: Path, tmp_path: Path, mode: str
) -> None:
    command = ("submit", "slurm", plan, "--out", tmp_path / "run", "--tasks", 2, "--mode", mode)
    refused = site(*command, "--partition", "gpu", expect=1)
    assert "no such partition" in refused.stderr
    assert not (tmp_path / "run").exists()
    (tmp_path / "run").mkdir()
    foreign = site(*command, "--partition", "cpu", expect=2)
    assert "run exists: choose another --out" in foreign.stderr
    assert "sbatch" not in foreign.stderr
    (tmp_path / "run").rmdir()
    submitted = site.json(*command, "--partition", "cpu")
    assert set(submitted["jobs"].values()) == {7}
    assert all(Path(script).is_file() for script in submitted["scripts"])
    again = site(*command, "--partition", "cpu", expect=2)
    assert "exists: choose another --out, or continue its run with" in again.stderr
    command_again = again.stderr.split("`")[1]
    env = {**os.environ, "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}"}
    done = subprocess.run(["bash", "-c", command_again], env=env, capture_output=True, text=True, check=True)
    assert done.stdout == "7\n"
    assert (f"--dependency={'afterany' if mode == 'shards' else 'after'}:") in command_again


def test_commands_accept_the_folder_of_a_submitted_run_or_suggest_what_to_give(
    site: Command, factory: FactoryCli, plan: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    site("submit", "slurm", plan, "--out", run, "--tasks", 2, "--partition", "cpu")
    assert "no task of" in site("status", run, expect=1).stderr
    assert f"give {run / 'dataset'}" in site("stats", run, expect=1).stderr
    assert f"factory status {run}" in site("verify", run / "dataset", expect=1).stderr
    shard = ("--shard", "1/2", "--scenes", run / "scenes", "--out", run / "shards" / "1", "--gate", "skip")
    factory("run", run / "slurm" / "plan.toml", *shard, "--workers", 1)
    assert [one["finished"] for one in site.json("status", run)["shards"]] == [True]

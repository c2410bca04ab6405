"""Executes docs/tutorial.md: its plan and its commands, with fewer episodes and one epoch."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.builders.needs_torch import needs_torch
from tests.builders.pages import ROOT, blocks, factory_lines

PAGE = ROOT / "docs" / "tutorial.md"
SMALLER = {"12": "1", "80": "64"}
"""Options whose values are reduced: epochs and the size of the input."""


@needs_torch
@pytest.mark.slow
@pytest.mark.gl
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::UserWarning:torch")
def test_the_tutorial_ends_with_an_evaluated_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cache: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINIVLA_CACHE", str(cache))
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    (plan,) = blocks(PAGE, "toml")
    Path("hour.toml").write_text(plan.replace("episodes = 300", "episodes = 10"))
    verbs = []
    for words in factory_lines(PAGE):
        command = [sys.executable, "-m", "factory", *(SMALLER.get(word, word) for word in words)]
        done = subprocess.run(command, capture_output=True, text=True)  # torch and OpenGL crash in one process
        assert done.returncode == 0, f"{words}: {done.stdout} {done.stderr}"
        verbs.append(words[0])
    assert verbs == ["plan", "run", "stats", "show", "train", "eval", "eval"]
    assert Path("drive.mp4").stat().st_size > 10_000
    results = json.loads(Path("results/results.json").read_text())
    assert {row["policy"] for row in results["policies"]} == {"bc:policy", "expert", "random"}

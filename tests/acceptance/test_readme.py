"""The 60-second example of the README runs unchanged."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.acceptance.factory_cli import FactoryCli
from tests.builders.pages import ROOT, blocks, factory_lines


@pytest.fixture
def section(tmp_path: Path) -> Path:
    """A Markdown file that contains only the example."""
    found = re.search(r"^## Sixty seconds\n.*?(?=^## )", (ROOT / "README.md").read_text(), re.DOTALL | re.MULTILINE)
    assert found is not None
    page = tmp_path / "example.md"
    page.write_text(found.group())
    return page


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_sixty_second_example_runs(
    factory: FactoryCli, section: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (setup,) = blocks(section)
    assert setup.startswith("make setup")
    lines = list(factory_lines(section))
    assert [words[0] for words in lines] == ["run", "show", "replay"]
    for words in lines:
        factory(*words)
    assert (tmp_path / "robot.mp4").stat().st_size > 0
    (code,) = blocks(section, "python")
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("(640, 640, 3)") == 4

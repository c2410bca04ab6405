"""A package that is missing is told before anything is read, made or started."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from factory.cli.main import cli
from factory.torch_dataset import collate
from schemas.errors import UsageError
from tests.builders.dataset import make_dataset

ROOT = Path(__file__).parents[3]
WANTED = [
    ("rerun", ("view", "DATA", "1"), r"minivla-factory\[view\]"),
    ("torch", ("eval", "--data", "DATA", "--policy", "bc:nowhere", "-o", "OUT"), r"minivla-factory\[train\]"),
    ("torch", ("train", "bc", "--data", "DATA", "-o", "OUT"), r"minivla-factory\[train\]"),
]


def test_collating_without_torch_names_the_extra() -> None:
    if importlib.util.find_spec("torch") is not None:
        pytest.skip("torch is installed here")
    with pytest.raises(UsageError, match=r"pip install 'minivla-factory\[train\]'"):
        collate([])


@pytest.mark.parametrize(("module", "words", "said"), WANTED, ids=[words[0] for _, words, _ in WANTED])
def test_a_verb_that_lacks_its_package_makes_nothing(
    tmp_path: Path, module: str, words: tuple[str, ...], said: str
) -> None:
    if importlib.util.find_spec(module) is not None:
        pytest.skip(f"{module} is installed here")
    make_dataset(tmp_path / "data")
    before = sorted(tmp_path.iterdir())
    places = {"DATA": str(tmp_path / "data"), "OUT": str(tmp_path / "out")}
    with pytest.raises(UsageError, match=said):
        cli.main([places.get(word, word) for word in words], standalone_mode=False)
    assert sorted(tmp_path.iterdir()) == before


def run_without(module: str, *words: object) -> subprocess.CompletedProcess[str]:
    """Runs `factory` in a process that cannot import a module."""
    code = f"import sys; sys.modules['{module}'] = None; from factory.cli.main import main; main()"
    call = [sys.executable, "-c", code, *map(str, words)]
    return subprocess.run(call, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("module", ["av", "jinja2"])
def test_an_evaluation_that_cannot_write_its_page_drives_nothing(tmp_path: Path, module: str) -> None:
    make_dataset(tmp_path / "data")
    words = ("eval", "--data", tmp_path / "data", "--policy", "stop", "--split", "all")
    refused = run_without(module, *words, "-o", tmp_path / "out")
    assert refused.returncode == 2
    assert "pip install 'minivla-factory[eval]'" in refused.stderr
    assert not (tmp_path / "out").exists()


def test_films_are_the_only_thing_that_an_evaluation_needs_pyav_for(tmp_path: Path) -> None:
    make_dataset(tmp_path / "data")
    words = ("eval", "--data", tmp_path / "data", "--policy", "nothing_here", "-o", tmp_path / "out", "--videos", 0)
    refused = run_without("av", *words)
    assert "nothing_here" in refused.stderr
    assert "minivla-factory[eval]" not in refused.stderr


def test_every_extra_that_a_message_or_a_page_names_exists() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    sources = [path for part in ("factory", "coordinator", "workers", "docs") for path in (ROOT / part).rglob("*.*")]
    texts = [path.read_text() for path in (*sources, ROOT / "README.md") if path.suffix in {".py", ".md"}]
    named = {name for text in texts for name in re.findall(r"minivla-factory\[([a-z-]+)\]", text)}
    assert {"train", "view"} <= named <= set(declared)


def test_setting_up_ends_with_the_next_command() -> None:
    own = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    words = ("make", "--dry-run", "setup")
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True, env=own)
    assert "make run" in done.stdout.splitlines()[-1]

"""A missing package is reported before any file is read or written."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

from factory.cli.main import cli
from factory.dataset.torch import collate
from schemas.errors import UsageError
from schemas.support.extras import install_command
from tests.builders.dataset import make_dataset

ROOT = Path(__file__).parents[4]
WANTED = [
    ("rerun", ("view", "DATA", "1"), "view"),
    ("torch", ("eval", "DATA", "--policy", "bc:nowhere", "-o", "OUT"), "train"),
    ("torch", ("train", "bc", "DATA", "-o", "OUT"), "train"),
]


def test_the_error_of_collation_without_torch_names_the_extra() -> None:
    if importlib.util.find_spec("torch") is not None:
        pytest.skip("torch is installed here")
    with pytest.raises(UsageError, match=re.escape(install_command("train"))):
        collate([])


@pytest.mark.parametrize(("module", "words", "extra"), WANTED, ids=[words[0] for _, words, _ in WANTED])
def test_a_command_with_a_missing_package_writes_nothing(
    tmp_path: Path, module: str, words: tuple[str, ...], extra: str
) -> None:
    if importlib.util.find_spec(module) is not None:
        pytest.skip(f"{module} is installed here")
    make_dataset(tmp_path / "data")
    before = sorted(tmp_path.iterdir())
    places = {"DATA": str(tmp_path / "data"), "OUT": str(tmp_path / "out")}
    with pytest.raises(UsageError, match=re.escape(install_command(extra))):
        cli.main([places.get(word, word) for word in words], standalone_mode=False)
    assert sorted(tmp_path.iterdir()) == before


def test_each_extra_that_a_page_names_exists() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    pages = [*(ROOT / "docs").rglob("*.md"), *(ROOT / "deploy").rglob("*.md"), ROOT / "README.md"]
    named = {name for page in pages for name in re.findall(r"'\.\[([a-z-]+)\]'", page.read_text())}
    assert {"sim", "eval", "train"} <= named <= set(declared)


@pytest.mark.parametrize(("target", "next_command"), [("setup", "make run"), ("run", "factory serve dataset")])
def test_make_prints_the_next_command(target: str, next_command: str) -> None:
    own = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    words = ("make", "--dry-run", target)
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True, env=own)
    assert next_command in done.stdout.splitlines()[-1]

"""A package that is missing is told before anything is read, made or started."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from factory.cli.main import cli
from schemas.errors import UsageError
from tests.builders.dataset import make_dataset

WANTED = [
    ("rerun", ("view", "DATA", "1"), r"minivla-factory\[view\]"),
    ("torch", ("eval", "--data", "DATA", "--policy", "bc:nowhere", "-o", "OUT"), r"minivla-factory\[train\]"),
    ("torch", ("train", "bc", "--data", "DATA", "-o", "OUT"), r"minivla-factory\[train\]"),
]


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

"""One calm dataset for all acceptance tests, and the command line that made it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.acceptance.factory_cli import TINY_PLAN, FactoryCli
from tests.builders.evaluation import archive_drives
from tests.builders.shared import build_once


@pytest.fixture(scope="session")
def factory(tmp_path_factory: pytest.TempPathFactory, cache: Path) -> Iterator[FactoryCli]:
    cli = FactoryCli(tmp_path_factory.mktemp("empty-home"), cache)
    yield cli
    cli.end()


@pytest.fixture(scope="session")
def plan(factory: FactoryCli, shared: Path) -> Path:
    """A small plan, whose scenes are compiled by the first process that asks for it."""

    def build(folder: Path) -> None:
        folder.mkdir()
        (folder / "tiny.toml").write_text(TINY_PLAN)
        factory("plan", "nearest", folder / "tiny.toml")

    return build_once(shared / "plan", build) / "tiny.toml"


@pytest.fixture(scope="session")
def calm(factory: FactoryCli, plan: Path, shared: Path) -> Path:
    """A dataset made by one worker that nobody disturbed; shared by all processes, so that no test may change it."""
    return build_once(shared / "calm", lambda root: factory("run", plan, "--out", root, "--workers", 1))


@pytest.fixture
def own_calm(calm: Path, tmp_path: Path) -> Path:
    """A copy of it, for a test that starts a coordinator there."""
    return Path(shutil.copytree(calm, tmp_path / "calm"))


@pytest.fixture(scope="session")
def drives(shared: Path) -> Path:
    """A dataset of two drives in a room of boxes; no test changes it."""
    return build_once(shared / "drives-2", lambda root: archive_drives(root, episodes=2))

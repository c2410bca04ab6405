"""One calm dataset for all acceptance tests, and the command line that made it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.acceptance.factory_cli import TINY_PLAN, FactoryCli


@pytest.fixture(scope="session")
def factory(tmp_path_factory: pytest.TempPathFactory, scene_cache: Path) -> Iterator[FactoryCli]:
    cli = FactoryCli(tmp_path_factory.mktemp("empty-home"), scene_cache.parent / "cache")
    yield cli
    cli.end()


@pytest.fixture(scope="session")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plan") / "tiny.toml"
    path.write_text(TINY_PLAN)
    return path


@pytest.fixture(scope="session")
def calm(factory: FactoryCli, plan: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset made by one worker that nobody disturbed."""
    root = tmp_path_factory.mktemp("calm") / "dataset"
    factory("run", plan, "--out", root, "--workers", 1)
    return root

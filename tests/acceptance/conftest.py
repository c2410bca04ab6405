"""Shared datasets for the acceptance tests."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from schemas.terms import Recording
from tests.acceptance.factory_cli import TINY_PLAN, FactoryCli
from tests.builders.driven import driven_recordings
from tests.builders.evaluation import archive_drives
from tests.builders.shared import build_once


@pytest.fixture(scope="session")
def plan(factory: FactoryCli, shared: Path) -> Path:
    """A small plan; the first process that requests it compiles the scenes."""

    def build(folder: Path) -> None:
        folder.mkdir()
        (folder / "tiny.toml").write_text(TINY_PLAN)
        factory("plan", "nearest", folder / "tiny.toml")

    return build_once(shared / "plan", build) / "tiny.toml"


@pytest.fixture(scope="session")
def reference(factory: FactoryCli, plan: Path, shared: Path) -> Path:
    """A dataset of one undisturbed worker, shared by all processes; tests only read it."""
    return build_once(shared / "reference", lambda root: factory.fresh("run", plan, "--out", root, "--workers", 1))


@pytest.fixture(scope="session")
def states(factory: FactoryCli, plan: Path, shared: Path) -> Path:
    """The states recording of the plan of `reference`; tests only read it."""
    words = ("--record", "states", "--workers", 1)
    return build_once(shared / "reference-states", lambda root: factory("run", plan, "--out", root, *words))


@pytest.fixture
def reference_copy(reference: Path, tmp_path: Path) -> Path:
    """A copy for tests that start a coordinator on it."""
    return Path(shutil.copytree(reference, tmp_path / "reference"))


@pytest.fixture(scope="session")
def recordings(shared: Path) -> dict[Recording, Path]:
    """The same two drives, recorded as frames and as states; tests only read them. Needs an EGL driver."""
    return driven_recordings(shared)


@pytest.fixture(scope="session")
def drives(shared: Path) -> Path:
    """A dataset of two episodes in a room of boxes; tests only read it."""
    return build_once(shared / "drives-2", lambda root: archive_drives(root, episodes=2))

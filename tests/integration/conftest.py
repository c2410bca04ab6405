"""Small real datasets for the tests of evaluation and of recordings."""

from __future__ import annotations

import functools
from pathlib import Path

import pytest

from factory.dataset.reader import Dataset
from schemas.terms import Recording
from tests.acceptance.factory_cli import FactoryCli
from tests.builders.driven import driven_recordings
from tests.builders.evaluation import archive_drives
from tests.builders.rigs import render_rigged
from tests.builders.shared import build_once


@pytest.fixture(scope="session")
def drives(shared: Path) -> Dataset:
    """Three archived episodes in the room of boxes: one for training, two for testing; tests only read them."""
    return Dataset(build_once(shared / "drives-3", archive_drives))


@pytest.fixture(scope="session")
def recordings(shared: Path) -> dict[Recording, Path]:
    """The same two drives, recorded as frames and as states; tests only read them. Needs an EGL driver."""
    return driven_recordings(shared)


@pytest.fixture(scope="session")
def rigged(factory: FactoryCli, shared: Path, recordings: dict[Recording, Path]) -> Path:
    """The two drives of `recordings` with the measurements of a small rig; tests only read them."""
    build = functools.partial(render_rigged, states=recordings[Recording.STATES], factory=factory)
    return build_once(shared / "driven-rigged", build)

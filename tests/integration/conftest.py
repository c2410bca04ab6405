"""A small real dataset for the tests of evaluation."""

from __future__ import annotations

from pathlib import Path

import pytest

from factory.dataset.reader import Dataset
from tests.builders.evaluation import archive_drives
from tests.builders.shared import build_once


@pytest.fixture(scope="session")
def drives(shared: Path) -> Dataset:
    """Three archived episodes in the room of boxes: one for training, two for testing; tests only read them."""
    return Dataset(build_once(shared / "drives-3", archive_drives))

"""One small real dataset for all tests of evaluation."""

from __future__ import annotations

from pathlib import Path

import pytest

from factory.dataset.reader import Dataset
from tests.builders.evaluation import archive_drives
from tests.builders.shared import build_once


@pytest.fixture(scope="session")
def drives(shared: Path) -> Dataset:
    """Three archived drives in the room of boxes: one for training, two for testing; no test changes them."""
    return Dataset(build_once(shared / "drives-3", archive_drives))

"""One small real dataset for all tests of evaluation."""

from __future__ import annotations

import pytest

from factory.dataset.reader import Dataset
from tests.builders.evaluation import archive_drives


@pytest.fixture(scope="session")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Three archived drives in the room of boxes: one for training, two for testing."""
    return Dataset(archive_drives(tmp_path_factory.mktemp("drives") / "dataset"))

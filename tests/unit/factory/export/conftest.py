"""The dataset that the tests of exporters share."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.factory.export.varied import make_varied


@pytest.fixture(scope="session")
def varied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four episodes of three splits, of 12, 15, 13 and 20 steps; no test changes them."""
    root = tmp_path_factory.mktemp("varied") / "data"
    make_varied(root)
    return root

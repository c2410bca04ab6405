"""The dataset that the tests of exporters share."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.builders.shared import build_once
from tests.unit.factory.export.varied import make_varied


@pytest.fixture(scope="session")
def varied(shared: Path) -> Path:
    """Four episodes of three splits, of 12, 15, 13 and 20 steps; tests only read them."""
    return build_once(shared / "varied", make_varied)

"""Runs every parser of external bytes on damaged files for a short time; `make fuzz` runs longer."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzz.campaign import fuzz
from tests.fuzz.targets import TARGETS

COUNT, MOST_S = 300, 4.0


@pytest.mark.parametrize("target", TARGETS)
def test_a_damaged_file_raises_an_error_of_the_product(target: str, tmp_path: Path) -> None:
    found = fuzz(target, tmp_path, seed=20261122, seconds=MOST_S, count=COUNT)
    assert not found, found

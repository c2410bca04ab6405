"""Definitions of the measures that pages show."""

from __future__ import annotations

import pytest

from factory.html.measures import PLACES, define
from schemas.terms import SuccessMeasure


@pytest.mark.parametrize("success", list(SuccessMeasure))
def test_the_error_to_each_part_of_the_target_has_its_own_definition(success: SuccessMeasure) -> None:
    title = f"NE to the {PLACES[success]}"
    assert f"to the {PLACES[success]} of the target" in define(f"{title}, m")
    assert define(f"{title}, m") == define(title) != define("NE, m")


def test_a_title_that_only_contains_the_name_of_a_measure_has_no_definition() -> None:
    assert define("SR, %").startswith("success rate")
    assert [define(title) for title in ("", "NEAR", "episode", "mean NE", "SPLIT")] == [""] * 5

"""Values of the options of `factory scene`."""

from __future__ import annotations

import click
import pytest

from factory.cli.scene import UnitType


@pytest.mark.parametrize(("text", "unit"), [("cm", "cm"), ("0.56", 0.56), ("1e-3", 1e-3)])
def test_a_unit_is_a_name_or_its_length_in_metres(text: str, unit: str | float) -> None:
    assert UnitType().convert(text, None, None) == unit


@pytest.mark.parametrize("text", ["km", "0", "-1", "nan", "inf", "1e9", ""])
def test_other_units_are_refused(text: str) -> None:
    with pytest.raises(click.BadParameter, match=r"give m, cm, mm, in, or metres from 1e-06 to 1e\+06"):
        UnitType().convert(text, None, None)

"""The closest name is suggested; nothing is suggested if no name is similar."""

from __future__ import annotations

from schemas.support.suggest import did_you_mean
from schemas.terms import Split


def test_the_closest_name_is_suggested_in_its_exact_spelling() -> None:
    assert did_you_mean("offfice", ["hospital", "office"]) == "; did you mean 'office'?"
    assert did_you_mean("TRAIN-ID", Split) == "; did you mean 'train_id'?"


def test_nothing_is_suggested_without_a_similar_name() -> None:
    assert did_you_mean("oracle", ["hospital", "office"]) == ""
    assert did_you_mean("office", []) == ""

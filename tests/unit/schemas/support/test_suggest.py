"""The nearest name is offered, and none where none is near."""

from __future__ import annotations

from schemas.support.suggest import did_you_mean
from schemas.terms import Split


def test_the_nearest_name_is_offered_as_it_is_spelt() -> None:
    assert did_you_mean("offfice", ["hospital", "office"]) == "; did you mean 'office'?"
    assert did_you_mean("TRAIN-ID", Split) == "; did you mean 'train_id'?"


def test_nothing_is_offered_for_a_word_that_is_like_none() -> None:
    assert did_you_mean("oracle", ["hospital", "office"]) == ""
    assert did_you_mean("office", []) == ""

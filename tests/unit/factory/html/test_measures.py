"""Definitions of the measures that pages show."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from factory.eval.results.page import tables_of
from factory.eval.results.score import MEANS, PolicyScores
from factory.html.measures import DEFINITIONS, PLACES, TITLES, define, definitions_of
from factory.web.pages.episodes import shown_columns
from schemas.terms import SuccessMeasure
from tests.builders.eval_results import evaluation_of


@pytest.mark.parametrize("success", list(SuccessMeasure))
def test_the_error_to_each_part_of_the_target_has_its_own_definition(success: SuccessMeasure) -> None:
    title = f"NE to the {PLACES[success]}"
    assert f"to the {PLACES[success]} of the target" in define(f"{title}, m")
    assert define(f"{title}, m") == define(title) != define("NE, m")


def test_a_title_that_only_contains_the_name_of_a_measure_has_no_definition() -> None:
    assert define("SR, %").startswith("success rate")
    assert [define(title) for title in ("", "NEAR", "episode", "mean NE", "SPLIT")] == [""] * 5


def test_every_measure_of_tables_has_its_unit_and_a_definition() -> None:
    shown = [title for success in SuccessMeasure for _, title in shown_columns(success)[6:]]
    heads = tables_head(evaluation_of("stop").policies)
    for title in (*TITLES.values(), *shown, *(head for head in heads if head not in ("policy", "n"))):
        assert define(title), title
    assert set(TITLES) == {"success", *MEANS}


def test_equal_names_have_equal_definitions_and_no_definition_is_that_of_another_measure() -> None:
    texts = {name: text for name, text in DEFINITIONS.items() if name != "trajectory length"}
    assert DEFINITIONS["trajectory length"] == DEFINITIONS["TL"]  # its title where there is room
    assert len(set(texts.values())) == len(texts)
    assert list(definitions_of(["TL, m", "episode", "TL mean", "NE to the footprint"])) == ["TL", "NE to the footprint"]


def tables_head(policies: Sequence[PolicyScores]) -> Sequence[str]:
    return next(tables_of(policies)).head

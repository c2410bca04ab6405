"""The instruction templates of the paper's Table III."""

from __future__ import annotations

import pytest

from schemas.instruction.templates import (
    OOD_TEMPLATES,
    TEMPLATES,
    TRAIN_TEMPLATES,
    instruction,
    needs_colour,
    say_category,
    templates_for,
)
from schemas.terms import CATEGORIES, Split


def test_there_are_18_training_templates_and_12_paraphrased_templates() -> None:
    assert (len(TRAIN_TEMPLATES), len(OOD_TEMPLATES)) == (18, 12)
    assert len(set(TEMPLATES.values())) == 30


def test_colour_templates_are_those_of_the_paper() -> None:
    coloured = {key for key in TEMPLATES if needs_colour(key)}
    assert coloured == {"train_06", "train_07", "train_08", "train_16", "ood_04", "ood_10"}


@pytest.mark.parametrize("template", TEMPLATES)
@pytest.mark.parametrize("category", CATEGORIES)
def test_every_instruction_is_a_sentence(template: str, category: str) -> None:
    text = instruction(template, category, "red")
    assert say_category(category) in text
    assert text.endswith(".")
    assert not set("{}_") & set(text)


@pytest.mark.parametrize("split", Split)
def test_the_split_determines_the_pool_of_templates(split: Split) -> None:
    pool = OOD_TEMPLATES if split.is_paraphrased else TRAIN_TEMPLATES
    assert templates_for(split, "red") == tuple(pool)


def test_unknown_colour_leaves_fourteen_training_and_ten_paraphrased_templates() -> None:
    assert len(templates_for(Split.TRAIN_ID, "unknown")) == 14
    assert len(templates_for(Split.TEST_PARAPHRASE_OOD, "unknown")) == 10


def test_colour_template_without_a_colour_is_an_error() -> None:
    with pytest.raises(ValueError, match="train_06 names a colour, but the target's colour is unknown"):
        instruction("train_06", "chair", "unknown")


def test_unknown_template_is_an_error() -> None:
    with pytest.raises(KeyError):
        instruction("train_99", "chair", "red")

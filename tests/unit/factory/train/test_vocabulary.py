"""Encoding of instructions: complete for the templates, stable, and constant in the ablated model."""

from __future__ import annotations

import numpy as np
import pytest

from factory.train.vocabulary import ANY, MAX_WORDS, PAD, UNKNOWN, encode, mirrored_words, split_words, vocabulary
from schemas.instruction.templates import TEMPLATES, instruction
from schemas.terms import CATEGORIES

WORDS = vocabulary()


@pytest.mark.parametrize("template", sorted(TEMPLATES))
def test_every_template_with_every_category_is_encoded_within_the_length(template: str) -> None:
    words = vocabulary(["red"])
    for category in CATEGORIES:
        text = instruction(template, category, "red")
        assert len(split_words(text)) <= MAX_WORDS
        assert UNKNOWN not in encode(text, words)


def test_case_and_punctuation_do_not_matter() -> None:
    assert np.array_equal(encode("Go to the CHAIR!", WORDS), encode("go to the chair", WORDS))


def test_different_categories_are_encoded_differently() -> None:
    said = {tuple(encode(f"Go to the {name.replace('_', ' ')}.", WORDS)) for name in CATEGORIES}
    assert len(said) == len(CATEGORIES)


def test_unknown_words_are_encoded_as_unknown() -> None:
    found = encode("Go to the zeppelin.", WORDS)
    assert found[3] == UNKNOWN
    assert found[:3].min() > ANY
    assert (found[4:] == PAD).all()


def test_custom_categories_of_the_training_data_are_in_the_vocabulary() -> None:
    assert UNKNOWN not in encode("Go to the zeppelin.", vocabulary(["Approach the zeppelin."]))


def test_the_ablated_model_gets_the_same_ids_for_every_instruction() -> None:
    texts = ("Go to the chair.", "", "Approach the red sofa and stop.")
    assert {tuple(encode(text, WORDS, ablate=True)) for text in texts} == {(ANY, *[PAD] * (MAX_WORDS - 1))}


@pytest.mark.parametrize("text", ["", "!?", "a " * 100])
def test_any_text_gives_at_least_one_id(text: str) -> None:
    found = encode(text, WORDS)
    assert found.shape == (MAX_WORDS,)
    assert found[0] != PAD
    assert 0 <= found.min() <= found.max() < len(WORDS)


def test_the_instruction_of_a_mirrored_image_names_the_other_side() -> None:
    words = vocabulary(["Go to the red chair on your left."])
    swapped = mirrored_words(words)[encode("Go to the red chair on your left.", words)]
    assert np.array_equal(swapped, encode("Go to the red chair on your right.", words))
    assert np.array_equal(mirrored_words(WORDS), np.arange(len(WORDS)))

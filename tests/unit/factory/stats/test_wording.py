"""Measures of wording: words, vocabulary and self-BLEU."""

from __future__ import annotations

import pytest

from factory.stats.language import self_bleu, wording_row, words_of


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Go to the robot's dock, now!", ["go", "to", "the", "robot's", "dock", "now"]),
        ("Fahr zur grünen Couch.", ["fahr", "zur", "grünen", "couch"]),
        ("去椅子", ["去", "椅", "子"]),
        ("", []),
    ],
)
def test_a_sentence_is_split_into_words_and_chinese_into_characters(text, words):
    assert words_of(text) == words


def test_self_bleu_is_one_for_equal_sentences_and_small_for_different_ones():
    equal, other = ["go", "to", "the", "red", "chair", "now"], ["please", "find", "a", "blue", "sofa", "over", "there"]
    assert self_bleu([equal, equal]) == pytest.approx(1.0)
    different = self_bleu([equal, other])
    assert different is not None
    assert different < 0.1
    assert self_bleu([equal]) is None


def test_a_row_counts_sentences_words_and_lengths():
    row = wording_row("en", ["Go to the chair.", "Go to the chair.", "Find a plant"])
    assert (row.n, row.distinct, row.vocabulary, row.words_least, row.words_most) == (3, 2, 7, 3, 4)

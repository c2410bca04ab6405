"""Tests typing and speech errors: they keep the meaning, and a text with any other difference is refused."""

import numpy as np
import pytest

from schemas.errors import InvalidLanguage
from schemas.language.compose import Composer
from schemas.language.language_file import LanguageSpec, load_language
from schemas.language.sentence.grammar import LANGUAGES
from schemas.language.sentence.mistakes import MistakeKind, mistake_fault, with_mistake
from schemas.language.sentence.reading import reader
from tests.builders.language import number_at, two_rooms, views

SENTENCE = {
    "en": "Go to the red chair.",
    "de": "Fahr zum roten Stuhl.",
    "es": "Ve a la silla roja.",
    "zh": "去那把红色的椅子。",
}


@pytest.mark.parametrize("code", LANGUAGES)
@pytest.mark.parametrize("kind", MistakeKind)
def test_mistakes_depend_on_the_seed_and_make_one_difference(code, kind):
    words, clean = reader(code).vocabulary, SENTENCE[code]
    made = [with_mistake(clean, kind, code, words, np.random.default_rng(seed)) for seed in range(20)]
    assert made == [with_mistake(clean, kind, code, words, np.random.default_rng(seed)) for seed in range(20)]
    if (code, kind) == ("zh", MistakeKind.TYPING):
        assert set(made) == {None}
        return
    assert len(set(made)) > 1
    assert all(one != clean and mistake_fault(one, clean, kind, code, words) == "" for one in made if one is not None)


@pytest.mark.parametrize(
    ("text", "kind", "fault"),
    [
        ("Go to the red chiar.", MistakeKind.TYPING, ""),
        ("Go to the red charr.", MistakeKind.TYPING, ""),
        ("Go to the red table.", MistakeKind.TYPING, "'table' is not 'chair' with one typing error"),
        ("Go to the rde chair.", MistakeKind.TYPING, "one mistyped word"),
        ("Go to a red chiar.", MistakeKind.TYPING, "one mistyped word"),
        ("Go to the red chair.", MistakeKind.TYPING, "one mistyped word"),
        ("Go to uh the red chair.", MistakeKind.SPEECH, ""),
        ("Go to the the red chair.", MistakeKind.SPEECH, ""),
        ("Go to the blue red chair.", MistakeKind.SPEECH, "a filler or a repetition"),
        ("Go the red chair.", MistakeKind.SPEECH, "a filler or a repetition"),
    ],
)
def test_a_text_that_differs_by_more_than_the_stated_mistake_is_refused(text, kind, fault):
    found = mistake_fault(text, "Go to the red chair.", kind, "en", reader("en").vocabulary)
    assert fault in found if fault else found == ""


def test_a_mistyped_word_that_resembles_another_word_is_refused():
    words = frozenset({"right", "fight", "chair"})
    assert mistake_fault("Turn light.", "Turn right.", MistakeKind.TYPING, "en", words) == "'light' resembles 'fight'"
    assert mistake_fault("Turn fight.", "Turn right.", MistakeKind.TYPING, "en", words) == "'fight' resembles 'fight'"


def test_a_share_of_instructions_has_an_error_and_keeps_the_clean_sentence():
    composer = Composer(LanguageSpec(mistakes={"typing": 0.4, "speech": 0.4}, languages={"en": 1, "de": 1}))
    scene, number = two_rooms(), number_at(-3.0, 1.6)
    found = [
        composer.write(scene, view, number, False, np.random.default_rng(seed)) for seed, view in enumerate(views(24))
    ]
    said = [one for group in found for one in group]
    wrong = [one for one in said if one.clean is not None]
    assert {one.mistake for one in wrong} == set(MistakeKind)
    assert 0 < len(wrong) < len(said)
    for one in wrong:
        words = reader(one.language).vocabulary
        assert mistake_fault(one.text, one.meant, one.mistake, one.language, words) == ""


def test_shares_above_one_and_unknown_kinds_are_refused(tmp_path):
    for text, fault in (
        ("mistakes = {typing = 0.7, speech = 0.7}", "add up to more than 1"),
        ("mistakes = {accent = 0.7}", "mistakes.accent"),
    ):
        (tmp_path / "l.toml").write_text(text)
        with pytest.raises(InvalidLanguage, match=fault):
            load_language(str(tmp_path / "l.toml"))

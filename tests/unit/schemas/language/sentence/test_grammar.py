"""Tests the grammars: numbers of patterns, words of all kinds, and sentences that are read back."""

import pytest

from schemas.errors import UsageError
from schemas.language.expression import ARITY, COUNTED, Clause, Expression, Landmark, Ordinal, Relation
from schemas.language.kinds import kinds
from schemas.language.sentence.grammar import LANGUAGES, REGISTERS, grammar
from schemas.language.sentence.reading import reader
from schemas.terms import BUILTIN_CATEGORIES, CATEGORIES, COLOUR_NAMES


def near(kind: str, definite: bool = True, colour: str | None = None) -> Clause:
    return Clause(relation="next_to", landmarks=(Landmark(kind=kind, definite=definite, colour=colour),))


def test_english_has_512_patterns_and_each_register_has_held_out_patterns():
    sentences = grammar("en").sentences
    texts = {(each.before, each.case, each.after) for each in sentences}
    assert len(texts) == len(sentences) == 512
    for register in REGISTERS:
        assert {each.held_out for each in sentences if each.register == register} == {True, False}


@pytest.mark.parametrize("code", LANGUAGES)
def test_template_ids_are_unique_and_held_out_patterns_differ_from_the_others(code):
    sentences = grammar(code).sentences
    assert len({each.template_id for each in sentences}) == len(sentences)
    seen, held_out = ({(e.before, e.after) for e in sentences if e.held_out is kind} for kind in (False, True))
    assert not seen & held_out


@pytest.mark.parametrize("code", LANGUAGES)
def test_every_language_has_words_for_everything_that_an_expression_can_name(code):
    source, table = grammar(code), kinds()
    assert source.nouns.keys() >= {*CATEGORIES, *table.superclasses, *table.kinds}
    assert source.colours.keys() == set(COLOUR_NAMES)
    assert source.relations.keys() == set(Relation)
    assert source.rooms.keys() == table.rooms.keys()
    assert source.materials.keys() == grammar("en").materials.keys()
    assert source.plurals.keys() == grammar("en").plurals.keys()
    assert source.numbers.keys() == {str(number) for number in range(2, 7)}


def test_chinese_has_no_space_between_relations_and_noun():
    two = (Clause(relation="this_room"), Clause(relation="in_corner"))
    expression = Expression(kind="shelf", material="wood", clauses=two)
    source = grammar("zh")
    assert not [text for one in source.sentences if " " in (text := source.sentence(one, expression))]


def test_german_weak_nouns_have_their_ending_in_dative_and_accusative():
    source, machine = grammar("de"), Expression(kind="vending_machine", colour="red")
    chair = Expression(kind="chair", clauses=(near("vending_machine"),))
    for pattern in source.sentences:
        assert "dem Verkaufsautomaten" in source.sentence(pattern, chair)
        text = source.sentence(pattern, machine)
        assert ("Verkaufsautomaten" in text) == (pattern.case in ("dat", "acc")), text


EXPRESSIONS = (
    Expression(kind="chair", colour="red"),
    Expression(kind="trash_can", definite=False, clauses=(near("table", definite=False, colour="brown"),)),
    Expression(kind="table", ordinal=Ordinal(number=3, side="right")),
    Expression(kind="sofa", colour="blue", ordinal=Ordinal(number=1, side="left")),
    Expression(kind="rack", ordinal=Ordinal(number=1, side="ahead_left")),
    Expression(kind="shelf", ordinal=Ordinal(number=4, side="ahead_right")),
    Expression(kind="plant", size="tallest", clauses=(Clause(relation="this_room"),)),
    Expression(kind="table", material="wood", clauses=(near("plant"),)),
    Expression(kind="shelf", definite=False, colour="gray", material="metal"),
    *(
        Expression(
            kind="fire_extinguisher",
            clauses=(
                Clause(
                    relation=relation,
                    landmarks=(Landmark(kind="chair", definite=False),)
                    if relation in COUNTED
                    else (Landmark(kind="plant", colour="green"), Landmark(kind="shelf", definite=False))[
                        : ARITY[relation]
                    ],
                    room="kitchen" if relation is Relation.IN_ROOM else None,
                    count=3 if relation in COUNTED else None,
                ),
            ),
        )
        for relation in Relation
    ),
)


@pytest.mark.parametrize("code", LANGUAGES)
def test_every_sentence_is_read_with_the_meaning_that_it_was_written_for(code):
    source, own = grammar(code), reader(code)
    for number, pattern in enumerate(source.sentences):
        expression = EXPRESSIONS[number % len(EXPRESSIONS)]
        if pattern.case == "bare" and not expression.definite:
            continue  # an expression without an article is read as definite
        choice = dict.fromkeys(
            ("kind", "landmark", "relation", "size", "side", "colour", "article", "material"), number
        )
        text = source.sentence(pattern, expression, choice)
        assert {each.expression for each in own.read(text)} == {expression}, text


@pytest.mark.parametrize(
    ("code", "text", "expression"),
    [
        ("en", "Go to the red chair.", Expression(kind="chair", colour="red")),
        ("en", "go to an orange crate", None),  # without the full stop it is not a sentence of the grammar
        ("en", "Go to an orange crate.", Expression(kind="crate", colour="orange", definite=False)),
        ("en", "Could you drive to the couch next to a grey bin?", None),  # `bin` is not a word of the grammar
        (
            "en",
            "Please head over to the second chair from the left.",
            Expression(kind="chair", ordinal=Ordinal(number=2, side="left")),
        ),
        ("en", "Drive to the plant beside the table and stop.", Expression(kind="plant", clauses=(near("table"),))),
        ("de", "Fahr zum roten Stuhl.", Expression(kind="chair", colour="red")),
        (
            "de",
            "Kannst du zur Pflanze neben dem weißen Tisch fahren?",
            Expression(kind="plant", clauses=(near("table", colour="white"),)),
        ),
        (
            "de",
            "Bitte geh zum zweiten Stuhl von links.",
            Expression(kind="chair", ordinal=Ordinal(number=2, side="left")),
        ),
        ("es", "Ve al sofá rojo.", Expression(kind="sofa", colour="red")),
        (
            "es",
            "Por favor, ve a la tercera silla desde la derecha.",
            Expression(kind="chair", ordinal=Ordinal(number=3, side="right")),
        ),
        ("zh", "请去那把红色的椅子。", Expression(kind="chair", colour="red")),
        ("zh", "去在桌子旁边的那盆植物。", Expression(kind="plant", clauses=(near("table"),))),
        ("en", "Go to the \ud800 chair.", None),
        ("en", "", None),
    ],
)
def test_sentences_that_people_write_have_their_meaning(code, text, expression):
    found = {each.expression for each in reader(code).read(text)}
    assert found == (set() if expression is None else {expression})


@pytest.mark.parametrize(
    ("code", "start", "text"),
    [
        ("de", "Fahr zu", "Fahr zur grünen Couch."),
        ("de", "Dein Ziel", "Dein Ziel ist die grüne Couch."),
        ("es", "Tu destino", "Tu destino es el sofá verde."),
        ("zh", "请去", "请去那张绿色的沙发。"),
    ],
)
def test_articles_adjectives_and_measure_words_agree_with_the_noun(code, start, text):
    source = grammar(code)
    sofa, noun = Expression(kind="sofa", colour="green"), 1 if code == "de" else 0
    written = [source.sentence(each, sofa, {"kind": noun}) for each in source.sentences]
    assert text in [each for each in written if each.startswith(start)]


def test_the_error_of_an_unknown_language_lists_the_known_languages():
    with pytest.raises(UsageError, match="unknown language 'eng'; languages: en, de, es, zh; did you mean 'en'"):
        grammar("eng")


@pytest.mark.parametrize("code", LANGUAGES)
def test_every_category_of_a_built_in_scene_has_a_noun(code):
    held = {name for terms in BUILTIN_CATEGORIES.values() for group in terms for name in group}
    assert held <= set(grammar(code).nouns)

"""Tests generated expressions: they fit the target only, are minimal, and the verifier rejects changed words."""

import numpy as np
import pytest

from schemas.language.compose import Composer, InstructionKind
from schemas.language.expression import Expression
from schemas.language.generator.minimal import minimal_expressions, redundant_expressions
from schemas.language.language_file import LanguageSpec
from schemas.language.sentence.grammar import LANGUAGES, grammar
from schemas.language.sentence.reading import reader
from tests.builders.language import changed, is_false_or_ambiguous, search_of, two_rooms, views

TARGETS = tuple(number for number, each in enumerate(two_rooms().graph.objects) if each.target_id is not None)
VIEWS = views(6)


def expressions_of(count: int) -> list[tuple[int, int, Expression]]:
    """Returns up to `count` expressions for each view and target, as (view number, target number, expression)."""
    rng, found = np.random.default_rng(1), []
    for place, view in enumerate(VIEWS):
        for number in TARGETS:
            options = minimal_expressions(search_of(view, number), rng)
            found += [(place, number, options[k]) for k in rng.permutation(len(options))[:count].tolist()]
    return found


def shorter(expression: Expression) -> list[Expression]:
    """Returns the expressions that result from removing one part of an expression."""
    found = [
        expression.model_copy(update={name: None})
        for name in ("colour", "material", "size", "ordinal")
        if getattr(expression, name)
    ]
    clauses = expression.clauses
    return found + [
        expression.model_copy(update={"clauses": clauses[:place] + clauses[place + 1 :]})
        for place in range(len(clauses))
    ]


def test_the_verifier_accepts_generated_expressions_and_no_part_can_be_dropped():
    verifier, wrong, longer = two_rooms().verifier, [], []
    drawn = expressions_of(6)
    for place, number, expression in drawn:
        if not verifier.evaluate(expression, VIEWS[place]).fits_only(number):
            wrong.append(expression)
        if any(verifier.evaluate(one, VIEWS[place]).fits_only(number) for one in shorter(expression)):
            longer.append(expression)
    assert len(drawn) > 300
    # footprints are bounding rectangles here, so generator and verifier measure the same
    assert not wrong
    assert len(longer) <= 0.01 * len(drawn)


def test_one_changed_word_that_makes_a_sentence_false_or_ambiguous_is_rejected():
    verifier, source, rejected, count = two_rooms().verifier, grammar("en"), 0, 0
    patterns = [each for each in source.sentences if each.case == "nom"]
    for place, number, expression in expressions_of(2):
        search = search_of(VIEWS[place], number)
        for other in changed(expression):
            if is_false_or_ambiguous(other, search):
                text = source.sentence(patterns[count % len(patterns)], other)
                rejected += bool(verifier.check(text, reader("en"), VIEWS[place], number))
                count += 1
    assert count >= 1000
    assert rejected >= 0.99 * count


def test_a_redundant_expression_has_one_more_part_and_still_fits():
    found = [
        (place, number, longer)
        for place, number, expression in expressions_of(2)
        for longer in redundant_expressions(search_of(VIEWS[place], number), expression)[:2]
    ]
    verdicts = [
        two_rooms().verifier.evaluate(longer, VIEWS[place]).fits_only(number) for place, number, longer in found
    ]
    assert len(found) > 50
    assert all(verdicts)


@pytest.mark.parametrize("code", LANGUAGES)
def test_instructions_of_every_language_are_verified_and_repeatable(code):
    composer = Composer(LanguageSpec(languages={code: 1.0}, per_episode=2, redundant=0.3, false_premises=1.0))
    written = [
        [
            one
            for number in TARGETS
            for one in composer.write(two_rooms(), VIEWS[0], number, False, np.random.default_rng(number))
        ]
        for _ in range(2)
    ]
    assert written[0] == written[1]
    goals = [one for one in written[0] if one.kind is InstructionKind.GOAL]
    assert len(goals) > len(TARGETS)
    assert {one.language for one in written[0]} == {code}
    assert any(one.kind is InstructionKind.FALSE_PREMISE and one.fits == 0 for one in written[0])
    assert {one.is_minimal for one in goals} == {True, False}


def test_held_out_patterns_are_written_only_on_request():
    composer = Composer(LanguageSpec())
    for held_out in (False, True):
        found = [
            composer.write(two_rooms(), VIEWS[0], number, held_out, np.random.default_rng(number)) for number in TARGETS
        ]
        assert {one.held_out for each in found for one in each} == {held_out}


def test_the_option_fit_any_gives_instructions_for_several_objects_without_features_of_weight_zero():
    without_view = LanguageSpec(features={"view": 0, "ego": 0, "ordinal": 0, "nearest": 0}, fit="any")
    composer, rng = Composer(without_view), np.random.default_rng(0)
    found = [one for number in TARGETS for one in composer.write(two_rooms(), VIEWS[1], number, False, rng)]
    assert found
    assert all(one.fits > 1 for one in found)
    assert not {"view", "ego", "ordinal", "nearest"} & {name for one in found for name in one.features.split(",")}


def test_targets_with_too_few_objects_of_their_category_get_no_instruction():
    composer = Composer(LanguageSpec(same_category=3))
    found = {
        two_rooms().graph.objects[n].kind: composer.write(two_rooms(), VIEWS[0], n, False, np.random.default_rng(n))
        for n in TARGETS
    }
    assert found["sofa"] == found["monitor"] == []


def test_the_features_of_sentences_have_the_ratio_of_their_weights_where_both_are_possible():
    spec = LanguageSpec(features={**dict.fromkeys(LanguageSpec().families, 0.0), "near": 3.0, "ordinal": 1.0})
    composer, scene, said = Composer(spec), two_rooms(), []
    for view in views(60):
        for number in TARGETS:
            sets = composer.offers(scene, view, number, np.random.default_rng(0))
            if {frozenset({"near"}), frozenset({"ordinal"})} <= sets:
                for seed in range(40):
                    rng = np.random.default_rng((seed, number))
                    said += [one.features for one in composer.write(scene, view, number, False, rng)]
    assert len(said) >= 200
    assert set(said) == {"near", "ordinal"}
    assert said.count("near") / len(said) == pytest.approx(0.75, abs=0.06)


def test_features_of_equal_weight_lead_no_start_and_those_above_the_mean_do():
    every = LanguageSpec().families
    assert Composer(LanguageSpec()).leading_feature(np.random.default_rng(0)) is None
    assert Composer(LanguageSpec(features=dict.fromkeys(every, 2.0))).leading_feature(np.random.default_rng(0)) is None
    composer = Composer(LanguageSpec(features={"near": 14.0}))
    led = [composer.leading_feature(np.random.default_rng(seed)) for seed in range(400)]
    assert set(led) == {"near", None}  # 14 of 28 weights; a feature of weight 1 is below the mean of 28 / 15
    assert led.count("near") / 400 == pytest.approx(0.5, abs=0.08)

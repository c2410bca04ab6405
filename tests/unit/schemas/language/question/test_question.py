"""Tests questions about a known path in the furnished scene: answers, reasons, and the verifier that checks them."""

import functools
from collections import Counter

import numpy as np
import pytest

from schemas.language.compose import Composer
from schemas.language.graph.view import look
from schemas.language.language_file import LanguageSpec
from schemas.language.question.compose import AskedEpisode, QuestionComposer
from schemas.language.question.meaning import AnswerKind, Question, QuestionKind, ReasonKind, SeenSide
from schemas.language.question.reading import question_reader
from schemas.language.question.verify import QuestionVerifier
from schemas.language.question.words import question_words
from schemas.language.route.steps import SceneRoutes
from schemas.language.sentence.grammar import LANGUAGES, grammar
from schemas.language.sentence.reading import reader
from tests.builders.language import CAMERA, driven, number_at, two_rooms

POSES = driven((-4.5, -0.3), (3.2, -0.3), (3.2, 1.4))
"""East through the doorway, then left, and north to the sofa."""
SOFA = (3.5, 2.5)


@functools.cache
def place() -> SceneRoutes:
    return SceneRoutes(two_rooms(), CAMERA)


@functools.cache
def verifier() -> QuestionVerifier:
    return QuestionVerifier(place(), POSES, number_at(*SOFA))


@functools.cache
def asked(count: int = 40) -> tuple[Question, ...]:
    """Returns questions in four languages, some of them with held-out patterns."""
    spec = LanguageSpec(languages=dict.fromkeys(LANGUAGES, 1.0), questions=True)
    writer, composer, found = QuestionComposer(Composer(spec)), Composer(spec), []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        view = look(two_rooms().graph, (-4.5, -0.3, 0.0), CAMERA)
        goals = tuple(composer.write(two_rooms(), view, number_at(*SOFA), False, rng))
        found += writer.write(place(), AskedEpisode(POSES, number_at(*SOFA), goals), seed % 4 == 0, rng)
    return tuple(found)


def fault(question: Question) -> str:
    return verifier().check(question, reader(question.language))


def reworded(question: Question, **changes: object) -> Question:
    """Returns the question with a changed meaning and the text for that meaning."""
    meaning = question.meaning.model_copy(update=changes)
    span, rng = (question.start, question.end), np.random.default_rng(0)
    found = question_words(question.language).write(meaning, span, False, grammar(question.language), rng)
    assert found is not None
    return found


def test_every_kind_of_question_is_asked_in_every_language_and_has_the_right_answer():
    kinds = Counter((each.meaning.kind, each.language) for each in asked())
    assert set(kinds) == {(kind, code) for kind in QuestionKind for code in LANGUAGES}
    assert [fault(each) for each in asked() if fault(each)] == []
    assert {each.held_out for each in asked()} == {True, False}


def test_the_first_movement_is_through_the_doorway_because_the_goal_is_in_the_other_room():
    found = {each.meaning.answer: each for each in asked() if each.meaning.kind is QuestionKind.NEXT}
    assert found[AnswerKind.DOORWAY].meaning.reason is ReasonKind.OTHER_ROOM
    assert POSES[found[AnswerKind.DOORWAY].start, 0] < 0 < POSES[found[AnswerKind.DOORWAY].end - 1, 0] + 0.2
    assert found[AnswerKind.TURN_LEFT].meaning.reason is ReasonKind.GOAL_LEFT
    assert found[AnswerKind.STOP].meaning.reason is ReasonKind.REACHED
    assert found[AnswerKind.STOP].end == len(POSES)


def changes_of(question: Question) -> list[dict[str, object]]:
    """Returns changes that make the answer or the reason wrong."""
    meaning, found = question.meaning, []
    match meaning.kind:
        case QuestionKind.VISIBLE if meaning.answer is AnswerKind.YES:
            absent = {"answer": AnswerKind.NO, "side": None, "metres": None}
            found = [absent | {"reason": ReasonKind.NOT_IN_VIEW}, absent | {"reason": ReasonKind.NONE_EXISTS}]
            found.append({"metres": meaning.metres * 2 + 1})
        case QuestionKind.VISIBLE:
            seen = {"answer": AnswerKind.YES, "reason": ReasonKind.SEEN_AT, "side": SeenSide.AHEAD, "metres": 2}
            wrong = {ReasonKind.NONE_EXISTS, ReasonKind.NOT_IN_VIEW} - {meaning.reason}
            found = [seen, {"reason": wrong.pop()}]
        case QuestionKind.WHERE if meaning.answer is AnswerKind.THERE:
            found = [{"side": side} for side in SeenSide if side is not meaning.side]
            found += [{"metres": meaning.metres * 2 + 1}]
            unseen = {"answer": AnswerKind.UNSEEN, "side": None, "metres": None}
            found += [unseen | {"reason": reason} for reason in (ReasonKind.HIDDEN, ReasonKind.OUTSIDE)]
        case QuestionKind.WHERE:
            wrong = {ReasonKind.OTHER_ROOM, ReasonKind.OUTSIDE, ReasonKind.HIDDEN} - {meaning.reason}
            found = [{"answer": AnswerKind.THERE, "reason": None, "side": SeenSide.AHEAD, "metres": 3}]
            if meaning.reason is not ReasonKind.OTHER_ROOM:
                found += [{"reason": reason} for reason in wrong]
        case QuestionKind.NEXT:
            moves = (AnswerKind.TURN_LEFT, AnswerKind.TURN_RIGHT, AnswerKind.TURN_AROUND, AnswerKind.STOP)
            found = [{"answer": each} for each in moves if each is not meaning.answer]
        case QuestionKind.FEASIBLE:
            fits = {ReasonKind.ONE_FITS: AnswerKind.YES, ReasonKind.NONE_FITS: AnswerKind.NO}
            fits |= {ReasonKind.SEVERAL_FIT: AnswerKind.NO}
            found = [{"answer": fits[reason], "reason": reason} for reason in fits if reason is not meaning.reason]
            other = AnswerKind.NO if meaning.answer is AnswerKind.YES else AnswerKind.YES
            found.append({"answer": other})
    return found


def test_a_wrong_answer_or_reason_is_rejected():
    wrong = [reworded(each, **change) for each in asked() for change in changes_of(each)]
    assert len(wrong) > 200
    accepted = [(each.question, each.answer, each.reason) for each in wrong if not fault(each)]
    assert accepted == []


def test_invalid_frames_and_words_outside_of_the_patterns_are_rejected():
    one = next(each for each in asked() if each.meaning.kind is QuestionKind.WHERE)
    assert fault(one.model_copy(update={"start": 0, "end": len(POSES) + 1})) == "the frames do not exist"
    assert fault(one.model_copy(update={"end": one.end + 1})) == "the question is about more than one frame"
    assert fault(one.model_copy(update={"answer": "Perhaps."})) == "the texts do not match the patterns of the language"


class _Images:
    """Arrays of ids and depth with one object in the middle of the view."""

    def __init__(self, number: int | None, metres: float) -> None:
        self._ids = np.zeros((640, 640), np.uint16)
        if number is not None:
            self._ids[300:340, 300:340] = two_rooms().graph.objects[number].ids[0]
        self._metres = metres

    def ids(self, t: int) -> np.ndarray:
        return self._ids

    def depth(self, t: int) -> np.ndarray:
        return np.full((640, 640), self._metres, np.float32)


def test_an_answer_that_recorded_images_contradict_is_rejected():
    found = [each for each in asked() if each.meaning.kind is QuestionKind.WHERE and each.meaning.metres]
    one = next(each for each in found if each.meaning.side is SeenSide.AHEAD)
    sofa, metres = number_at(*SOFA), float(one.meaning.metres)

    def seen(images: _Images, question: Question = one) -> str:
        return verifier().check(question, reader(question.language), images)

    assert seen(_Images(sofa, metres)) == ""
    assert seen(_Images(sofa, 3 * metres + 2)) == "the image shows no such object at this side and distance"
    assert seen(_Images(None, metres)) == "the image shows no such object"
    unseen = next(each for each in asked() if each.meaning.answer is AnswerKind.UNSEEN)
    assert seen(_Images(None, metres), unseen) == ""
    assert seen(_Images(sofa, metres), unseen) == "the image shows such an object"


def test_an_episode_with_a_false_premise_has_no_question_about_a_goal():
    writer = QuestionComposer(Composer(LanguageSpec(questions=True)))
    episode = AskedEpisode(POSES[:11], number_at(*SOFA), is_false_premise=True)
    kinds = {
        each.meaning.kind
        for seed in range(5)
        for each in writer.write(place(), episode, False, np.random.default_rng(seed))
    }
    assert kinds == {QuestionKind.VISIBLE, QuestionKind.OBJECT, QuestionKind.FEASIBLE}


@pytest.mark.parametrize("code", LANGUAGES)
def test_every_pattern_and_synonym_is_read_back(code):
    words, read = question_words(code), question_reader(code, reader(code))
    assert set(words.questions) == set(QuestionKind)
    assert set(words.answers) == set(AnswerKind)
    assert set(words.reasons) == set(ReasonKind)
    one = {each.meaning.kind: each for each in asked() if each.language == code}
    for pattern in words.patterns:
        kind = QuestionKind(pattern.kind)
        known = one[kind]
        for seed in range(12):
            rng = np.random.default_rng(seed)
            text = words.write(known.meaning, (0, 1), pattern.held_out, grammar(code), rng)
            assert known.meaning in read.read(text.question, text.answer, text.reason), text


def test_a_quoted_instruction_is_kept_as_it_was_written():
    quoted = [each for each in asked() if each.meaning.kind is QuestionKind.FEASIBLE]
    assert all(each.question.endswith(each.meaning.instruction) for each in quoted)

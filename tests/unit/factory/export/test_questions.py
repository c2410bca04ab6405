"""Tests at which exported frames questions are asked, with a verifier that accepts given frames."""

from __future__ import annotations

import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from factory.export.questions import (
    NO_CAMERA,
    NO_FRAME,
    FrameSearch,
    ask_questions,
    count_questions,
    not_asked,
    questions_text,
    questions_words,
    to_line,
)
from schemas.errors import ArchiveCorrupt
from schemas.language.question.meaning import AnswerKind, Question, QuestionKind, QuestionMeaning

KEPT = range(0, 100, 6)


def question(start: int, end: int, kind: QuestionKind = QuestionKind.VISIBLE, **changes: Any) -> Question:
    return Question(
        **{
            "question": f"Q{start}?",
            "answer": "A.",
            "reason": "R.",
            "language": "en",
            "template_id": "en_next_001",
            "held_out": False,
            "start": start,
            "end": end,
            "meaning": QuestionMeaning(kind=kind, answer=AnswerKind.YES),
        }
        | changes
    )


def episode(*questions: Question) -> Any:
    return SimpleNamespace(
        episode_id="ep_000007", questions=questions, summary=SimpleNamespace(split="val_id", scene="office")
    )


@pytest.fixture
def accept(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[Question], bool]], None]:
    """Function that replaces the verifier by a condition."""

    def replace(is_true: Callable[[Question], bool]) -> None:
        monkeypatch.setattr(FrameSearch, "_check", lambda _self, each: "" if is_true(each) else "it is wrong")

    return replace


def test_a_question_about_an_exported_frame_stays_there_without_a_check(accept):
    accept(lambda _: False)
    found = ask_questions(episode(question(12, 13)), KEPT, lambda n, t: f"{n}_{t}.jpg")
    (asked,) = found.asked
    assert (asked.frame, asked.step, asked.computed_at, asked.moved, asked.image) == (2, 12, 12, False, "2_12.jpg")
    assert (asked.id, asked.split, asked.answer) == ("ep_000007/1", "val_id", "A. R.")


def test_a_question_moves_to_the_nearest_exported_frame_at_which_its_answer_is_true(accept):
    accept(lambda each: each.start >= 18 and each.end == each.start + 1)
    found = ask_questions(episode(question(13, 14), question(20, 21), question(27, 28, language="zh")), KEPT)
    assert [(each.step, each.computed_at, each.moved) for each in found.asked] == [
        (18, 13, True),
        (18, 20, True),
        (24, 27, True),  # 24 and 30 are equally near
    ]
    assert found.asked[2].answer == "A.R."
    assert found.omitted == ()


def test_a_movement_is_asked_at_the_first_exported_frame_of_its_span_or_where_the_rest_of_it_is_true(accept):
    seen = []
    accept(lambda each: seen.append((each.start, each.end)) or each.start <= 30)
    spans = (question(16, 40, QuestionKind.NEXT), question(37, 41, QuestionKind.NEXT))
    found = ask_questions(episode(*spans), KEPT)
    assert [(each.step, each.moved) for each in found.asked] == [(18, False), (30, True)]
    assert seen == [(36, 41), (30, 41)]


def test_a_question_without_a_true_frame_and_one_whose_scene_is_missing_are_omitted_with_their_reasons(
    accept, monkeypatch
):
    accept(lambda _: False)
    wrong = ask_questions(episode(question(12, 13), question(14, 15)), KEPT)
    assert [(each.id, each.reason) for each in wrong.omitted] == [("ep_000007/2", NO_FRAME)]

    def missing(_self: FrameSearch) -> None:
        raise ArchiveCorrupt("no package")

    monkeypatch.setattr(FrameSearch, "_check", property(missing))
    lost = ask_questions(episode(question(12, 13), question(14, 15)), KEPT)
    assert len(lost.asked) == 1
    assert "package of scene office is missing" in lost.omitted[0].reason


def test_the_questions_of_an_export_are_counted_and_listed(accept):
    accept(lambda each: each.start == 18)
    one = ask_questions(episode(question(12, 13), question(14, 15)), KEPT)
    two = not_asked(episode(*(question(t, t + 1) for t in range(25))))
    count = count_questions([None, one, two])
    assert (count.asked, count.moved, len(count.omitted)) == (2, 1, 25)
    assert {each.reason for each in count.omitted} == {NO_CAMERA}
    assert questions_words(count).startswith("2 questions, 1 of them moved")
    text = questions_text(count, has_file=True)
    assert "ep_000007/20" in text
    assert "5 more" in text
    assert "questions.jsonl" in text
    assert "questions.jsonl" not in questions_text(count, has_file=False)
    assert count_questions([None, None]) is None
    assert questions_text(None, has_file=True) == ""
    assert not_asked(episode()) is None


def test_a_line_has_question_answer_frame_and_picture(accept):
    accept(lambda _: True)
    found = ask_questions(episode(question(13, 14)), KEPT, lambda n, _t: f"a/{n}.jpg")
    assert json.loads(to_line(found.asked[0])) == {
        "id": "ep_000007/1",
        "episode": "ep_000007",
        "split": "val_id",
        "frame": 2,
        "step": 12,
        "computed_at": 13,
        "kind": "visible",
        "language": "en",
        "question": "Q13?",
        "answer": "A. R.",
        "image": "a/2.jpg",
    }

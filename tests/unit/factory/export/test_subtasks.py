"""Tests the language columns of LeRobot exports."""

import pyarrow as pa

from factory.export.lerobot.subtasks import (
    COLUMN,
    EVENTS,
    question_rows,
    subtask_rows,
    with_questions,
    with_subtasks,
)
from schemas.language.question.meaning import AnswerKind, Question, QuestionKind, QuestionMeaning
from schemas.language.route.meaning import RouteStep, SubInstruction


def step(number: int, start: int, end: int) -> SubInstruction:
    forward = RouteStep(kind="forward", metres=number)
    return SubInstruction(number=number, text=f"Go {number}.", step=forward, start=start, end=end)


def test_every_frame_has_all_subtask_rows_and_each_row_begins_at_an_exported_frame():
    steps = (step(1, 0, 31), step(2, 31, 50), step(3, 50, 60))
    rows = subtask_rows(steps, hz=60, stride=15, frames=4)
    assert [(row["content"], row["timestamp"]) for row in rows] == [("Go 1.", 0.0), ("Go 3.", 0.75)]
    found = with_subtasks(pa.table({"index": [0, 1, 2, 3]}), rows)[COLUMN].to_pylist()
    assert found == [rows] * 4
    assert {row["style"] for row in rows} == {"subtask"}


def question(start: int, end: int, reason: str | None, language: str = "en") -> Question:
    meaning = QuestionMeaning(kind=QuestionKind.NEXT, answer=AnswerKind.STOP)
    return Question(
        question=f"Q{start}?",
        answer="A.",
        reason=reason,
        language=language,
        template_id="en_next_001",
        held_out=False,
        start=start,
        end=end,
        meaning=meaning,
    )


def test_a_question_is_stored_at_the_first_exported_frame_of_its_span_and_omitted_if_the_span_has_none():
    asked = [
        question(0, 1, "R."),
        question(16, 40, None),
        question(31, 32, "R."),
        question(58, 60, "R."),
        question(30, 31, "R.", "zh"),
    ]
    rows = question_rows(asked, "observation.images.front", stride=15, frames=4)
    assert [[(row["role"], row["content"]) for row in frame] for frame in rows] == [
        [("user", "Q0?"), ("assistant", "A. R.")],
        [],
        [("user", "Q16?"), ("assistant", "A."), ("user", "Q30?"), ("assistant", "A.R.")],
        [],
    ]
    found = with_questions(pa.table({"index": [0, 1, 2, 3]}), rows)[EVENTS].to_pylist()
    assert found == rows
    said = [row for frame in found for row in frame]
    assert {(row["style"], row["camera"]) for row in said} == {("vqa", "observation.images.front")}

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
from factory.export.questions import AskedQuestion
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


def question(frame: int, answer: str) -> AskedQuestion:
    return AskedQuestion(
        id=f"ep_000001/{frame}",
        episode="ep_000001",
        split="train_id",
        frame=frame,
        step=15 * frame,
        computed_at=15 * frame,
        kind="next",
        language="en",
        question=f"Q{frame}?",
        answer=answer,
    )


def test_a_question_and_its_answer_are_events_of_their_frame() -> None:
    rows = question_rows([question(0, "A."), question(2, "B."), question(2, "C.")], "observation.images.front", 4)
    assert [[(row["role"], row["content"]) for row in frame] for frame in rows] == [
        [("user", "Q0?"), ("assistant", "A.")],
        [],
        [("user", "Q2?"), ("assistant", "B."), ("user", "Q2?"), ("assistant", "C.")],
        [],
    ]
    found = with_questions(pa.table({"index": [0, 1, 2, 3]}), rows)[EVENTS].to_pylist()
    assert found == rows
    said = [row for frame in found for row in frame]
    assert {(row["style"], row["camera"]) for row in said} == {("vqa", "observation.images.front")}

"""Tests the language column of LeRobot exports."""

import pyarrow as pa

from factory.export.lerobot.language import COLUMN, subtask_rows, with_subtasks
from schemas.language.route.model import RouteStep, SubInstruction


def step(number: int, start: int, end: int) -> SubInstruction:
    forward = RouteStep(kind="forward", metres=number)
    return SubInstruction(number=number, text=f"Go {number}.", step=forward, start=start, end=end)


def test_every_frame_has_all_subtasks_which_begin_at_exported_frames():
    steps = (step(1, 0, 31), step(2, 31, 50), step(3, 50, 60))
    rows = subtask_rows(steps, hz=60, stride=15, frames=4)
    assert [(row["content"], row["timestamp"]) for row in rows] == [("Go 1.", 0.0), ("Go 3.", 0.75)]
    found = with_subtasks(pa.table({"index": [0, 1, 2, 3]}), rows)[COLUMN].to_pylist()
    assert found == [rows] * 4
    assert {row["style"] for row in rows} == {"subtask"}

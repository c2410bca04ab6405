"""Language columns of LeRobot 0.6: `language_persistent` with sub-instructions, `language_events` with questions.

Every frame has all `subtask` rows of its episode; a row is active from its `timestamp` until that of the next row. The
`vqa` rows of a question are in one frame only. Opens no file.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pyarrow as pa

from factory.export.questions import AskedQuestion
from schemas.language.route.meaning import SubInstruction

COLUMN, EVENTS = "language_persistent", "language_events"
FEATURE: dict[str, Any] = {"dtype": "language", "shape": [1], "names": None}
"""Entry of `features` in `info.json`."""
_SAID = (
    pa.field("role", pa.string(), nullable=False),
    *(pa.field(name, pa.string()) for name in ("content", "style")),
)
_SHOWN = (pa.field("camera", pa.string()), pa.field("tool_calls", pa.list_(pa.string())))
TYPE = pa.list_(pa.struct([*_SAID, pa.field("timestamp", pa.float32(), nullable=False), *_SHOWN]))
EVENTS_TYPE = pa.list_(pa.struct([*_SAID, *_SHOWN]))
"""`TYPE` is the type of `language_persistent`, `EVENTS_TYPE` of `language_events` (lerobot/datasets/language.py)."""


def subtask_rows(steps: Sequence[SubInstruction], hz: int, stride: int, frames: int) -> list[dict[str, Any]]:
    """Returns the rows of an episode.

    Args:
        steps: sub-instructions in their order.
        hz: recorded frames per second.
        stride: stride of the exported frames. A row begins at the first exported frame that is not before the start of
            its step, or at the last exported frame if there is none. If several rows would begin at the same frame,
            only the last of their steps has a row.
        frames: number of exported frames.
    """
    shared = {"role": "assistant", "style": "subtask", "camera": None, "tool_calls": None}
    first = {min(-(-each.start // stride), frames - 1): each for each in steps}
    return [shared | {"content": each.text, "timestamp": t * stride / hz} for t, each in first.items()]


def with_subtasks(table: pa.Table, rows: Sequence[dict[str, Any]]) -> pa.Table:
    """Returns the table of frames with the column of sub-instructions; all frames have the same rows."""
    return table.append_column(pa.field(COLUMN, TYPE), pa.array([list(rows)] * len(table), TYPE))


def question_rows(questions: Sequence[AskedQuestion], camera: str, frames: int) -> list[list[dict[str, Any]]]:
    """Returns the rows of each exported frame: the questions that are asked at this frame, and their answers.

    Args:
        questions: questions about the episode with their exported frames.
        camera: image feature that the questions are about.
        frames: number of exported frames.
    """
    rows: list[list[dict[str, Any]]] = [[] for _ in range(frames)]
    # events, because a persistent row would be active until the next one, when its answer is no longer valid
    shared = {"style": "vqa", "camera": camera, "tool_calls": None}
    for each in questions:
        rows[each.frame] += [
            {"role": "user", "content": each.question, **shared},
            {"role": "assistant", "content": each.answer, **shared},
        ]
    return rows


def with_questions(table: pa.Table, rows: Sequence[Sequence[dict[str, Any]]]) -> pa.Table:
    """Returns the table of frames with the column of questions; `rows` has one entry for each frame."""
    return table.append_column(pa.field(EVENTS, EVENTS_TYPE), pa.array(list(map(list, rows)), EVENTS_TYPE))

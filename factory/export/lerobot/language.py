"""Column `language_persistent` of LeRobot 0.6: sub-instructions as rows of the style `subtask`. Opens no file.

Every frame has all rows of its episode; a row is active from its `timestamp` until that of the next one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pyarrow as pa

from schemas.language.route.model import SubInstruction

COLUMN = "language_persistent"
FEATURE: dict[str, Any] = {"dtype": "language", "shape": [1], "names": None}
"""Entry of `features` in `info.json`."""
TYPE = pa.list_(
    pa.struct(
        [
            pa.field("role", pa.string(), nullable=False),
            *(pa.field(name, pa.string()) for name in ("content", "style")),
            pa.field("timestamp", pa.float32(), nullable=False),
            pa.field("camera", pa.string()),
            pa.field("tool_calls", pa.list_(pa.string())),
        ]
    )
)
"""Type of the column (lerobot/datasets/language.py)."""


def subtask_rows(steps: Sequence[SubInstruction], hz: int, stride: int, frames: int) -> list[dict[str, Any]]:
    """Returns the rows of an episode.

    Args:
        steps: sub-instructions in their order.
        hz: recorded frames per second.
        stride: stride of the exported frames; a row begins at the first exported frame of its span, and a step
            without an exported frame has no row.
        frames: number of exported frames.
    """
    shared = {"role": "assistant", "style": "subtask", "camera": None, "tool_calls": None}
    first = {min(-(-each.start // stride), frames - 1): each for each in steps}
    return [shared | {"content": each.text, "timestamp": t * stride / hz} for t, each in first.items()]


def with_subtasks(table: pa.Table, rows: Sequence[dict[str, Any]]) -> pa.Table:
    """Returns the frames of an episode with the column of its rows."""
    return table.append_column(pa.field(COLUMN, TYPE), pa.array([list(rows)] * len(table), TYPE))

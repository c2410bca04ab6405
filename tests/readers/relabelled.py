"""Reads instructions, sub-instructions and questions of a relabelled dataset from its tables.

Does not import this project.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq


class RelabelledTables:
    """Tables of a relabelled dataset with routes."""

    def __init__(self, root: Path) -> None:
        found = pq.read_table(root / "instructions.parquet").to_pylist()
        self.first = {row["episode_id"]: row["instruction"] for row in found if row["number"] == 1}
        """First instruction by episode."""
        self._steps = pq.read_table(root / "steps.parquet").to_pylist()
        self._questions = pq.read_table(root / "questions.parquet").to_pylist()
        self.episodes = len(self.first)

    def steps(self, episode_id: str) -> list[dict[str, Any]]:
        """Returns text, start and end of the sub-instructions of the first route of an episode."""
        own = [row for row in self._steps if row["episode_id"] == episode_id]
        chosen = [row for row in own if row["number"] == min(each["number"] for each in own)]
        return [{"text": row["instruction"], "start": row["start"], "end": row["end"]} for row in chosen]

    def questions(self, episode_id: str) -> dict[int, list[tuple[str, str]]]:
        """Returns frame -> (role, text) pairs of the questions that start at this frame, and of their answers."""
        found: dict[int, list[tuple[str, str]]] = {}
        own = (row for row in self._questions if row["episode_id"] == episode_id)
        for row in sorted(own, key=lambda row: row["number"]):
            space = "" if row["language"] == "zh" else " "
            answer = row["answer"] if row["reason"] is None else row["answer"] + space + row["reason"]
            found.setdefault(row["start"], []).extend([("user", row["question"]), ("assistant", answer)])
        return found


def counted(steps: Iterable[list[dict[str, Any]]]) -> str:
    """Returns a text with the numbers of compared sub-instructions and routes.

    Raises:
        AssertionError: no episode has a route.
    """
    found = [each for each in steps if each]
    assert found, "no episode has a route"
    return f"{sum(map(len, found))} sub-instructions of {len(found)} routes with their spans"

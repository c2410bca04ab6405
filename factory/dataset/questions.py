"""Builds rows of `questions.parquet` from verified questions, or from the questions in the metadata of episodes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import pyarrow as pa

from factory.dataset.episode import Episode
from schemas.language.question.meaning import Question

QUESTIONS_SCHEMA = pa.schema(
    [
        ("episode_id", pa.string()),
        *((name, pa.int64()) for name in ("index", "number", "start", "end")),
        *((name, pa.string()) for name in ("kind", "question", "answer", "reason")),
        *((name, pa.string()) for name in ("language", "template_id", "meaning")),
        ("held_out", pa.bool_()),
    ]
)
"""Columns of `questions.parquet` (docs/language.md#questions)."""


def question_rows(episode_id: str, index: int, questions: Sequence[Question]) -> list[dict[str, Any]]:
    """Returns the rows of the questions of an episode.

    Args:
        episode_id: id of the episode.
        index: number of the episode in the plan.
        questions: verified questions.
    """
    return [
        {
            **each.model_dump(exclude={"meaning"}),
            "episode_id": episode_id,
            "index": index,
            "number": number,
            "kind": str(each.meaning.kind),
            "meaning": each.meaning.model_dump_json(),
        }
        for number, each in enumerate(questions, 1)
    ]


def recorded_questions(episodes: Iterable[Episode]) -> pa.Table:
    """Returns the table of the questions that workers recorded in the metadata of episodes.

    Raises:
        ArchiveCorrupt: an episode is damaged.
    """
    rows = []
    for episode in episodes:
        with episode:
            rows += question_rows(episode.episode_id, episode.summary.index, episode.meta.questions)
    return pa.Table.from_pylist(rows, schema=QUESTIONS_SCHEMA)

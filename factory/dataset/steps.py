"""Reads instructions, sub-instructions of routes, and questions of a relabelled dataset. Writes nothing."""

from __future__ import annotations

import pyarrow as pa
import pyarrow.parquet as pq

from schemas.dataset.meta import DatasetMeta
from schemas.errors import ArchiveCorrupt
from schemas.language.question.meaning import Question, QuestionMeaning
from schemas.language.route.meaning import RouteStep, SubInstruction
from schemas.storage.dataset_files import INSTRUCTIONS_FILE, QUESTIONS_FILE, STEPS_FILE
from schemas.storage.place import Place, table_of
from schemas.support.foreign import PARSER_ERRORS


def has_routes(root: Place) -> bool:
    """Returns whether a dataset has a table of sub-instructions."""
    return (root / STEPS_FILE).is_file()


def has_questions(root: Place, meta: DatasetMeta) -> bool:
    """Returns whether a dataset has questions: written by `factory relabel`, or recorded because the plan has them."""
    planned = meta.plan.language
    return (root / QUESTIONS_FILE).is_file() or (planned is not None and planned.questions)


def read_text_table(path: Place, episode_id: str | None = None) -> pa.Table:
    """Returns a table that `factory relabel` wrote.

    Args:
        path: location of the Parquet file.
        episode_id: episode whose rows are read; by default all.

    Raises:
        ArchiveCorrupt: the table is damaged.
    """
    wanted = None if episode_id is None else [("episode_id", "==", episode_id)]
    try:
        return pq.read_table(table_of(path), filters=wanted)
    except (pa.ArrowException, *PARSER_ERRORS) as error:
        raise ArchiveCorrupt(f"{path} is damaged ({error}): run `factory relabel` again") from error


def read_instruction(root: Place, episode_id: str) -> str | None:
    """Returns the instruction that `factory relabel` wrote for an episode; `None` if it wrote none.

    Raises:
        ArchiveCorrupt: the table is damaged.
    """
    if not (root / INSTRUCTIONS_FILE).is_file():
        return None
    rows = read_text_table(root / INSTRUCTIONS_FILE, episode_id).to_pylist()
    return min(((row["number"], str(row["instruction"])) for row in rows), default=(0, None))[1]


def read_steps(root: Place, episode_id: str) -> tuple[SubInstruction, ...]:
    """Returns the sub-instructions of the first route of an episode; empty if it has none.

    Raises:
        ArchiveCorrupt: the table is damaged.
    """
    if not has_routes(root):
        return ()
    rows = read_text_table(root / STEPS_FILE, episode_id).to_pylist()
    first = min((row["number"] for row in rows), default=0)
    return tuple(
        SubInstruction(
            number=row["step"],
            text=row["instruction"],
            step=RouteStep.model_validate_json(row["meaning"]),
            start=row["start"],
            end=row["end"],
        )
        for row in rows
        if row["number"] == first
    )


def read_questions(root: Place, episode_id: str) -> tuple[Question, ...] | None:
    """Returns the questions about an episode that `factory relabel` wrote; `None` if it wrote none for the dataset.

    Raises:
        ArchiveCorrupt: the table is damaged.
    """
    if not (root / QUESTIONS_FILE).is_file():
        return None
    rows = read_text_table(root / QUESTIONS_FILE, episode_id).to_pylist()
    names = [name for name in Question.model_fields if name != "meaning"]
    return tuple(
        Question(**{name: row[name] for name in names}, meaning=QuestionMeaning.model_validate_json(row["meaning"]))
        for row in sorted(rows, key=lambda row: int(row["number"]))
    )

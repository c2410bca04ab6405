"""Writes the instructions and routes of some episodes of one scene into a part file. Changes no dataset."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from factory.dataset.episode import Episode
from factory.dataset.packages import ScenePackage
from factory.dataset.questions import QUESTIONS_SCHEMA, question_rows
from factory.dataset.reader import Dataset
from schemas.config import CameraConfig
from schemas.language.compose import Composer, composer_of
from schemas.language.graph.view import look
from schemas.language.instruction import Instruction, InstructionKind
from schemas.language.language_file import LanguageSpec, TextKind
from schemas.language.question.compose import AskedEpisode, QuestionComposer
from schemas.language.question.meaning import Question
from schemas.language.route.compose import RouteComposer
from schemas.language.route.meaning import RouteText
from schemas.language.route.steps import SceneRoutes
from schemas.language.scene import SceneLanguage
from schemas.storage.dataset_files import QUESTIONS_FILE, STEPS_FILE
from schemas.storage.disk import replacing
from schemas.storage.place import Place
from schemas.terms import Recording, Split

STEPS_SCHEMA = pa.schema(
    [
        ("episode_id", pa.string()),
        *((name, pa.int64()) for name in ("index", "number", "step", "start", "end")),
        *((name, pa.string()) for name in ("kind", "instruction", "language", "register", "template_id", "meaning")),
        ("held_out", pa.bool_()),
    ]
)
"""Columns of `steps.parquet` (docs/language.md#routes)."""


def route_row(episode_id: str, index: int, route: RouteText, distractors: int) -> dict[str, Any]:
    """Returns the row of a route in `instructions.parquet`, without its number."""
    kinds = sorted({str(each.step.kind) for each in route.steps})
    return {
        "episode_id": episode_id,
        "index": index,
        "kind": str(InstructionKind.ROUTE),
        "instruction": route.text,
        "language": route.language,
        "register": route.register_name,
        "template_id": route.template_id,
        "held_out": route.held_out,
        "expression": json.dumps([each.step.model_dump(mode="json") for each in route.steps]),
        "features": ",".join(kinds),
        "is_minimal": False,
        "fits": 1,
        "distractors": distractors,
    }


def step_rows(row: dict[str, Any], route: RouteText) -> Sequence[dict[str, Any]]:
    """Returns the rows of the steps of a route.

    Args:
        row: row of the route in `instructions.parquet`, with its number.
        route: the route.
    """
    shared = {name: row[name] for name in ("episode_id", "index", "number", "language", "register", "template_id")}
    return [
        {
            **shared,
            "held_out": route.held_out,
            "step": each.number,
            "start": each.start,
            "end": each.end,
            "kind": str(each.step.kind),
            "instruction": each.text,
            "meaning": each.step.model_dump_json(),
        }
        for each in route.steps
    ]


_STREAM, _ROUTE_STREAM, _QUESTION_STREAM = 23, 24, 25
"""Spawn keys of the random streams of instructions, routes and questions."""
SCHEMA = pa.schema(
    [
        ("episode_id", pa.string()),
        ("index", pa.int64()),
        ("number", pa.int64()),
        *((name, pa.string()) for name in ("kind", "instruction", "language", "register", "template_id")),
        ("held_out", pa.bool_()),
        *((name, pa.string()) for name in ("expression", "features")),
        ("is_minimal", pa.bool_()),
        ("fits", pa.int64()),
        ("distractors", pa.int64()),
        *((name, pa.string()) for name in ("clean", "mistake")),
    ]
)
"""Columns of `instructions.parquet` (docs/language.md#files)."""


@dataclass(frozen=True)
class LanguageStart:
    """Values of an episode that determine its instructions."""

    episode_id: str
    index: int
    """Number of the episode in the plan."""
    split: str
    target_id: str
    category: str
    """Category of the target."""
    pose: tuple[float, float, float]
    """x, y in metres and yaw in radians of base_link at frame 0."""
    instruction: str
    """Recorded instruction."""
    template_id: str
    """Template of the recorded instruction."""


class PartTask(NamedTuple):
    """Picklable task: some episodes of one scene."""

    root: Place
    """Location of the source."""
    package: ScenePackage
    camera: CameraConfig
    spec: LanguageSpec
    starts: tuple[LanguageStart, ...]
    file: Path
    """Part file of instructions. It is written last: if it exists, the task is complete."""

    def beside(self, name: str) -> Path:
        """Returns the part file of this task for another table of the dataset."""
        return self.file.with_name(f"{self.file.stem}-{name}")


class PartResult(NamedTuple):
    """Result of a task."""

    episodes: int
    rejected: Counter[str]
    """Number of sentences that the verifier rejected, by reason."""


def make_part(task: PartTask) -> PartResult:
    """Writes the part file of a task.

    Raises:
        ArchiveCorrupt: the scene package is missing or damaged.
        WorldError: the disk is full or not available.
    """
    scene, writer = task.package.language(), PartWriter(task)
    scene.rejected.clear()
    for start in task.starts:
        writer.add(start)
    for name, (rows, schema) in writer.tables.items():
        _write(task.beside(name), rows, schema)
    _write(task.file, writer.rows, SCHEMA)
    return PartResult(len(task.starts), scene.rejected + writer.routes.rejected + writer.questions.rejected)


def _write(file: Path, rows: list[dict[str, Any]], schema: pa.Schema) -> None:
    with replacing(file, durable=True) as part:
        pq.write_table(pa.Table.from_pylist(rows, schema=schema), part, compression="zstd", write_page_checksum=True)


class PartWriter:
    """Writer of the rows of a part.

    Args:
        task: episodes and language file.
    """

    def __init__(self, task: PartTask) -> None:
        self._task = task
        self._scene, self._composer = task.package.language(), Composer(task.spec)
        self.routes, self.questions = RouteComposer(task.spec), QuestionComposer(self._composer)
        self._place = SceneRoutes(self._scene, task.camera)
        needs_poses = TextKind.ROUTE in task.spec.kinds or task.spec.questions
        self._dataset = Dataset(task.root) if needs_poses else None
        self.rows: list[dict[str, Any]] = []
        """Rows of `instructions.parquet`."""
        self.tables: dict[str, tuple[list[dict[str, Any]], pa.Schema]] = {}
        """Rows and schema of the other tables by file name."""
        if TextKind.ROUTE in task.spec.kinds:
            self.tables[STEPS_FILE] = ([], STEPS_SCHEMA)
        if task.spec.questions:
            self.tables[QUESTIONS_FILE] = ([], QUESTIONS_SCHEMA)

    def add(self, start: LanguageStart) -> None:
        if self._dataset is None:
            self._add(start, None)
        else:
            with self._dataset[start.episode_id] as episode:
                self._add(start, episode)

    def _add(self, start: LanguageStart, episode: Episode | None) -> None:
        kinds, instructions = self._task.spec.kinds, []
        if TextKind.GOAL in kinds:
            composer = composer_of(self._task.spec.of_episode(start.index))
            instructions = instructions_of(start, self._scene, composer, self._task.camera)
        routes = self._routes(start, episode) if episode is not None and TextKind.ROUTE in kinds else []
        number = self._scene.graph.number_of[start.target_id]
        route_rows = [
            route_row(start.episode_id, start.index, each, self._scene.distractors(number)) for each in routes
        ]
        rows = rows_of(start, instructions, route_rows)
        self.rows += rows
        by_text = {each.text: each for each in routes}
        for row in rows:
            if row["kind"] == InstructionKind.ROUTE:
                self.tables[STEPS_FILE][0].extend(step_rows(row, by_text[row["instruction"]]))

        if episode is not None and self._task.spec.questions:
            question_rows_ = question_rows(start.episode_id, start.index, self._questions(start, episode, instructions))
            self.tables[QUESTIONS_FILE][0].extend(question_rows_)

    def _rng(self, start: LanguageStart, stream: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence((self._task.spec.seed, start.index), spawn_key=(stream,)))

    def _routes(self, start: LanguageStart, episode: Episode) -> list[RouteText]:
        held_out = Split(start.split).is_paraphrased
        number = self._scene.graph.number_of[start.target_id]
        return self.routes.write(self._place, episode.poses, number, held_out, self._rng(start, _ROUTE_STREAM))

    def _questions(self, start: LanguageStart, episode: Episode, instructions: Sequence[Instruction]) -> list[Question]:
        """Returns the questions about an episode; checks answers about a view with the recorded images, if any."""
        assert self._dataset is not None
        images = episode if self._dataset.meta.plan.record is Recording.FRAMES else None
        goals = tuple(each for each in instructions if each.kind is InstructionKind.GOAL)
        number, held_out = self._scene.graph.number_of[start.target_id], Split(start.split).is_paraphrased
        episode_of_questions = AskedEpisode(
            episode.poses,
            number,
            goals=goals,
            is_false_premise=Split(start.split) is Split.TEST_FALSE_PREMISE,
            images=images,
        )
        return self.questions.write(self._place, episode_of_questions, held_out, self._rng(start, _QUESTION_STREAM))


def instructions_of(
    start: LanguageStart, scene: SceneLanguage, composer: Composer, camera: CameraConfig
) -> list[Instruction]:
    """Returns the new instructions of an episode. Their random numbers depend on its index and the seed only."""
    seed = np.random.SeedSequence((composer.spec.seed, start.index), spawn_key=(_STREAM,))
    view = look(scene.graph, start.pose, camera)
    held_out = Split(start.split).is_paraphrased
    number = scene.graph.number_of[start.target_id]
    return composer.write(scene, view, number, held_out, np.random.default_rng(seed))


def rows_of(
    start: LanguageStart, instructions: list[Instruction], routes: Sequence[dict[str, Any]] = ()
) -> list[dict[str, Any]]:
    """Returns the numbered rows of an episode: first its goals and routes, then all other instructions.

    If the episode has neither a goal nor a route, the first row is the recorded instruction.

    Args:
        start: values of the episode.
        instructions: new instructions.
        routes: rows of routes without their number.
    """
    goals = [_row(start, each) for each in instructions if each.kind is InstructionKind.GOAL]
    others = [_row(start, each) for each in instructions if each.kind is not InstructionKind.GOAL]
    rows = [*([*goals, *routes] or [_recorded(start)]), *others]
    return [{**row, "number": number} for number, row in enumerate(rows, 1)]


def _row(start: LanguageStart, one: Instruction) -> dict[str, Any]:
    values = one.model_dump(mode="json")
    renamed = {"instruction": values.pop("text"), "register": values.pop("register_name")}
    return {"episode_id": start.episode_id, "index": start.index, **values, **renamed}


def _recorded(start: LanguageStart) -> dict[str, Any]:
    known = {"episode_id": start.episode_id, "index": start.index, "kind": str(InstructionKind.RECORDED)}
    recorded = {"instruction": start.instruction, "template_id": start.template_id, "language": "en"}
    return dict.fromkeys(SCHEMA.names) | known | recorded

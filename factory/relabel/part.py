"""Writes the instructions of some episodes of one scene into a part file. Changes no dataset."""

from __future__ import annotations

import functools
import io
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from factory.dataset.packages import ScenePackage
from schemas.config import CameraConfig
from schemas.language.compose import Composer, Instruction, InstructionKind, SceneLanguage
from schemas.language.file import LanguageSpec
from schemas.language.graph import build_graph
from schemas.language.view import look
from schemas.scene import decode_scene
from schemas.storage.disk import replacing
from schemas.terms import Split

_KEPT_SCENES = 2
_STREAM = 23
"""Spawn key of the random stream of instructions."""
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
    ]
)
"""Columns of `instructions.parquet` (docs/language.md#files)."""


@dataclass(frozen=True)
class LanguageStart:
    """Values of an episode from which instructions follow."""

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

    package: ScenePackage
    camera: CameraConfig
    spec: LanguageSpec
    starts: tuple[LanguageStart, ...]
    file: Path
    """Part file, which is written as a whole."""


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
    scene, composer = prepared_scene(task.package), Composer(task.spec)
    scene.rejected.clear()
    rows = [
        row for start in task.starts for row in rows_of(start, instructions_of(start, scene, composer, task.camera))
    ]
    with replacing(task.file, durable=True) as part:
        pq.write_table(pa.Table.from_pylist(rows, schema=SCHEMA), part, compression="zstd", write_page_checksum=True)
    return PartResult(len(task.starts), Counter(scene.rejected))


@functools.lru_cache(maxsize=_KEPT_SCENES)
def prepared_scene(package: ScenePackage) -> SceneLanguage:
    """Returns the scene graph of a package; those of the most recently used scenes are kept.

    Raises:
        ArchiveCorrupt: the package is missing or damaged.
    """
    return SceneLanguage(build_graph(decode_scene(io.BytesIO(package.read()))))


def instructions_of(
    start: LanguageStart, scene: SceneLanguage, composer: Composer, camera: CameraConfig
) -> list[Instruction]:
    """Returns the new instructions of an episode; they depend on its index and the language file only."""
    seed = np.random.SeedSequence((composer.spec.seed, start.index), spawn_key=(_STREAM,))
    view = look(scene.graph, start.pose, camera)
    held_out = Split(start.split).is_paraphrased
    number = scene.graph.number_of[start.target_id]
    return composer.write(scene, view, number, held_out, np.random.default_rng(seed))


def rows_of(start: LanguageStart, found: list[Instruction]) -> list[dict[str, Any]]:
    """Returns the rows of an episode: goals first, or the recorded instruction if the episode has no goal."""
    goals = [each for each in found if each.kind is InstructionKind.GOAL]
    others = [each for each in found if each.kind is not InstructionKind.GOAL]
    rows = [_row(start, each) for each in goals] or [_recorded(start)]
    return [{**row, "number": number} for number, row in enumerate([*rows, *(_row(start, each) for each in others)], 1)]


def _row(start: LanguageStart, one: Instruction) -> dict[str, Any]:
    values = one.model_dump(mode="json")
    renamed = {"instruction": values.pop("text"), "register": values.pop("register_name")}
    return {"episode_id": start.episode_id, "index": start.index, **values, **renamed}


def _recorded(start: LanguageStart) -> dict[str, Any]:
    known = {"episode_id": start.episode_id, "index": start.index, "kind": str(InstructionKind.RECORDED)}
    said = {"instruction": start.instruction, "template_id": start.template_id, "language": "en"}
    return dict.fromkeys(SCHEMA.names) | known | said

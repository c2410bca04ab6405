"""Relabels a dataset: writes parts of instructions in several processes, then the dataset with the new instructions.

Episodes and scenes of the source are linked, and the source is not changed. An interrupted call continues where it
stopped; every file is written atomically, `dataset_meta.json` last. Also prints the report.
"""

from __future__ import annotations

import hashlib
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import click
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pydantic import Field, ValidationError

from coordinator.archive.opening import open_archive
from coordinator.tables.aggregates import aggregate_episodes
from coordinator.tables.card import dataset_card, splits_at, with_shards
from coordinator.tables.row_groups import RowGroupWriter
from coordinator.tables.split_tables import write_split_tables
from factory.dataset.packages import ScenePackage
from factory.dataset.reader import Dataset
from factory.export.output import WORK_FOLDER, Output
from factory.relabel.paraphrase import ParaphraseReport
from factory.relabel.part import LanguageStart, PartTask, make_part
from factory.support.task_pool import run_tasks
from factory.support.terminal import print_table
from schemas.base import Model, Sha256
from schemas.dataset.meta import Relabelling, software_versions
from schemas.errors import InvalidLanguage, UsageError, WorldError
from schemas.language.compose import composer_of, explain_impossible
from schemas.language.graph.view import look
from schemas.language.instruction import InstructionKind
from schemas.language.language_file import LanguageSpec, TextKind
from schemas.scene.info import TEXTURES
from schemas.storage.dataset_files import (
    ATTEMPTS_FILE,
    CARD_FILE,
    EPISODES,
    INSTRUCTIONS_FILE,
    META_FILE,
    METADATA_FILE,
    QUESTIONS_FILE,
    RELABEL_FILE,
    SCENES,
    SHARDS_FILE,
    SPLITS_FOLDER,
    STEPS_FILE,
)

_GROUP_ROWS = 20_000
"""Number of rows of a row group. To read the rows of one episode, a reader decodes a whole group."""
_NEW_COLUMNS = ("instruction", "template_id")


def assemble(
    dataset: Dataset, instructions: pa.Table, others: Mapping[str, pa.Table], spec: LanguageSpec, output: Output
) -> None:
    """Writes all files of the relabelled dataset.

    Args:
        dataset: source, in a directory.
        instructions: rows of `instructions.parquet`, ordered by episode and number.
        others: additional tables by their file name, ordered by episode.
        spec: content of the language file.
        output: opened output directory.

    Raises:
        WorldError: the disk is full or not available.
    """
    source = Path(str(dataset.root))
    output.begin_finish([dataset.digest])
    # links, because rewriting the episodes would copy terabytes and change their digests
    for folder in (EPISODES, SCENES, f"{SCENES}/{TEXTURES}", SPLITS_FOLDER):
        for file in sorted((source / folder).glob("*")):
            if file.is_file() and not output.has(f"{folder}/{file.name}"):
                output.link(file, f"{folder}/{file.name}")
    for name in (ATTEMPTS_FILE, SHARDS_FILE):
        if (source / name).is_file():
            output.link(source / name, name)
    for name, table in {INSTRUCTIONS_FILE: instructions, **others}.items():
        with output.replacing(name) as part:
            pq.write_table(table, part, compression="zstd", write_page_checksum=True, row_group_size=_GROUP_ROWS)
    _write_metadata(source, instructions, output)
    _write_description(dataset, instructions, spec, output)
    with open_archive(output.root) as archive:
        write_split_tables(archive)


def _write_metadata(source: Path, instructions: pa.Table, output: Output) -> None:
    """Writes the metadata of the source with the first instruction of each episode."""
    first = instructions.filter(pc.equal(instructions["number"], 1))
    ids = pa.array(first["episode_id"].to_pylist())
    with (
        pq.ParquetFile(source / METADATA_FILE) as file,
        output.replacing(METADATA_FILE) as part,
        part.open("wb") as raw,
        RowGroupWriter(raw, file.schema_arrow) as writer,
    ):
        for number in range(file.num_row_groups):
            rows = file.read_row_group(number)
            places = pc.index_in(rows["episode_id"], value_set=ids)
            for name in _NEW_COLUMNS:
                rows = rows.set_column(rows.schema.get_field_index(name), name, first[name].take(places))
            writer.add(rows)


def _write_description(dataset: Dataset, instructions: pa.Table, spec: LanguageSpec, output: Output) -> None:
    kept = pc.sum(pc.equal(instructions["kind"], InstructionKind.RECORDED)).as_py()
    languages = tuple(sorted(code for code, share in spec.languages.items() if share > 0))
    made = Relabelling(
        spec=spec.model_dump_json(), languages=languages, instructions=len(instructions), recorded=int(kept or 0)
    )
    meta = dataset.meta.model_copy(update={"relabelling": made, "updated_at": datetime.now(UTC)})
    with pq.ParquetFile(output.root / METADATA_FILE) as file:
        aggregates = aggregate_episodes(file.read())
    shards = len(list((output.root / EPISODES).glob("shard_*.zip")))
    output.write_text(CARD_FILE, with_shards(dataset_card(meta, aggregates, splits_at(output.root)), shards))
    output.write_text(META_FILE, meta.model_dump_json(indent=1))


_PART_EPISODES = 500
_PROBES = 200
"""Approximate number of episodes of each scene that are tested for possible instructions before any part is written."""
_COLUMNS = (
    *("episode_id", "index", "split", "scene", "scene_sha256", "target_id", "target_category"),
    *("spawn_x_m", "spawn_y_m", "spawn_yaw_rad", "instruction", "template_id"),
)


class RelabelOrder(Model):
    """Inputs of a relabelling; equal inputs give equal files."""

    source_digest: Sha256
    """Digest of the episodes of the source."""
    rows_digest: Sha256
    """SHA-256 of the metadata table of the source."""
    spec: LanguageSpec
    """Content of the language file."""
    software: dict[str, str]
    """Versions of the packages on which the instructions depend."""


class RelabelReport(Model):
    """Result of a relabelling."""

    out: str
    """Directory of the dataset with the new instructions."""
    finished: bool
    """Whether all episodes have been processed."""
    episodes: int
    """Number of episodes processed."""
    instructions: int = 0
    """Number of new instructions that name the target."""
    routes: int = 0
    """Number of instructions that describe the driven path."""
    false_premises: int = 0
    """Number of instructions that name an object that does not exist."""
    questions: int = 0
    """Number of questions with verified answers."""
    recorded: int = 0
    """Number of episodes that keep their recorded instruction."""
    distinct: int = 0
    """Number of distinct sentences."""
    patterns: int = 0
    """Number of distinct sentence patterns."""
    minimal: int = 0
    """Number of new instructions whose expression for the target has no unnecessary part."""
    languages: dict[str, int] = Field(default_factory=dict)
    """Number of instructions by language."""
    features: dict[str, int] = Field(default_factory=dict)
    """Number of instructions by features; an instruction may have several."""
    rejected: dict[str, int] = Field(default_factory=dict)
    """Number of sentences that the verifier rejected, by reason, in this call."""
    paraphrases: ParaphraseReport | None = None
    """Paraphrases that were requested from an endpoint in this call; `None` without a request."""


class _Job(NamedTuple):
    """Scene with its episodes."""

    package: ScenePackage
    starts: tuple[LanguageStart, ...]


_SAID = (InstructionKind.GOAL, InstructionKind.ROUTE)
Progress = Callable[[int, int], None]


def relabel(
    root: Path,
    out: Path,
    spec: LanguageSpec,
    workers: int = 0,
    on_progress: Progress = lambda _done, _total: None,
    stop: threading.Event | None = None,
) -> RelabelReport:
    """Writes a dataset with new instructions, or continues an interrupted call.

    Args:
        root: directory of the source.
        out: directory of the new dataset.
        spec: content of the language file.
        workers: number of processes; 0 writes all parts in this process.
        on_progress: called with the number of processed episodes and the total.
        stop: event that interrupts the work; finished parts are kept.

    Raises:
        UsageError: the source has no episodes, or `out` contains other files or another relabelling.
        InvalidLanguage: no target of a scene can get an instruction, and the error lists what is possible there; or
            the language file has a key for plans only.
        ArchiveCorrupt: the source is damaged.
        WorldError: the disk is full or not available.
    """
    if spec.exchangeable:
        fault = "exchangeable: a plan can draw the target at the start, but an episode already has one: remove the key"
        raise InvalidLanguage("the language file has a key for plans only", [fault])
    dataset = Dataset(root)
    if not len(dataset):
        raise UsageError(f"{root} has no episodes")
    order = _order_of(dataset, spec)
    _require_same(out, order)
    if (out / META_FILE).is_file() and not (out / WORK_FOLDER).exists():
        return _report(out, len(dataset), pq.read_table(out / INSTRUCTIONS_FILE), Counter())
    jobs = list(_jobs(dataset))
    _require_possible(dataset, jobs, spec)
    stop = stop or threading.Event()
    with Output(out) as output:
        output.write_text(RELABEL_FILE, order.model_dump_json(indent=1) + "\n")
        tasks = list(_tasks(dataset, jobs, spec, output))
        files = [task.file for task in tasks]
        rejected = _write_parts(tasks, workers, on_progress, stop)
        if stop.is_set() or not all(file.is_file() for file in files):
            done = sum(pq.read_metadata(file).num_rows > 0 for file in files if file.is_file())
            return RelabelReport(out=str(out), finished=False, episodes=min(done * _PART_EPISODES, len(dataset)))
        table = pa.concat_tables([pq.read_table(file) for file in files]).sort_by(
            [("index", "ascending"), ("number", "ascending")]
        )
        assemble(dataset, table, others=_other_tables(tasks, spec), spec=spec, output=output)
        output.drop_work()
    return _report(out, len(dataset), table, rejected)


def _order_of(dataset: Dataset, spec: LanguageSpec) -> RelabelOrder:
    hasher = hashlib.sha256()
    for name in ("episode_id", "instruction", "target_id", "scene_sha256"):
        hasher.update("\n".join(map(str, dataset.column(name).to_pylist())).encode())
    versions = software_versions(("minivla-factory", "numpy", "scipy"))
    return RelabelOrder(source_digest=dataset.digest, rows_digest=hasher.hexdigest(), spec=spec, software=versions)


def _require_same(out: Path, order: RelabelOrder) -> None:
    """Raises `UsageError` unless a directory is empty or contains the same relabelling."""
    path = out / RELABEL_FILE
    if not path.is_file():
        if out.exists() and (not out.is_dir() or any(entry.name != WORK_FOLDER for entry in out.iterdir())):
            raise UsageError(f"{out} exists and is not a relabelled dataset: choose another --out")
        return
    recorded = _read_order(path)
    differing = [name for name in RelabelOrder.model_fields if getattr(recorded, name) != getattr(order, name)]
    if differing:
        named = {"source_digest": "dataset", "rows_digest": "metadata table of the dataset", "spec": "language file"}
        what = ", ".join(named.get(name, name) for name in differing)
        raise UsageError(f"{out} was relabelled with a different {what}: delete it, or choose another --out")


def _read_order(path: Path) -> RelabelOrder:
    try:
        return RelabelOrder.model_validate_json(path.read_bytes())
    except ValidationError as error:
        raise WorldError(f"{path} is damaged: delete {path.parent}, or choose another --out") from error


def recorded_paraphrases(out: Path, spec: LanguageSpec) -> LanguageSpec | None:
    """Returns the language file of the relabelling in `out`, if it differs from `spec` in its paraphrases only.

    Args:
        out: directory of the new dataset; it need not exist.
        spec: content of the language file without paraphrases of an endpoint.

    Raises:
        WorldError: `relabel.json` is damaged.
    """
    path = out / RELABEL_FILE
    recorded = _read_order(path).spec if path.is_file() else None
    is_same = recorded is not None and recorded.model_copy(update={"paraphrases": spec.paraphrases}) == spec
    return recorded if is_same else None


def _jobs(dataset: Dataset) -> Iterator[_Job]:
    """Yields each scene with its episodes; the scenes are ordered by their first episodes."""
    columns = pa.table({name: dataset.column(name) for name in _COLUMNS})
    for sha256 in pc.unique(columns["scene_sha256"]).to_pylist():
        rows = columns.filter(pc.equal(columns["scene_sha256"], sha256)).to_pylist()
        yield _Job(
            ScenePackage(dataset.root, rows[0]["scene"], sha256),
            tuple(
                LanguageStart(
                    episode_id=row["episode_id"],
                    index=row["index"],
                    split=row["split"],
                    target_id=row["target_id"],
                    category=row["target_category"],
                    pose=(row["spawn_x_m"], row["spawn_y_m"], row["spawn_yaw_rad"]),
                    instruction=row["instruction"],
                    template_id=row["template_id"],
                )
                for row in rows
            ),
        )


def _require_possible(dataset: Dataset, jobs: Sequence[_Job], spec: LanguageSpec) -> None:
    """Raises `InvalidLanguage` if a category has no noun in a language, or no target of a scene gets an instruction."""
    camera = dataset.meta.plan.camera
    faults = composer_of(spec).missing_nouns([start.category for job in jobs for start in job.starts])
    for job in [] if faults or TextKind.GOAL not in spec.kinds else jobs:
        scene = job.package.language()
        starts = job.starts[:: max(1, len(job.starts) // _PROBES)]
        number_of = scene.graph.number_of
        probes = [(number_of[start.target_id], look(scene.graph, start.pose, camera)) for start in starts]
        why = explain_impossible(scene, spec, probes)
        faults += [f"scene {job.package.name}: {why}"] if why else []
    if faults:
        raise InvalidLanguage("the language file does not fit the dataset", faults)


def _tasks(dataset: Dataset, jobs: Sequence[_Job], spec: LanguageSpec, output: Output) -> Iterator[PartTask]:
    number = 0
    for job in jobs:
        for first in range(0, len(job.starts), _PART_EPISODES):
            starts = job.starts[first : first + _PART_EPISODES]
            yield PartTask(
                dataset.root,
                job.package,
                camera=dataset.meta.plan.camera,
                spec=spec,
                starts=starts,
                file=_part_file(output, number),
            )
            number += 1


def _part_file(output: Output, number: int) -> Path:
    return output.piece_folder(f"part-{number:06d}.parquet")


def _other_tables(tasks: Sequence[PartTask], spec: LanguageSpec) -> dict[str, pa.Table]:
    """Returns the tables of steps and of questions by file name; omits a table that the language file does not need."""
    keys: dict[str, tuple[str, ...]] = {STEPS_FILE: ("index", "number", "step")} if TextKind.ROUTE in spec.kinds else {}
    keys |= {QUESTIONS_FILE: ("index", "number")} if spec.questions else {}
    return {
        name: pa.concat_tables([pq.read_table(task.beside(name)) for task in tasks]).sort_by(
            [(key, "ascending") for key in order]
        )
        for name, order in keys.items()
    }


def _write_parts(tasks: Sequence[PartTask], workers: int, on_progress: Progress, stop: threading.Event) -> Counter[str]:
    """Writes the parts that are missing; returns the rejected sentences by reason."""
    left = [task for task in tasks if not task.file.is_file()]
    total = sum(len(task.starts) for task in tasks)
    done = total - sum(len(task.starts) for task in left)
    rejected: Counter[str] = Counter()
    for result in run_tasks(make_part, left, workers, stop):
        done += result.episodes
        rejected += result.rejected
        on_progress(done, total)
    return rejected


def _report(out: Path, episodes: int, table: pa.Table, rejected: Counter[str]) -> RelabelReport:
    rows = table.select(["kind", "language", "features", "is_minimal"]).to_pylist()
    goals = [row for row in rows if row["kind"] == InstructionKind.GOAL]
    return RelabelReport(
        out=str(out),
        finished=True,
        episodes=episodes,
        instructions=len(goals),
        routes=sum(row["kind"] == InstructionKind.ROUTE for row in rows),
        false_premises=sum(row["kind"] == InstructionKind.FALSE_PREMISE for row in rows),
        questions=pq.read_metadata(out / QUESTIONS_FILE).num_rows if (out / QUESTIONS_FILE).is_file() else 0,
        recorded=sum(row["kind"] == InstructionKind.RECORDED for row in rows),
        distinct=len(pc.unique(table["instruction"])),
        patterns=len(pc.unique(table["template_id"])),
        minimal=sum(row["is_minimal"] for row in goals),
        languages=dict(sorted(Counter(row["language"] for row in rows if row["kind"] in _SAID).items())),
        features=dict(sorted(Counter(name for row in goals for name in row["features"].split(",") if name).items())),
        rejected=dict(sorted(rejected.items())),
    )


def print_report(report: RelabelReport) -> None:
    """Prints the numbers of instructions, by language and feature, and the paraphrases."""
    click.echo(f"{report.out}: {report.instructions} instructions for {report.episodes} episodes")
    if report.recorded:
        click.echo(f"{report.recorded} episodes keep their recorded instruction: no new one fits their target only")
    numbers = (
        ("distinct sentences", report.distinct),
        ("sentence patterns", report.patterns),
        ("minimal expressions", report.minimal),
        ("routes", report.routes),
        ("false premises", report.false_premises),
        ("questions", report.questions),
        ("rejected by the verifier", sum(report.rejected.values())),
    )
    print_table("", ("measure", "number"), numbers)
    if report.paraphrases is not None:
        _print_paraphrases(report.paraphrases)
    print_table("Languages", ("language", "instructions"), report.languages.items())
    print_table("Features", ("feature", "instructions"), report.features.items())


def _print_paraphrases(report: ParaphraseReport) -> None:
    click.echo(f"{report.accepted} paraphrased sentence patterns")
    omitted = [*report.refused.items(), *((f"endpoint: {reason}", count) for reason, count in report.failed.items())]
    if omitted:
        print_table("Paraphrases that were not added", ("reason", "number"), omitted)

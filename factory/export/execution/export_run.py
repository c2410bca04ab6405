"""Runs an export: selects episodes, exports missing pieces in worker processes, finishes. Resumes every format.

A task of one episode writes into its staging folder only.
"""

from __future__ import annotations

import hashlib
import shlex
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypedDict

from factory.dataset.episode import Episode
from factory.dataset.reader import Dataset
from factory.export.base import AnyExporter, ExportPiece, Finish
from factory.export.execution.manifest import (
    ExportManifest,
    ExportReport,
    Skip,
    Source,
    of_software,
    require_same_export,
    write_manifest,
)
from factory.export.execution.selection import select
from factory.export.options import Options
from factory.export.output import Output, sync_tree
from factory.export.questions import QUESTIONS_FILE, count_questions, to_line
from factory.export.registry import find_exporter, require_packages, require_rig_support
from factory.export.rig.description import recorded_rig, rig_json
from factory.export.source import open_source, recorded_run, rows_digest
from factory.support.task_pool import run_tasks
from schemas.base import Model
from schemas.errors import ArchiveCorrupt, InvalidBundle, UsageError, WorldError
from schemas.job import episode_id
from schemas.rig import Rig
from schemas.storage.disk import translated
from schemas.storage.place import Place
from schemas.terms import Recording


class ExportTask:
    """Picklable task: one episode to export."""

    def __init__(self, exporter: str, options: str, episode: Episode, folder: Path) -> None:
        self.exporter = exporter
        self.options = options
        """Options as JSON."""
        self.episode = episode
        self.folder = folder
        """Staging folder; it does not exist yet."""


class PieceResult(Model):
    """Result of a task: facts or damage."""

    episode_id: str
    facts: str | None = None
    """Facts as JSON; the folder contains the synced piece."""
    damage: str | None = None
    """Reason why the episode could not be exported; the folder is deleted."""
    frames: int = 0


def make_piece(task: ExportTask) -> PieceResult:
    """Exports one episode into its staging folder.

    Raises:
        WorldError: the disk is full or not available; the folder is deleted.
    """
    name, folder = task.episode.episode_id, task.folder
    exporter = find_exporter(task.exporter)
    options = exporter.options.model_validate_json(task.options)
    whole = False
    try:
        with translated("write", folder), task.episode as episode:
            folder.mkdir(parents=True)
            _require_as_listed(episode)
            facts = exporter.write_episode(episode, options, folder)
            sync_tree(folder)
        whole = True
    except ArchiveCorrupt as error:
        return PieceResult(episode_id=name, damage=str(error))
    except InvalidBundle as error:
        text = f"{task.episode.path} is damaged ({'; '.join(error.findings)}): run `factory verify --deep`"
        return PieceResult(episode_id=name, damage=text)
    finally:
        if not whole:
            shutil.rmtree(folder, ignore_errors=True)
    return PieceResult(episode_id=name, facts=facts.model_dump_json(), frames=facts.frames)


def _require_as_listed(episode: Episode) -> None:
    """Validates that the content of a file matches its row of the metadata."""
    meta, row = episode.meta, episode.summary
    if meta.content_digest != row.content_digest:
        problem = f"{meta.episode_id} with content digest {meta.content_digest}, but the table has {row.content_digest}"
        raise ArchiveCorrupt(f"{episode.path} contains {problem}: run `factory verify --deep`")


_NAMED = 5


class ExportProgress(NamedTuple):
    """Progress of an export."""

    done: int
    """Number of exported or skipped episodes."""
    total: int
    """Number of selected episodes."""
    frames: int
    """Number of frames written in this call."""
    stage: str
    """Stage: `episodes`, then `finishing`."""


class _Stopped(Exception):
    """The user stopped the export during `finish`."""


ExportProgressCallback = Callable[[ExportProgress], None]


@dataclass(frozen=True)
class ExportOrder:
    """Specification of an export: dataset, selection, format, options and output directory."""

    root: Place
    """Root of the dataset."""
    out: Path
    format: str
    options: Options
    splits: tuple[str, ...] = ()
    """Selected splits; empty for all."""
    episodes: tuple[str, ...] = ()
    """Selected ids; empty for all."""
    excluded: tuple[str, ...] = ()
    """Ids to omit."""
    workers: int = 0
    """Number of worker processes; 0 exports in this process."""
    rig: str | Rig | None = None
    """Sensors to export instead of the recorded camera: a rig, the name of a built-in one, or a TOML file."""


@dataclass
class _State:
    """State of a running export."""

    order: ExportOrder
    exporter: AnyExporter
    dataset: Dataset
    out: Output
    stop: threading.Event
    on_progress: ExportProgressCallback
    pieces: dict[int, ExportPiece[Any]] = field(default_factory=dict)
    """Position in `dataset` -> piece."""
    skipped: dict[int, Skip] = field(default_factory=dict)
    """Position in `dataset` -> skipped episode."""
    frame_counts: dict[int, int] = field(default_factory=dict)
    """Position in `dataset` -> number of exported frames."""
    resumed: int = 0
    frames: int = 0
    """Number of frames written in this call."""

    def require_running(self) -> None:
        if self.stop.is_set():
            raise _Stopped

    def tell(self, stage: str) -> None:
        done = len(self.pieces) + len(self.skipped)
        self.on_progress(ExportProgress(done, len(self.dataset), self.frames, stage))


def run_export(
    order: ExportOrder,
    on_progress: ExportProgressCallback = lambda _: None,
    stop: threading.Event | None = None,
) -> ExportReport:
    """Exports a dataset, or resumes an interrupted export.

    Args:
        order: specification of the export.
        on_progress: callback after each episode.
        stop: event that interrupts the export; finished episodes are kept, and the report is not `complete`.

    Returns:
        The report; damaged and missing episodes are listed in `skipped`.

    Raises:
        UsageError: the options do not fit the format or the dataset, a package is missing, or no episode is selected.
        WorldError: the dataset does not exist, the directory contains other files, the disk is full, or no episode
            could be read.
    """
    started = time.monotonic()
    exporter = find_exporter(order.format)
    require_packages(exporter)
    dataset, manifest = plan_manifest(order, exporter)
    there = require_same_export(order.out, manifest)
    if there is not None and there.complete:
        return _nothing_to_do(order, dataset, there.model_copy(update={"source": manifest.source}))
    with Output(order.out) as out:
        if there is None:
            write_manifest(out, manifest)
        state = _State(
            order, exporter, dataset=dataset, out=out, stop=stop or threading.Event(), on_progress=on_progress
        )
        _make_pieces(state)
        if not state.stop.is_set():
            manifest = _finish(state, manifest)
        return _report(state, manifest, time.monotonic() - started)


def plan_manifest(order: ExportOrder, exporter: AnyExporter) -> tuple[Dataset, ExportManifest]:
    """Returns the selected episodes and the initial manifest of the export. Writes nothing.

    Raises:
        UsageError: the options or the rig do not fit the format or the dataset, or no episode is selected.
        WorldError: the dataset does not exist.
    """
    if order.rig is not None:
        require_rig_support(exporter)
    whole = open_source(order.root, order.rig)
    if isinstance(order.root, Path):
        one, two = order.root.resolve(), order.out.resolve()
        if one == two or one in two.parents or two in one.parents:
            raise UsageError(
                f"--out {order.out}: the export cannot be inside the dataset, or the dataset inside the export; "
                "choose another folder"
            )
    dataset = select(whole, order.splits, order.episodes, order.excluded)
    order.options.check(dataset.meta)
    options = order.options.model_dump(mode="json")
    if dataset.rig is not None:
        exporter.check_rig(dataset.rig, order.options)
        options["rig"] = f"{dataset.rig.name} {hashlib.sha256(dataset.rig.model_dump_json().encode()).hexdigest()[:12]}"
    digest = rows_digest(dataset.metadata)
    run, record = recorded_run(order.root)
    source = Source(
        run=run,
        record=record,
        dataset_digest=whole.digest,
        frames_run=whole.meta.run,
        rows_digest=digest if len(dataset) == len(whole) else rows_digest(whole.metadata),
        selection_digest=digest,
        splits=tuple(order.splits),
        episodes=len(dataset),
    )
    manifest = ExportManifest(
        format=exporter.name,
        format_version=exporter.version,
        options=options,
        source=source,
        software=of_software(whole.meta, exporter.requires),
    )
    return dataset, manifest


def _make_pieces(state: _State) -> None:
    state.tell("episodes")
    waiting: dict[str, int] = {}
    for made in run_tasks(make_piece, _tasks(state, waiting), state.order.workers, state.stop):
        position = waiting.pop(made.episode_id)
        if made.facts is None:
            state.skipped[position] = Skip(episode_id=made.episode_id, reason=made.damage or "damaged")
        else:
            staged = state.out.staging_folder(made.episode_id)
            state.out.accept(made.episode_id, staged, made.facts, state.exporter.assembles)
            state.pieces[position] = _piece(state, position, made.episode_id)
            state.frame_counts[position] = made.frames
            state.frames += made.frames
        state.tell("episodes")


def _tasks(state: _State, waiting: dict[str, int]) -> Iterator[ExportTask]:
    """Yields the tasks of missing pieces; records existing pieces and episodes that cannot be opened."""
    options = state.order.options.model_dump_json()
    names = state.dataset.column("episode_id")
    seen: set[str] = set()
    for position in range(len(state.dataset)):
        name = str(names[position].as_py())
        episode = _episode_at(state, position, name, name in seen)
        if episode is None:
            continue
        seen.add(name)
        if state.out.facts_path(name).is_file():
            piece = state.pieces[position] = _piece(state, position, name)
            state.frame_counts[position] = piece.facts.frames
            state.resumed += 1
            continue
        waiting[name] = position
        yield ExportTask(state.exporter.name, options, episode, state.out.staging_folder(name))


def _episode_at(state: _State, position: int, name: str, is_twin: bool) -> Episode | None:
    try:
        if is_twin:
            raise ArchiveCorrupt(f"{name} is listed twice in the metadata: resume the run to rewrite it")
        return state.dataset[position]
    except ArchiveCorrupt as error:
        state.skipped[position] = Skip(episode_id=name, reason=str(error))
        return None


def _piece(state: _State, position: int, name: str) -> ExportPiece[Any]:
    split = str(state.dataset[position].summary.split)
    folder, facts = state.out.piece_folder(name), state.out.facts_path(name)
    return ExportPiece(state.dataset, position, name, split, folder, facts, state.exporter.facts)


def _finish(state: _State, manifest: ExportManifest) -> ExportManifest:
    skipped = tuple(state.skipped[position] for position in sorted(state.skipped))
    if not state.pieces:
        reasons = "; ".join(f"{skip.episode_id}: {skip.reason}" for skip in skipped[:_NAMED])
        raise WorldError(f"none of {len(skipped)} episodes could be exported: {reasons}")
    state.tell("finishing")
    pieces = [state.pieces[position] for position in sorted(state.pieces)]
    state.out.begin_finish(piece.episode_id for piece in pieces)
    state.out.before_file = state.require_running
    try:
        plan = state.dataset.meta.plan
        rig = state.dataset.rig or recorded_rig(plan.camera)
        state.out.write_text(state.exporter.rig_file, rig_json(rig, plan.task.control_hz))
        questions = count_questions(piece.facts.questions for piece in pieces)
        if state.exporter.asks and questions is not None and questions.asked:
            _write_questions(state.out, pieces)
        state.exporter.finish(Finish(state.dataset, state.order.options, pieces, state.out, questions))
    except _Stopped:
        return manifest
    state.out.before_file = lambda: None  # ignores a request to stop, because only the manifest remains to be written
    frames = sum(state.frame_counts.values())
    update = {"episodes": len(pieces), "frames": frames, "complete": not skipped, "skipped": skipped}
    update["questions"] = questions
    manifest = manifest.model_copy(update=update)
    write_manifest(state.out, manifest)
    if manifest.complete:
        state.out.drop_work()  # an incomplete export keeps its pieces for the next call
    return manifest


def _write_questions(out: Output, pieces: list[ExportPiece[Any]]) -> None:
    with out.replacing(QUESTIONS_FILE) as part, part.open("w", encoding="utf-8") as file:
        for piece in pieces:
            questions = piece.facts.questions
            file.writelines(map(to_line, () if questions is None else questions.asked))


def _nothing_to_do(order: ExportOrder, dataset: Dataset, manifest: ExportManifest) -> ExportReport:
    with Output(order.out) as out:
        out.drop_work()
        size = out.size_bytes()
    return ExportReport(
        dataset=str(order.root),
        dataset_digest=manifest.source.dataset_digest,
        format=manifest.format,
        out=str(order.out),
        episodes=manifest.episodes,
        frames=manifest.frames,
        resumed=manifest.episodes,
        skipped=(),
        absent=_absent(order, dataset),
        **_left_out(order),
        bytes=size,
        seconds=0.0,
        frames_per_second=None,
        complete=True,
        questions=manifest.questions,
    )


def _report(state: _State, manifest: ExportManifest, seconds: float) -> ExportReport:
    return ExportReport(
        dataset=str(state.order.root),
        dataset_digest=manifest.source.dataset_digest,
        format=manifest.format,
        out=str(state.order.out),
        episodes=len(state.pieces),
        frames=sum(state.frame_counts.values()),
        resumed=state.resumed,
        skipped=manifest.skipped,
        absent=_absent(state.order, state.dataset),
        **_left_out(state.order),
        bytes=state.out.size_bytes(),
        seconds=round(seconds, 3),
        frames_per_second=round(state.frames / seconds, 1) if state.frames else None,
        complete=manifest.complete,
        questions=manifest.questions,
        render_command=_render_command(state, manifest.source.record),
    )


def _render_command(state: _State, record: Recording | None) -> str | None:
    """Returns the command that stores the frames which this call has rendered, or `None`."""
    order, meta = state.order, state.dataset.meta
    if record is not Recording.STATES or not state.exporter.renders or not state.frames:
        return None
    # the frames of a merged dataset cannot be stored, and a stored recording has no new instructions
    if meta.sources or meta.relabelling is not None or isinstance(order.rig, Rig):
        return None
    rig = () if order.rig is None else ("--rig", order.rig)
    return shlex.join(["factory", "render", str(order.root), *rig, "-o", _frames_place(order.root)])


def _frames_place(root: Place) -> str:
    """Returns a location for the frames of a states dataset: beside it, with `_frames` at the end of its name."""
    named = root if not isinstance(root, Path) or root.name else root.resolve()
    return f"{named}_frames"


class _LeftOut(TypedDict):
    unselected: tuple[str, ...]
    rig_left_out: str | None


def _left_out(order: ExportOrder) -> _LeftOut:
    """Returns what the dataset has but the order does not select."""
    dataset = Dataset(order.root)
    rig = dataset.meta.plan.rig if order.rig is None and find_exporter(order.format).takes_rig else None
    unselected: list[str] = []
    if order.splits and order.episodes:
        asked = dataset.filter(episode=order.episodes)
        rows = zip(asked.column("episode_id").to_pylist(), asked.column("split").to_pylist(), strict=True)
        unselected = [name for name, split in rows if split not in order.splits]
    return {"unselected": tuple(unselected), "rig_left_out": None if rig is None else rig.name}


def _absent(order: ExportOrder, dataset: Dataset) -> tuple[str, ...]:
    """Returns the planned ids that the dataset does not have; empty if episodes were selected by id."""
    if order.episodes or dataset.meta.complete:
        return ()
    held = set(Dataset(order.root).column("episode_id").to_pylist())
    planned = map(episode_id, range(1, dataset.meta.planned + 1))
    return tuple(name for name in planned if name not in held)

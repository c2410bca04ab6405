"""An export from beginning to end: select, make the missing pieces, finish. Resumes; knows no format."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from factory.dataset.episode import Episode
from factory.dataset.reader import Dataset
from factory.export.base import ExportPiece, Finish, Options
from factory.export.execution.manifest import ExportManifest, Source, of_software, require_ours, write_manifest
from factory.export.execution.pool import carry_out
from factory.export.execution.report import ExportReport, Skip
from factory.export.execution.selection import select
from factory.export.execution.task import ExportTask, make_piece
from factory.export.output import Output
from factory.export.registry import AnyExporter, find_exporter, require_packages
from schemas.errors import ArchiveCorrupt, UsageError, WorldError
from schemas.job import episode_id
from schemas.storage.place import Place

__all__ = ["ExportOrder", "ExportProgress", "plan_manifest", "run_export"]

_NAMED = 5


class ExportProgress(NamedTuple):
    """Where an export stands."""

    done: int
    """Episodes in the export or skipped."""
    total: int
    """Episodes asked for."""
    frames: int
    """Written in this call."""
    stage: str
    """`episodes`, then `finishing`."""


class _Stopped(Exception):
    """Somebody asked to stop while the last files were being written."""


ExportProgressCallback = Callable[[ExportProgress], None]


@dataclass(frozen=True)
class ExportOrder:
    """What is to be exported where."""

    root: Place
    """Of the dataset."""
    out: Path
    format: str
    options: Options
    splits: tuple[str, ...] = ()
    """Empty for all."""
    episodes: tuple[str, ...] = ()
    """Ids; empty for all."""
    workers: int = 0
    """Processes; 0 does everything in this one."""


@dataclass
class _State:
    """What an export knows while it runs."""

    order: ExportOrder
    exporter: AnyExporter
    dataset: Dataset
    out: Output
    stop: threading.Event
    on_progress: ExportProgressCallback
    pieces: dict[int, ExportPiece[Any]] = field(default_factory=dict)
    """By position."""
    skipped: dict[int, Skip] = field(default_factory=dict)
    """By position."""
    frame_counts: dict[int, int] = field(default_factory=dict)
    """By position."""
    resumed: int = 0
    frames: int = 0
    """Written in this call."""

    def require_going_on(self) -> None:
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
    """Exports a dataset, or goes on with an export that was interrupted.

    Args:
        order: what, where and how.
        on_progress: called as episodes come in.
        stop: ends the export soon when set; what is done is kept, and the report says that it is not complete.

    Returns:
        What was done; episodes that are damaged or missing stand in `skipped`.

    Raises:
        UsageError: the options fit neither format nor dataset, a package is missing, or nothing is asked for.
        WorldError: no dataset, the directory holds something else, the disk is full, or not one
            episode could be read.
    """
    begun = time.monotonic()
    exporter = find_exporter(order.format)
    require_packages(exporter)
    dataset, manifest = plan_manifest(order, exporter)
    there = require_ours(order.out, manifest)
    if there is not None and there.complete:
        return _nothing_to_do(order, dataset, there)
    with Output(order.out) as out:
        if there is None:
            write_manifest(out, manifest)
        state = _State(order, exporter, dataset, out, stop or threading.Event(), on_progress)
        _make_pieces(state)
        if not state.stop.is_set():
            manifest = _finish(state, manifest)
        return _report(state, manifest, time.monotonic() - begun)


def plan_manifest(order: ExportOrder, exporter: AnyExporter) -> tuple[Dataset, ExportManifest]:
    """Returns the episodes that are asked for, and the manifest of an export that begins; writes nothing.

    Raises:
        UsageError: the options fit neither format nor dataset, or nothing is asked for.
        WorldError: there is no dataset.
    """
    whole = Dataset(order.root)
    if isinstance(order.root, Path):
        one, two = order.root.resolve(), order.out.resolve()
        if one == two or one in two.parents or two in one.parents:
            raise UsageError(f"--out {order.out}: dataset and export may not lie in each other; choose a folder beside")
    dataset = select(whole, order.splits, order.episodes)
    order.options.check(dataset.meta)
    source = Source(
        run=whole.meta.run,
        dataset_digest=whole.digest,
        selection_digest=dataset.digest,
        splits=tuple(order.splits),
        episodes=len(dataset),
    )
    manifest = ExportManifest(
        format=exporter.name,
        format_version=exporter.version,
        options=order.options.model_dump(mode="json"),
        source=source,
        software=of_software(whole.meta, exporter.requires),
    )
    return dataset, manifest


def _make_pieces(state: _State) -> None:
    state.tell("episodes")
    waiting: dict[str, int] = {}
    for made in carry_out(make_piece, _tasks(state, waiting), state.order.workers, state.stop):
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
    """Yields what is still to be made; notes what is there already and what cannot even be tried."""
    options = state.order.options.model_dump_json()
    names = state.dataset.metadata["episode_id"]
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
            raise ArchiveCorrupt(f"{name} stands twice in the metadata: a resumed run writes it anew")
        return state.dataset[position]
    except ArchiveCorrupt as error:
        state.skipped[position] = Skip(episode_id=name, reason=str(error))
        return None


def _piece(state: _State, position: int, name: str) -> ExportPiece[Any]:
    split = state.dataset.metadata["split"][position].as_py()
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
    state.out.before_file = state.require_going_on
    try:
        state.exporter.finish(Finish(state.dataset, state.order.options, pieces, state.out))
    except _Stopped:
        return manifest
    state.out.before_file = lambda: None  # all is there: only the manifest is missing
    frames = sum(state.frame_counts.values())
    update = {"episodes": len(pieces), "frames": frames, "complete": not skipped, "skipped": skipped}
    manifest = manifest.model_copy(update=update)
    write_manifest(state.out, manifest)
    if manifest.complete:
        state.out.drop_work()  # while episodes are missing, the pieces serve the next call
    return manifest


def _nothing_to_do(order: ExportOrder, dataset: Dataset, manifest: ExportManifest) -> ExportReport:
    with Output(order.out) as out:
        out.drop_work()
        size = out.size_bytes()
    return ExportReport(
        dataset=str(order.root),
        dataset_digest=manifest.source.selection_digest,
        format=manifest.format,
        out=str(order.out),
        episodes=manifest.episodes,
        frames=manifest.frames,
        resumed=manifest.episodes,
        skipped=(),
        absent=_absent(order, dataset),
        bytes=size,
        seconds=0.0,
        frames_per_second=None,
        complete=True,
    )


def _report(state: _State, manifest: ExportManifest, seconds: float) -> ExportReport:
    return ExportReport(
        dataset=str(state.order.root),
        dataset_digest=manifest.source.selection_digest,
        format=manifest.format,
        out=str(state.order.out),
        episodes=len(state.pieces),
        frames=sum(state.frame_counts.values()),
        resumed=state.resumed,
        skipped=manifest.skipped,
        absent=_absent(state.order, state.dataset),
        bytes=state.out.size_bytes(),
        seconds=round(seconds, 3),
        frames_per_second=round(state.frames / seconds, 1) if state.frames else None,
        complete=manifest.complete,
    )


def _absent(order: ExportOrder, dataset: Dataset) -> tuple[str, ...]:
    """Returns the ids of the plan that a dataset does not hold; none where certain episodes were asked for."""
    if order.episodes or dataset.meta.complete:
        return ()
    held = set(Dataset(order.root).metadata["episode_id"].to_pylist())
    planned = map(episode_id, range(1, dataset.meta.planned + 1))
    return tuple(name for name in planned if name not in held)

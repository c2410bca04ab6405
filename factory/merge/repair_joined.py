"""Repairs a dataset with sources, which has no ledger: keeps intact episodes, and simulates missing ones again.

An episode that the tables list and whose file is missing or damaged is simulated from its plan, draw and attempt; its
content must be that of the table. Files that could be episodes are moved to `quarantine/`, not deleted.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from coordinator.archive.contract import Archive
from coordinator.archive.opening import open_archive
from coordinator.expansion.catalog import Catalog, read_entry
from coordinator.recovery.repair_dataset import Action, RepairKind, RepairReport, table_findings
from coordinator.recovery.survey import PlannedDraws
from coordinator.tables.row_groups import ListedRows
from coordinator.tables.table_reader import read_failed_attempts
from coordinator.transfer.contract import EpisodeValidator
from factory.dataset.packages import find_package_file
from factory.dataset.reader import Dataset
from factory.merge.merge import JoinedRows, write_tables_of
from factory.runs.catalog import with_light
from schemas.bundle import BundleReader
from schemas.dataset.meta import DatasetMeta, read_dataset_meta
from schemas.dataset.rows import EpisodeSummary, renumbered, summary_of
from schemas.errors import ArchiveCorrupt, InvalidBundle, WorldError
from schemas.exchangeable import candidates_of
from schemas.job import Job, episode_id
from schemas.storage.dataset_files import ATTEMPTS_FILE, META_FILE, METADATA_FILE, SOURCES_FILE
from schemas.storage.episode_list import list_episodes
from schemas.storage.place import FilePlace, digest_of, local_copy, relative_name
from workers.sim.attempt import AttemptFailure, run_attempt
from workers.sim.context import SimulationContext

ProgressCallback = Callable[[int, int], None]


def joined_meta(root: Path) -> DatasetMeta | None:
    """Returns the description of a dataset with sources; of a damaged one, its copy. `None` for other datasets."""
    try:
        meta = read_dataset_meta(root)
    except WorldError:
        try:
            meta = DatasetMeta.model_validate_json((root / SOURCES_FILE).read_bytes())
        except (OSError, ValueError):
            return None
    return meta if meta.sources else None


class _Jobs:
    """Jobs of the sources; expands the plan of each source at most once."""

    def __init__(self, meta: DatasetMeta, catalog: Catalog) -> None:
        self._meta, self._catalog = meta, catalog
        self._draws: dict[int, PlannedDraws] = {}

    def find(self, index: int, draw: int, attempt: int) -> Job | None:
        """Returns the job of an attempt at an episode; `None` if no source has it."""
        source = self._meta.source_of(index)
        if source is None:
            return None
        if source.first not in self._draws:
            plan = source.plan
            own = {part.name: self._catalog[part.name] for part in plan.parts if part.name in self._catalog}
            self._draws[source.first] = PlannedDraws(plan, with_light(plan, own))
        return self._draws[source.first].job(source.own_index(index), draw, attempt)


@dataclass
class _Findings:
    kept: dict[int, EpisodeSummary] = field(default_factory=dict)
    """Rows of intact files."""
    missing: dict[int, EpisodeSummary] = field(default_factory=dict)
    """Rows of files to simulate again."""
    aside: list[tuple[FilePlace, str]] = field(default_factory=list)
    """Files to move to quarantine, with the reason."""
    actions: list[Action] = field(default_factory=list)


def repair_joined(
    root: Path,
    meta: DatasetMeta,
    checker: EpisodeValidator,
    now: datetime,
    *,
    apply: bool,
    on_progress: ProgressCallback = lambda _done, _all: None,
) -> RepairReport:
    """Finds faults of a dataset with sources and, with `apply`, repairs them.

    Args:
        root: directory of the dataset.
        meta: its description, see `joined_meta`.
        checker: validator of files that differ from the tables.
        now: time of the repair, UTC.
        apply: whether to apply the actions; otherwise nothing is changed.
        on_progress: called with the number of examined episodes and their total.

    Raises:
        ArchiveCorrupt: the package of a scene is missing, or a replayed episode has other content.
        WorldError: another process uses the dataset, the disk cannot be written, or a simulation fails.
    """
    catalog = {name: read_entry(find_package_file(root, name, sha256)) for name, sha256 in meta.scenes.items()}
    found = _Findings()
    for name, why in table_findings(root, None).items():
        found.actions.append(Action(kind=RepairKind.REWRITE, what=name, why=why))
    _survey(root, meta, catalog, checker=checker, found=found, on_progress=on_progress)
    if apply and found.actions:
        _apply(root, meta, catalog, found, now)
    return RepairReport(
        dataset=str(root),
        run=meta.run,
        applied=apply,
        actions=tuple(found.actions),
        episodes=len(found.kept),
        planned=meta.planned,
    )


def _survey(
    root: Path,
    meta: DatasetMeta,
    catalog: Catalog,
    *,
    checker: EpisodeValidator,
    found: _Findings,
    on_progress: ProgressCallback,
) -> None:
    rows, listed = _rows(root), list_episodes(root)
    jobs = _Jobs(meta, catalog)
    found.aside += [(path, "its name is not that of an episode") for path in listed.foreign]
    numbers = sorted(rows.keys() | listed.episodes.keys())
    for done, index in enumerate(numbers, 1):
        path, row = listed.episodes.get(index), rows.get(index)
        if path is not None and row is not None and _sha256(path) == row.file_sha256:
            found.kept[index] = row
        else:
            verdict = _adopted(path, index, jobs, catalog, checker) if path is not None else "its file is missing"
            _decide(found, verdict, index=index, path=path, row=row)
        on_progress(done, len(numbers))
    for path, why in found.aside:
        found.actions.append(Action(kind=RepairKind.QUARANTINE, what=relative_name(path, root), why=why))
    if found.actions and not any(action.what == METADATA_FILE for action in found.actions):
        found.actions.append(Action(kind=RepairKind.REWRITE, what=METADATA_FILE, why="the actions above change it"))


def _decide(
    found: _Findings, verdict: EpisodeSummary | str, *, index: int, path: FilePlace | None, row: EpisodeSummary | None
) -> None:
    """Notes what happens to an episode that differs from the tables."""
    if isinstance(verdict, EpisodeSummary):
        found.kept[index] = verdict
        why = "intact, and the table has no such row"
        found.actions.append(Action(kind=RepairKind.ADOPT, what=verdict.file_name, why=why))
        return
    if path is not None:
        found.aside.append((path, " ".join(verdict.split())))
    if row is not None:
        found.missing[index] = row
        found.actions.append(Action(kind=RepairKind.REQUEUE, what=row.episode_id, why=" ".join(verdict.split())))


def _rows(root: Path) -> dict[int, EpisodeSummary]:
    """Returns the rows of `metadata.parquet` by number; empty if it cannot be read."""
    try:
        dataset = Dataset(root)
        return {row.index: row for row in map(dataset.row, range(len(dataset)))}
    except WorldError:
        return {}


def _sha256(path: FilePlace) -> str | None:
    try:
        return digest_of(path)
    except OSError:
        return None


def _adopted(
    path: FilePlace, index: int, jobs: _Jobs, catalog: Catalog, checker: EpisodeValidator
) -> EpisodeSummary | str:
    """Returns the row of a file that the tables do not list, or the reason why it is not an episode of its source."""
    try:
        with local_copy(path) as local:
            with local.open("rb") as file, BundleReader(file) as bundle:
                recorded = bundle.meta.job
            job = jobs.find(index, recorded.draw, recorded.attempt)
            if job is None or job != recorded:
                return f"it contains {recorded.episode_id} of run {recorded.run}, which is not this episode of a source"
            row = checker.check(local, job, candidates_of(job, catalog[job.scene].info))
            return renumbered(row, index, episode_id(index))
    except InvalidBundle as error:
        return str(error)
    except OSError as error:
        return f"cannot be read: {error.strerror}"


def _apply(root: Path, meta: DatasetMeta, catalog: Catalog, found: _Findings, now: datetime) -> None:
    with open_archive(root) as archive:
        for path, why in found.aside:
            archive.quarantine(path, why)
        for row in _simulated(archive, root, meta, catalog, found.missing):
            found.kept[row.index] = row
        rows = [row for _, row in sorted(found.kept.items())]
        joined = JoinedRows(ListedRows(rows), ListedRows(read_failed_attempts(root / ATTEMPTS_FILE)))
        counts = (sum(index in source.numbers for index in found.kept) for source in meta.sources)
        write_tables_of(
            archive,
            joined,
            plan=meta.plan,
            sources=[
                source.model_copy(update={"episodes": count})
                for source, count in zip(meta.sources, counts, strict=True)
            ],
            scenes=meta.scenes,
            refused=meta.refused_seeds,
            now=now,
        )


def _simulated(
    archive: Archive, root: Path, meta: DatasetMeta, catalog: Catalog, missing: Mapping[int, EpisodeSummary]
) -> Iterator[EpisodeSummary]:
    """Simulates episodes again and stores them; yields their rows."""
    if not missing:
        return
    jobs = _Jobs(meta, catalog)
    with SimulationContext("auto", apart=True) as stage:
        for index, row in missing.items():
            job = jobs.find(index, row.draw, row.attempt)
            if job is None:
                raise ArchiveCorrupt(f"{root / META_FILE}: no source has {row.episode_id}")
            stage.load(catalog[job.scene].path, job.scene_sha256)
            with tempfile.TemporaryFile() as out:
                outcome = run_attempt(job, stage, out=out, sid="repair", on_step=lambda _step: None)
                if isinstance(outcome, AttemptFailure):
                    raise WorldError(f"{row.episode_id}: the simulation ended with {outcome.reason}: {outcome.detail}")
                made = BundleReader(out).meta
                if made.content_digest != row.content_digest:
                    raise ArchiveCorrupt(
                        f"{row.episode_id} simulated on this machine has content digest {made.content_digest}, "
                        "recorded "
                        f"{row.content_digest}: repair the dataset on a machine with the recorded renderer and software"
                    )
                out.seek(0)
                with archive.stage(index) as staged:
                    shutil.copyfileobj(out, staged)
                    fresh = summary_of(made, staged.sha256, staged.size)
                    archive.publish(staged, index)
            yield renumbered(fresh, index, row.episode_id)

"""Repairs a dataset without a running coordinator: adopts, quarantines and requeues episodes, rebuilds the ledger.

The module does not delete files that could be episodes or ledgers: it moves them to `quarantine/` and writes the reason
beside them. `RepairReport` describes what was done.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from pathlib import Path

from sqlalchemy import Engine
from sqlalchemy.engine import Connection

from coordinator.archive.contract import Archive
from coordinator.archive.opening import open_archive
from coordinator.expansion.catalog import Catalog
from coordinator.ledger.claims import has_open_jobs
from coordinator.ledger.database.engine import is_server, open_reader, open_writer
from coordinator.ledger.opening import FormerFormat, holds_run, open_run, read_info, record_ledger
from coordinator.ledger.outcomes import lose
from coordinator.ledger.reading.audit import ledger_trouble
from coordinator.ledger.reading.records import read_content_digests
from coordinator.ledger.repair import record_whole
from coordinator.packing import pack_settled
from coordinator.recovery.reconcile import quarantine_ledger
from coordinator.recovery.survey import ProgressCallback, Survey, restore_failures, survey_archive
from coordinator.tables.checkpoint import count_failures, write_checkpoint
from coordinator.tables.split_tables import find_faults, write_split_tables
from coordinator.tables.table_reader import read_column
from coordinator.transfer.contract import EpisodeValidator
from schemas.base import Model
from schemas.dataset.meta import read_dataset_meta
from schemas.dataset.rows import EpisodeSummary
from schemas.dataset.run_shard import RunShard
from schemas.errors import ArchiveCorrupt, WorldError
from schemas.job import episode_id
from schemas.plan import Plan
from schemas.scene.info import TEXTURES, texture_file
from schemas.storage.dataset_files import (
    ATTEMPTS_FILE,
    CARD_FILE,
    EPISODES,
    META_FILE,
    METADATA_FILE,
    SCENES,
    SHARDS_FILE,
)
from schemas.storage.episode_list import list_episodes
from schemas.storage.object_path import ObjectPath
from schemas.storage.place import Place, children, digest_of, relative_name


class RepairKind(StrEnum):
    """Kind of a repair action."""

    # A lost or damaged ledger, or one of an older format, is rebuilt from plan, tables and archive.
    REBUILD = "rebuild"
    # A missing or damaged scene package or texture is taken from the cache or compiled again; an intact episode of the
    # plan is moved back from quarantine and recorded.
    RESTORE = "restore"
    # An intact episode without a ledger record is validated and recorded.
    ADOPT = "adopt"
    # A file that is not an intact episode of this plan, or a texture that no scene needs, is moved to quarantine.
    QUARANTINE = "quarantine"
    # A recorded episode without a file is collected again, with the same content.
    REQUEUE = "requeue"
    # A table that is missing or differs from the ledger is written again.
    REWRITE = "rewrite"


class Action(Model):
    """Repair action."""

    kind: RepairKind
    """Kind of the action."""
    what: str
    """File relative to the root of the dataset, or episode id."""
    why: str
    """Reason, with measured values."""


class RepairReport(Model):
    """Report of a repair."""

    dataset: str
    """Root of the dataset."""
    run: str
    """Name of the run."""
    applied: bool
    """Whether the actions were applied; `False` for a dry run."""
    actions: tuple[Action, ...]
    """Actions in the order of their application."""
    episodes: int
    """Number of archived episodes after the actions."""
    planned: int
    """Number of planned episodes."""

    @property
    def is_sound(self) -> bool:
        """Whether the dataset needs no action."""
        return not self.actions


_LEASE_TTL_S = 15.0
_LISTED_CHARS = 500
_SURPLUS = "no scene of the run needs this texture"


@dataclass(frozen=True)
class RepairInput:
    """Dataset to repair, with its plan and scenes."""

    root: Place
    """Root of the dataset."""
    state_dir: Path
    """Directory of the dataset; for object storage the state directory."""
    url: str
    """URL of the ledger."""
    plan: Plan
    """Plan of the run."""
    catalog: Catalog
    """Compiled scenes of the plan; the packages of scenes in `scenes` are stored outside the dataset."""
    scenes: Mapping[str, str]
    """Mapping of scene name to the reason why its package in the dataset is unusable."""
    shard: RunShard | None = None
    """Shard of the run that the dataset contains; `None` for the whole run."""
    foreign_ledger: str = ""
    """Reason why the ledger belongs to another dataset; empty if it belongs to this dataset or is lost."""


def repair(
    dataset: RepairInput,
    checker: EpisodeValidator,
    now: datetime,
    *,
    apply: bool,
    take_over: bool = False,
    on_progress: ProgressCallback = lambda _done, _all: None,
) -> RepairReport:
    """Finds faults of a dataset and, with `apply`, repairs them.

    Args:
        dataset: dataset to repair.
        checker: validator of files to adopt.
        now: time of the repair.
        apply: whether to apply the actions; otherwise the dataset is not changed.
        take_over: whether to take over a dataset in object storage from a state directory whose coordinator has
            ended.
        on_progress: progress callback with the number of examined episodes and the total.

    Raises:
        WorldError: a coordinator holds the dataset, or the disk cannot be written.
        UsageError: the ledger belongs to another plan or has a newer format, or a database server stores a ledger of
            an older format.
    """
    with ExitStack() as stack:
        # the shards are inspected before the archive is opened, because opening repairs them
        actions = list(_of_shards(dataset.root))
        archive = stack.enter_context(_open(dataset, take_over)) if apply else None
        trouble = dataset.foreign_ledger or _ledger_trouble(dataset)
        with _reading(dataset.url, trouble) as ledger:
            survey = survey_archive(
                dataset.root,
                dataset.plan,
                catalog=dataset.catalog,
                ledger=ledger,
                checker=checker,
                on_progress=on_progress,
            )
            actions += [*_of_ledger(trouble), *_of_scenes(dataset), *_of(dataset.root, survey)]
            actions += _of_tables(dataset, ledger, changes=bool(survey.adopt or survey.restore or survey.requeue))
        if archive is not None and actions:
            _apply_actions(dataset, archive, survey=survey, trouble=trouble, now=now)
        return RepairReport(
            dataset=str(dataset.root),
            run=dataset.plan.run,
            applied=archive is not None,
            actions=tuple(actions),
            episodes=survey.whole + len(survey.adopt) + len(survey.restore),
            planned=dataset.plan.episodes,
        )


def _open(dataset: RepairInput, take_over: bool) -> Archive:
    store = dataset.root if isinstance(dataset.root, ObjectPath) else None
    return open_archive(dataset.state_dir, store, take_over=take_over)


def _ledger_trouble(dataset: RepairInput) -> str:
    try:
        return ledger_trouble(dataset.url, dataset.catalog)
    except FormerFormat as error:
        if is_server(dataset.url):
            raise
        return error.why


@contextmanager
def _reading(url: str, trouble: str) -> Iterator[Connection | None]:
    if trouble:
        yield None
        return
    engine = open_reader(url)
    try:
        with engine.connect() as connection:
            yield connection
    finally:
        engine.dispose()


def _of_shards(root: Place) -> Iterator[Action]:
    listed = list_episodes(root)
    for name, why in listed.damaged.items():
        yield Action(kind=RepairKind.REWRITE, what=f"{EPISODES}/{name}", why=f"{why}; intact episodes are kept")
    for why in listed.twice:
        yield Action(kind=RepairKind.REWRITE, what=EPISODES, why=why)
    if listed.index_fault:
        yield Action(kind=RepairKind.REWRITE, what=SHARDS_FILE, why=listed.index_fault)


def _of_ledger(trouble: str) -> Iterator[Action]:
    if trouble:
        yield Action(kind=RepairKind.REBUILD, what="ledger", why=trouble)


def _of_scenes(dataset: RepairInput) -> Iterator[Action]:
    for name, why in dataset.scenes.items():
        yield Action(kind=RepairKind.RESTORE, what=f"scene {name}", why=why)
    for place in _surplus_textures(dataset):
        yield Action(kind=RepairKind.QUARANTINE, what=relative_name(place, dataset.root), why=_SURPLUS)


def _surplus_textures(dataset: RepairInput) -> list[Place]:
    """Returns the files of textures that no scene of the run needs."""
    folder = dataset.root / SCENES
    needed = {folder / texture_file(sha256) for entry in dataset.catalog.values() for sha256 in entry.textures}
    return [place for place in children(folder / TEXTURES) if place not in needed]


def _of(root: Place, survey: Survey) -> Iterator[Action]:
    for summary in survey.adopt:
        why = f"intact, draw {summary.draw}, attempt {summary.attempt}, and not recorded in the ledger"
        yield Action(kind=RepairKind.ADOPT, what=summary.file_name, why=why)
    for quarantined, summary in survey.restore:
        why = f"an intact episode in quarantine, draw {summary.draw}, attempt {summary.attempt}"
        yield Action(kind=RepairKind.RESTORE, what=relative_name(quarantined, root), why=why)
    for path, why in survey.quarantine:
        yield Action(
            kind=RepairKind.QUARANTINE, what=relative_name(path, root), why=" ".join(why.split())[:_LISTED_CHARS]
        )
    for index, why in survey.requeue:
        yield Action(kind=RepairKind.REQUEUE, what=episode_id(index), why=why)


def _of_tables(dataset: RepairInput, ledger: Connection | None, *, changes: bool) -> Iterator[Action]:
    """Yields an action for each table that differs from the ledger, or will differ after the other actions."""
    for name, why in table_findings(dataset.root, ledger).items():
        yield Action(kind=RepairKind.REWRITE, what=name, why=why)
    if changes and ledger is not None:
        yield Action(kind=RepairKind.REWRITE, what=METADATA_FILE, why="its rows change with the actions above")


def table_findings(root: Place, ledger: Connection | None) -> dict[str, str]:
    """Returns the faults of the tables by file name.

    Args:
        root: root of the dataset.
        ledger: ledger to compare the tables with; `None` checks only that they can be read.
    """
    findings: dict[str, str] = {}
    digests = read_column(root / METADATA_FILE, "content_digest")
    if isinstance(digests, str):
        findings[METADATA_FILE] = digests
    elif ledger is not None:
        owned = read_content_digests(ledger)
        if owned != digests:
            findings[METADATA_FILE] = f"its {len(digests)} rows differ from the {len(owned)} episodes of the ledger"
    reasons = read_column(root / ATTEMPTS_FILE, "reason")
    if isinstance(reasons, str):
        findings[ATTEMPTS_FILE] = reasons
    elif ledger is not None:
        failed = count_failures(ledger)
        if failed != len(reasons):
            findings[ATTEMPTS_FILE] = f"it has {len(reasons)} rows, the ledger has {failed} failed attempts"
    try:
        read_dataset_meta(root)
    except WorldError as error:
        findings[META_FILE] = str(error)
    if not (root / CARD_FILE).is_file():
        findings[CARD_FILE] = "is missing"
    with suppress(ArchiveCorrupt):  # the unreadable `metadata.parquet` is reported above
        findings |= {fault.name: fault.text for fault in find_faults(root, deep=True)}
    return findings


def _apply_actions(dataset: RepairInput, archive: Archive, survey: Survey, trouble: str, now: datetime) -> None:
    """Applies the actions: files first, then the ledger, then the tables. An interrupted repair can be repeated."""
    for name, why in dataset.scenes.items():
        entry = dataset.catalog[name]
        for sha256 in entry.textures:
            _set_aside_damaged(archive, archive.texture_path(sha256), sha256, why)
            archive.add_texture(entry.texture_path(sha256), sha256)
        _set_aside_damaged(archive, archive.scene_path(name, entry.sha256), entry.sha256, why)
    for name, entry in dataset.catalog.items():
        archive.add_scene(entry.path, name, entry.sha256, entry.textures)
    for place in _surplus_textures(dataset):
        archive.quarantine(place, _SURPLUS)
    for path, why in survey.quarantine:
        archive.quarantine(path, why)
    for quarantined, summary in survey.restore:
        archive.restore(quarantined, summary.index)
    if trouble:
        quarantine_ledger(archive, dataset.url, trouble)
    engine = open_writer(dataset.url)
    record_ledger(dataset.state_dir, dataset.url)
    try:
        open_run(
            engine,
            dataset.plan,
            catalog=dataset.catalog,
            lease_ttl_s=_lease_ttl_of(engine),
            now=now,
            shard=dataset.shard,
        )
        with engine.begin() as connection:
            for index, why in survey.requeue:
                lose(connection, index, now, why)
        whole = [*survey.adopt, *(summary for _, summary in survey.restore)]
        restore_failures(
            engine,
            dataset.root,
            plan=dataset.plan,
            catalog=dataset.catalog,
            now=now,
            whole={summary.index: summary for summary in whole},
        )
        for summary in whole:
            _adopt(engine, dataset, archive, summary, now)
        with engine.connect() as connection:
            pack_settled(archive, connection, dataset.plan, not has_open_jobs(connection))
            write_checkpoint(archive, connection, dataset.plan, dataset.catalog, now)
        write_split_tables(archive, deep=True)
    finally:
        engine.dispose()


def _set_aside_damaged(archive: Archive, place: Place, sha256: str, why: str) -> None:
    if place.exists() and digest_of(place) != sha256:
        archive.quarantine(place, why)


def _adopt(engine: Engine, dataset: RepairInput, archive: Archive, summary: EpisodeSummary, now: datetime) -> None:
    with engine.begin() as connection:
        at = (summary.draw, summary.attempt)
        refusal = record_whole(
            connection, dataset.plan, catalog=dataset.catalog, receipt=summary, now=now, at=at, replaces=True
        )
        if refusal:
            connection.rollback()
    if refusal:
        archive.quarantine(archive.path_of(summary.index), refusal)


def _lease_ttl_of(engine: Engine) -> float:
    """Returns the lease duration in the ledger, so opening it does not change the duration."""
    with engine.connect() as connection:
        return read_info(connection).lease_ttl_s if holds_run(connection) else _LEASE_TTL_S

"""Reconciles the ledger with the archive at start: adopts, quarantines or requeues episodes after an interruption.

An unusable ledger is quarantined first, so a new ledger is created and rebuilt from the episodes.

The reconciliation runs before any other writer. If the ledger was lost or restored from an older copy, every intact
episode of the plan is adopted. The module does not delete files that could be episodes.

Design: docs/design/data.md#a-lost-ledger-is-rebuilt.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import cast

import structlog
from sqlalchemy import Engine
from sqlalchemy.engine import Connection

from coordinator.archive.contract import Archive
from coordinator.archive.difference import GONE, ArchiveDifference, ListedFile, diff_archive
from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import to_job
from coordinator.ledger.archived import record_at_core, recorded_files
from coordinator.ledger.claims import grant_grace
from coordinator.ledger.database.engine import is_server, is_unchanged, shown_url, sqlite_files
from coordinator.ledger.opening import planned_of
from coordinator.ledger.outcomes import lose
from coordinator.ledger.reading.audit import ledger_trouble
from coordinator.ledger.repair import current_job, record_whole
from coordinator.protocol.protocol import Terms
from coordinator.recovery.survey import ForeignEpisode, PlannedDraws, StrayClassifier, restore_failures, validated_files
from coordinator.transfer.contract import BundleValidator, EpisodeValidator
from schemas.dataset.rows import BundleReceipt, EpisodeSummary
from schemas.errors import InvalidBundle, UsageError, WorldError
from schemas.exchangeable import candidates_of
from schemas.storage.place import FilePlace, Place, local_copy
from schemas.support.shell import quoted

log = structlog.get_logger(__name__)

_Verdict = tuple[BundleReceipt, tuple[int, int]] | str
"""Receipt of an intact file with its draw and attempt, or the reason why the file is rejected."""


@dataclass
class Reconciled:
    """Result of the reconciliation."""

    adopted: list[int] = field(default_factory=list)
    """Numbers of intact episodes that the ledger did not record."""
    quarantined: list[Place] = field(default_factory=list)
    """New paths of files that are damaged or not episodes of the plan."""
    requeued: list[int] = field(default_factory=list)
    """Numbers of archived episodes whose file is missing or damaged."""
    held: int = 0
    """Number of restarted leases."""


def reconcile(archive: Archive, engine: Engine, terms: Terms, checker: BundleValidator, now: datetime) -> Reconciled:
    """Reconciles ledger and archive; opening the archive has already emptied the staging directory.

    Args:
        archive: archive of the run, held exclusively.
        engine: writer engine of the ledger, which is intact and may lag behind the archive.
        terms: terms of the run.
        checker: validator of bundles to adopt.
        now: start time of the restarted leases.

    Raises:
        TransientError: no bundle can be validated on this machine now; the remaining files are unchanged.
        UsageError: the episodes belong to another plan.
    """
    result = Reconciled()
    present = archive.present()
    with engine.begin() as connection:
        recorded = recorded_files(connection, digests=False)
    difference = diff_archive({index: ListedFile(path.stat().st_size) for index, path in present.items()}, recorded)
    unsure = {index: present[index] for index in difference.strays}
    # if no validator can be started, the start ends: quarantine would discard intact episodes when memory is short
    verdicts = _validate_all(archive, engine, terms=terms, checker=checker, unsure=unsure, difference=difference)
    _require_own_plan(archive, terms, verdicts, len(recorded))
    result.quarantined += [archive.quarantine(path, "its name is not that of an episode") for path in archive.foreign()]
    with engine.begin() as connection:
        for index in difference.missing:
            _requeue(connection, index, now=now, reason=GONE, result=result)
        for index in difference.elsewhere:
            record_at_core(connection, index)  # `factory gather` was interrupted after it copied the file
        result.held = grant_grace(connection, now, terms.lease_ttl_s)
    changed = {index: words for index, words in difference.changed.items() if recorded[index].gateway is None}
    _settle(archive, engine, terms, now, unsure, verdicts, changed, result)
    log.info(
        "reconciled",
        archived=len(recorded) - len(result.requeued),
        adopted=len(result.adopted),
        quarantined=len(result.quarantined),
        requeued=len(result.requeued),
        leases=result.held,
    )
    return result


def _requeue(connection: Connection, index: int, now: datetime, reason: str, result: Reconciled) -> None:
    if lose(connection, index, now, reason):
        log.warning("episode_lost", index=index, reason=reason, remedy="it is generated again, with the same content")
        result.requeued.append(index)


def _validate_all(
    archive: Archive,
    engine: Engine,
    terms: Terms,
    checker: BundleValidator,
    unsure: Mapping[int, FilePlace],
    difference: ArchiveDifference,
) -> Mapping[int, _Verdict]:
    if not unsure:
        return {}
    with engine.connect() as ledger:
        if terms.evaluation is not None:
            return {
                index: _validate_result(ledger, index, path=path, terms=terms, checker=checker)
                for index, path in unsure.items()
            }
        validated = validated_files(archive.root, terms.plan)
        classifier = StrayClassifier(
            PlannedDraws(terms.plan, terms.catalog, ledger), cast(EpisodeValidator, checker), ledger, validated
        )
        verdicts = {
            index: classifier.classify(path, index, replaces=index in difference.changed)
            for index, path in unsure.items()
        }
    return {i: one if isinstance(one, str) else (one, (one.draw, one.attempt)) for i, one in verdicts.items()}


def _validate_result(
    ledger: Connection, index: int, path: FilePlace, terms: Terms, checker: BundleValidator
) -> _Verdict:
    """Validates an evaluation result as that of the current attempt, because the file does not name its attempt."""
    row = current_job(ledger, index)
    if row is None:
        return "the plan has no episode of this number"
    try:
        job = to_job(terms.plan, terms.catalog, planned_of(row), row.attempt)
        candidates = candidates_of(job, terms.catalog[row.scene].info)
        with local_copy(path) as file:
            return checker.check(file, job, candidates), (row.draw, row.attempt)
    except InvalidBundle as error:
        return str(error)


def _require_own_plan(archive: Archive, terms: Terms, verdicts: Mapping[int, _Verdict], owned: int) -> None:
    """Raises an error if all files belong to another run: then the given plan is wrong, and no file may be moved.

    Raises:
        UsageError: all files belong to another run, which the message names.
    """
    strange = [verdict for verdict in verdicts.values() if isinstance(verdict, ForeignEpisode)]
    if strange and not owned and all(isinstance(verdict, str) for verdict in verdicts.values()):
        raise UsageError(
            f"{archive.root} has {len(strange)} episodes, and none belongs to run {terms.plan.run}; the first is "
            f"{strange[0]}: give the plan of the dataset, or choose another --out"
        )


def _settle(
    archive: Archive,
    engine: Engine,
    terms: Terms,
    now: datetime,
    unsure: Mapping[int, FilePlace],
    verdicts: Mapping[int, _Verdict],
    changed: Mapping[int, str],
    result: Reconciled,
) -> None:
    whole = {index: verdict[0] for index, verdict in verdicts.items() if not isinstance(verdict, str)}
    episodes_found = {index: verdict for index, verdict in whole.items() if isinstance(verdict, EpisodeSummary)}
    if terms.evaluation is None:
        restore_failures(engine, archive.root, plan=terms.plan, catalog=terms.catalog, now=now, whole=episodes_found)
    for index, verdict in verdicts.items():
        refusal = verdict if isinstance(verdict, str) else _adopt(engine, terms, *verdict, now)
        if not refusal:
            result.adopted.append(index)
            continue
        if index in changed:
            refusal = f"{changed[index]}; {refusal}"
        result.quarantined.append(archive.quarantine(unsure[index], refusal))
        if index in changed:
            with engine.begin() as connection:
                _requeue(connection, index, now=now, reason=refusal, result=result)


def _adopt(engine: Engine, terms: Terms, receipt: BundleReceipt, at: tuple[int, int], now: datetime) -> str:
    with engine.begin() as connection:
        refusal = record_whole(
            connection, terms.plan, catalog=terms.catalog, receipt=receipt, now=now, at=at, replaces=True
        )
        if refusal:
            connection.rollback()
    return refusal


def replace_unusable_ledger(archive: Archive, url: str, catalog: Catalog) -> None:
    """Quarantines the ledger of a run if it is unusable; an intact ledger is not changed.

    A ledger that has not changed since it was closed is not audited.

    Args:
        archive: archive of the run, held exclusively.
        url: URL of the ledger.
        catalog: compiled scenes of the run.

    Raises:
        WorldError: a database server stores a damaged ledger, which only its administrator can replace.
        UsageError: the ledger has another format.
    """
    trouble = "" if is_unchanged(url) else ledger_trouble(url, catalog)
    if not trouble:
        return
    if is_server(url) and "lacks the tables" not in trouble:
        raise WorldError(
            f"the ledger {shown_url(url)} {trouble}: restore the database from a backup, or give an empty one with "
            f"--ledger; `factory repair {quoted(archive.root)}` then rebuilds it from the episodes"
        )
    quarantine_ledger(archive, url, trouble)
    if episodes := len(archive.present()):
        log.warning("ledger_rebuilt", ledger=shown_url(url), why=trouble, episodes=episodes, remedy="none")


def quarantine_ledger(archive: Archive, url: str, why: str) -> None:
    """Moves the files of an SQLite ledger to the quarantine folder, the write-ahead log first.

    A lost ledger may leave a log, which SQLite would replay into the next ledger of the same name.
    """
    for file in sqlite_files(url):
        archive.quarantine(file, f"the ledger {why}")

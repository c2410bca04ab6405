"""Makes ledger and disk agree at start: adopts, quarantines or re-queues whatever the last stop left in between.

Runs before anything else writes. Deletes nothing that could be an episode.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

import structlog
from sqlalchemy import Engine, select
from sqlalchemy.engine import Connection

from coordinator.archive.contract import Archive
from coordinator.archive.place import Place, at_hand
from coordinator.ledger.claims import grant_grace
from coordinator.ledger.keepers import all_keepers, bring_home
from coordinator.ledger.opening import planned_of
from coordinator.ledger.outcomes import adopt, lose
from coordinator.ledger.states import State
from coordinator.ledger.tables import episodes, jobs
from coordinator.plan.draw import to_job
from coordinator.puller import Judge
from coordinator.wire.protocol import Terms
from schemas.errors import InvalidBundle

__all__ = ["Reconciled", "reconcile"]

log = structlog.get_logger(__name__)


@dataclass
class Reconciled:
    """What had to be put right, by episode number."""

    adopted: list[int]
    """Published, but the commit was lost."""
    quarantined: list[Place]
    """Not the ledger's, or not what the ledger says."""
    requeued: list[int]
    """Archived, but the file is gone or of another size."""
    held: int = 0
    """Leases that have got their grace."""


def reconcile(archive: Archive, engine: Engine, terms: Terms, checker: Judge, now: datetime) -> Reconciled:
    """Brings ledger and archive to agree; the staging directory was emptied when the archive was opened.

    Args:
        archive: of the run, held exclusively.
        engine: writes the ledger.
        terms: of the run.
        checker: judges bundles that are to be adopted.
        now: leases are granted from here on.

    Raises:
        TransientError: nothing can be judged on this machine now; what was not judged lies where it lay.
    """
    result = Reconciled([], [], [])
    present = archive.present()
    result.quarantined += [archive.quarantine(path, "no episode by its name") for path in archive.foreign()]
    with engine.begin() as connection:
        owned = {row.idx: row.size for row in connection.execute(select(episodes.c.idx, episodes.c.size))}
        away = all_keepers(connection)
        for index in sorted(owned.keys() - present.keys() - away.keys()):
            _requeue(connection, index, now, "its file is gone", result)
        for index in sorted(owned.keys() & present.keys()):
            size = present[index].stat().st_size
            if size != owned[index]:
                reason = f"{size} bytes, the ledger says {owned[index]}"
                result.quarantined.append(archive.quarantine(present[index], reason))
                if index not in away:
                    _requeue(connection, index, now, reason, result)
            elif index in away:
                bring_home(connection, index)  # `factory gather` was cut off between file and ledger
        result.held = grant_grace(connection, now, terms.lease_ttl_s)
    strays = {index: path for index, path in present.items() if index not in owned}
    if strays:
        _settle_strays(archive, engine, terms, checker, now, strays, result)
    log.info(
        "reconciled",
        archived=len(owned) - len(result.requeued),
        adopted=len(result.adopted),
        quarantined=len(result.quarantined),
        requeued=len(result.requeued),
        leases=result.held,
    )
    return result


def _requeue(connection: Connection, index: int, now: datetime, reason: str, result: Reconciled) -> None:
    if lose(connection, index, now, reason):
        log.warning("episode_lost", index=index, reason=reason, remedy="it is made anew, with the same content")
        result.requeued.append(index)


def _settle_strays(
    archive: Archive,
    engine: Engine,
    terms: Terms,
    checker: Judge,
    now: datetime,
    strays: dict[int, Place],
    result: Reconciled,
) -> None:
    for index, path in strays.items():
        with engine.begin() as connection:
            refusal = _adopt(connection, index, path, terms, checker, now)
        if refusal:
            result.quarantined.append(archive.quarantine(path, refusal))
        else:
            result.adopted.append(index)


def _adopt(connection: Connection, index: int, path: Place, terms: Terms, checker: Judge, now: datetime) -> str:
    """Records a stray file as its episode; returns why not, or nothing when it is done."""
    current = select(jobs).where(jobs.c.idx == index, jobs.c.superseded.is_(False))
    row = connection.execute(current).first()
    if row is None or row.state != State.SUBMITTED:
        return f"the ledger expects no file for episode {index} (its job is {row.state if row else 'not planned'})"
    size = path.stat().st_size
    if size != row.size:
        return f"{size} bytes, {row.size} were announced"
    try:
        target = terms.catalog[row.scene].info.target(row.target_id)
        job = to_job(terms.plan, terms.catalog, planned_of(row), row.attempt)
        with at_hand(path) as file:
            summary = checker.check(file, job, target)
    except InvalidBundle as error:
        return str(error)
    if not adopt(connection, row.id, summary, now):
        return f"SHA-256 {summary.file_sha256}, {row.sha256} was announced"
    return ""

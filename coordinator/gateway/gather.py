"""Brings the episodes that gateways keep into the core's own dataset: copied, compared with the ledger, taken home.

Runs without a coordinator and deletes nothing: what a gateway has stays there. Cut off, it is simply run again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from sqlalchemy import Engine, select
from sqlalchemy.engine import Connection

from coordinator.archive.contract import Archive
from coordinator.archive.opening import open_archive
from coordinator.ledger.engine import open_writer
from coordinator.ledger.keepers import all_keepers, bring_home
from coordinator.ledger.outcomes import lose
from coordinator.ledger.reading.look import require_sound
from coordinator.ledger.tables import episodes
from coordinator.recovery.mend import RepairInput
from coordinator.tables.checkpoint import write_checkpoint
from coordinator.tables.split_tables import write_split_tables
from schemas.base import Model
from schemas.dataset_files import EPISODES
from schemas.errors import UsageError, WorldError
from schemas.job import episode_id
from schemas.storage.object_path import ObjectPath
from schemas.storage.place import digest_of

__all__ = ["GatherReport", "Missing", "gather"]

_COPY_BYTES = 1 << 20
ProgressCallback = Callable[[int, int], None]


class Missing(Model):
    """An episode that was not found whole in any of the directories."""

    episode: str
    gateway: str
    """That keeps it, as the ledger says."""
    why: str


class GatherReport(Model):
    """What came of a gathering."""

    dataset: str
    run: str
    gathered: int
    """Episodes taken home now."""
    missing: tuple[Missing, ...]
    requeued: bool
    """Whether the missing ones were put back into the queue, to be made anew."""
    episodes: int
    """That lie in the dataset now."""
    planned: int


@dataclass(frozen=True)
class _Wanted:
    """An episode as the ledger owns it."""

    index: int
    gateway: str
    sha256: str
    size: int


def gather(
    patient: RepairInput,
    sources: Sequence[Path],
    now: datetime,
    *,
    requeue_missing: bool = False,
    tell: ProgressCallback = lambda _done, _all: None,
) -> GatherReport:
    """Takes home what lies at gateways, as far as it is found.

    Args:
        patient: the core's dataset, and what is known of it.
        sources: directories of gateways, or copies of them.
        now: of the gathering.
        requeue_missing: whether what is found nowhere is given up for lost and made anew.
        tell: told how many episodes of how many are done.

    Raises:
        UsageError: a source is no directory of a gateway.
        WorldError: a coordinator works on the dataset, its ledger is lost or damaged, or the disk refuses.
    """
    for source in sources:
        if not (source / EPISODES).is_dir():
            raise UsageError(f"{source} has no {EPISODES}/: give the --out of a gateway, or a copy of it")
    missing: list[Missing] = []
    with ExitStack() as stack:
        store = patient.root if isinstance(patient.root, ObjectPath) else None
        archive = stack.enter_context(open_archive(patient.home, store))
        if patient.stranger:
            raise WorldError(f"the ledger {patient.stranger}; `factory repair {patient.root}` rebuilds the right one")
        require_sound(patient.url)
        engine = open_writer(patient.url)
        stack.callback(engine.dispose)
        with engine.connect() as connection:
            wanted = _wanted(connection)
        for done, one in enumerate(wanted, 1):
            why = _fetch(archive, one, sources)
            if why:
                missing.append(Missing(episode=episode_id(one.index), gateway=one.gateway, why=why))
            _settle(engine, one, why, now, requeue_missing=requeue_missing)
            tell(done, len(wanted))
        with engine.connect() as connection:
            write_checkpoint(archive, connection, patient.plan, patient.catalog, now)
        write_split_tables(archive)
        return GatherReport(
            dataset=str(patient.root),
            run=patient.plan.run,
            gathered=len(wanted) - len(missing),
            missing=tuple(missing),
            requeued=requeue_missing and bool(missing),
            episodes=len(archive.present()),
            planned=patient.plan.episodes,
        )


def _wanted(connection: Connection) -> list[_Wanted]:
    away = all_keepers(connection)
    rows = connection.execute(select(episodes.c.idx, episodes.c.sha256, episodes.c.size).order_by(episodes.c.idx))
    return [_Wanted(row.idx, away[row.idx], row.sha256, row.size) for row in rows if row.idx in away]


def _settle(engine: Engine, one: _Wanted, why: str, now: datetime, *, requeue_missing: bool) -> None:
    if not why:
        with engine.begin() as connection:
            bring_home(connection, one.index)
    elif requeue_missing:
        with engine.begin() as connection:
            lose(connection, one.index, now, f"stored at gateway {one.gateway}: {why}")


def _fetch(archive: Archive, one: _Wanted, sources: Sequence[Path]) -> str:
    """Copies an episode into the dataset; returns why not, or nothing when it lies there, durable and as recorded."""
    home = archive.path_of(one.index)
    if home.exists():
        if digest_of(home) == one.sha256:
            return ""  # cut off the last time between file and ledger
        archive.quarantine(home, f"its SHA-256 is not {one.sha256}, which the ledger has")
    found = []
    for source in sources:
        path = source / EPISODES / home.name
        if path.is_file():
            why = _copy(archive, one, path)
            if not why:
                return ""
            found.append(why)
    return "; ".join(found) or "found in none of the directories given"


def _copy(archive: Archive, one: _Wanted, path: Path) -> str:
    with archive.stage(one.index) as staged:
        try:
            with path.open("rb") as file:
                while staged.size <= one.size and (block := file.read(_COPY_BYTES)):
                    staged.write(block)
        except OSError as error:  # of the source: what the archive cannot take is a WorldError
            return f"{path} cannot be read: {error.strerror}"
        if staged.sha256 != one.sha256:
            return f"{path} has SHA-256 {staged.sha256}, but {one.sha256} in the ledger"
        archive.publish(staged, one.index)
    return ""

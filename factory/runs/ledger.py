"""Read-only looks at the ledger of a dataset directory, for the verbs that report. Never writes."""

from __future__ import annotations

from contextlib import AbstractContextManager
from datetime import UTC, datetime
from pathlib import Path

from coordinator.archive.staging import is_held
from coordinator.ledger.engine import has_writer
from coordinator.ledger.opening import holds_run, ledger_url_of, read_info
from coordinator.ledger.reading.progress import read_progress
from coordinator.ledger.reading.reader import Connection, open_ledger
from factory.dataset.site import Site
from schemas.dataset_files import EPISODES, LEDGER_FILE, META_FILE
from schemas.dataset_meta import read_dataset_meta
from schemas.errors import UsageError, WorldError
from schemas.plan import Plan
from schemas.storage.place import Place, children
from schemas.wire import Progress

__all__ = ["plan_of", "progress_of", "read_ledger"]


def read_ledger(site: Site, url: str | None = None) -> AbstractContextManager[Connection]:
    """Opens the ledger of a dataset for reading.

    Raises:
        UsageError: there is no such directory, or no home of such a URL on this machine.
        WorldError: the directory holds no ledger.
    """
    if url is None and not site.home.is_dir():
        begin = f"start a run with `factory run demo --out {site}`"
        if site.store is None:
            raise UsageError(f"directory {site} does not exist; {begin}")
        raise UsageError(
            f"the ledger of {site} is missing in {site.home}; {begin}, or rebuild the ledger with `factory repair "
            f"{site}`"
        )
    if url is None and not (site.home / LEDGER_FILE).is_file() and (count := len(children(site.place / EPISODES))):
        raise WorldError(
            f"{site} has {count} episodes but no ledger: rebuild the ledger with `factory repair {site}`, or "
            "continue the run with "
            "the command that started it"
        )
    return open_ledger(ledger_url_of(site.home, url))


def plan_of(site: Site) -> Plan | None:
    """Returns the plan a place was begun with, as its ledger or else its description says; `None` when neither does.

    Raises:
        WorldError: the two name different plans.
        UsageError: the ledger is of a newer format.
    """
    noted, described = _noted_plan(site.home), _described_plan(site.place)
    if noted is not None and described is not None and noted.digest != described.digest:
        raise WorldError(
            f"the ledger in {site.home} is of run {noted.run}, and {META_FILE} of {site} of run {described.run}: "
            "restore "
            f"the ledger of {described.run}, or rebuild it from the episodes with `factory repair {site}`"
        )
    return noted or described


def _noted_plan(home: Path) -> Plan | None:
    if not (home / LEDGER_FILE).is_file():
        return None
    try:
        with open_ledger(ledger_url_of(home)) as connection:
            return read_info(connection).plan if holds_run(connection) else None
    except WorldError:
        return None  # damaged: it is rebuilt when a coordinator starts


def _described_plan(place: Place) -> Plan | None:
    try:
        return read_dataset_meta(place).plan
    except WorldError:
        return None


def progress_of(site: Site, url: str | None = None) -> Progress:
    """Returns where the run of a directory stands; no worker is alive where no coordinator runs.

    A PostgreSQL server tells whether a coordinator writes to the ledger, wherever that runs. An SQLite ledger in
    another place does not tell; its workers are judged by their beats.
    """
    with read_ledger(site, url) as connection:
        progress = read_progress(connection, datetime.now(UTC))
        has_coordinator = is_held(site.home) if url is None else has_writer(connection)
    if has_coordinator is not False:
        return progress
    gone = tuple(worker.model_copy(update={"alive": False}) for worker in progress.workers)
    return progress.model_copy(update={"workers": gone})

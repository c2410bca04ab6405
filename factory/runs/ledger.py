"""Reads the ledger of a dataset for the reporting commands. Never writes."""

from __future__ import annotations

from contextlib import AbstractContextManager
from datetime import UTC, datetime
from pathlib import Path

from coordinator.archive.staging import is_held
from coordinator.ledger.database.engine import has_writer
from coordinator.ledger.opening import holds_run, ledger_url_of, read_info, recorded_ledger
from coordinator.ledger.reading.progress import read_progress, without_coordinator
from coordinator.ledger.reading.reader import Connection, open_ledger
from factory.dataset.site import Site
from schemas.dataset.meta import read_dataset_meta
from schemas.dataset.run_shard import RunShard, read_shard_state
from schemas.errors import UsageError, WorldError
from schemas.plan import Plan
from schemas.protocol.status import Progress
from schemas.storage.dataset_files import EXTENSION, LEDGER_FILE, META_FILE, is_dataset
from schemas.storage.episode_list import list_episodes
from schemas.storage.place import Place
from schemas.storage.shard_index import shard_places
from schemas.support.shell import quoted


def read_ledger(site: Site, url: str | None = None) -> AbstractContextManager[Connection]:
    """Opens the ledger of a dataset for reading.

    Raises:
        UsageError: The directory does not exist, or this machine has no state directory for the URL.
        WorldError: The directory has no ledger.
    """
    place = ledger_url_of(site.state_dir, url)
    if url is None and not site.state_dir.is_dir():
        begin = f"start a run with `factory run demo --out {quoted(site)}`"
        if site.store is None:
            raise UsageError(f"directory {site} does not exist; {begin}")
        raise UsageError(
            f"the ledger of {site} is missing in {site.state_dir}; {begin}, or rebuild the ledger with `factory repair "
            f"{quoted(site)}`"
        )
    if url is None and not (site.state_dir / LEDGER_FILE).is_file() and (runs := _joined_runs(site)):
        raise WorldError(
            f"{site} {runs} and has no ledger: see its content with `factory stats {quoted(site)}` or `factory serve "
            f"{quoted(site)}`"
        )
    if (
        url is None
        and not (site.state_dir / LEDGER_FILE).is_file()
        and (count := len(list_episodes(site.place).episodes))
    ):
        raise WorldError(
            f"{site} has {count} episodes but no ledger: rebuild the ledger with `factory repair "
            f"{quoted(site)}`, or continue "
            "the run with the command that started it"
        )
    return open_ledger(place)


def plan_of(site: Site) -> Plan | None:
    """Returns the plan of a dataset, from its ledger or else from `dataset_meta.json`; `None` without either.

    Raises:
        WorldError: Ledger and `dataset_meta.json` contain different plans.
        UsageError: The ledger has another format.
    """
    noted, described = _noted_plan(site.state_dir), _described_plan(site.place)
    if noted is not None and described is not None and noted.digest != described.digest:
        raise WorldError(
            f"the ledger in {site.state_dir} is of run {noted.run}, but {META_FILE} of {site} is of {described.run}: "
            f"restore the ledger of {described.run}, or rebuild it from the episodes with `factory repair "
            f"{quoted(site)}`"
        )
    return noted or described


def shard_of(site: Site, url: str | None = None) -> RunShard | None:
    """Returns the shard of a run in a directory, from `run_shard.json` or else from the ledger; `None` without either.

    Args:
        site: location of the shard.
        url: URL of the ledger, if it is not in the directory.
    """
    state = read_shard_state(site.place)
    if state is not None:
        return state.shard
    try:
        with open_ledger(ledger_url_of(site.state_dir, url)) as connection:
            return read_info(connection).shard if holds_run(connection) else None
    except WorldError:
        return None


def _noted_plan(state_dir: Path) -> Plan | None:
    if not (state_dir / LEDGER_FILE).is_file() or recorded_ledger(state_dir):
        return None
    try:
        with open_ledger(ledger_url_of(state_dir)) as connection:
            return read_info(connection).plan if holds_run(connection) else None
    except WorldError:
        return None  # the ledger is damaged; the coordinator rebuilds it when it starts


def _described_plan(place: Place) -> Plan | None:
    try:
        return read_dataset_meta(place).plan
    except WorldError:
        return None


def require_outside_datasets(site: Site) -> None:
    """Raises `UsageError` if a directory is inside another dataset."""
    around = next((parent for parent in site.state_dir.absolute().parents if is_dataset(parent)), None)
    if site.store is None and around is not None:
        raise UsageError(f"{site} is inside the dataset {around}: choose an --out outside of it")


def require_single_run(site: Site) -> None:
    """Raises `UsageError` if a dataset has several runs or an unfinished extension, so no run can be continued."""
    if (site.state_dir / EXTENSION).is_dir():
        raise UsageError(
            f"{site} has an unfinished extension: finish it with `factory run --extend --out {quoted(site)}`, or "
            "delete "
            f"{quoted(site.state_dir / EXTENSION)}"
        )
    runs = _joined_runs(site)
    if runs:
        raise UsageError(f"{site} {runs}, so there is no run to continue: `factory merge` joins it with other datasets")


def _joined_runs(site: Site) -> str:
    """Returns the predicate of a sentence about a dataset of several runs; empty for others."""
    try:
        meta = read_dataset_meta(site.place)
    except WorldError:
        return ""
    if not meta.sources:
        return ""
    if meta.sources[-1].extends:
        return (
            f"was extended to {meta.planned} episodes (more: `factory run --extend --episodes N --out {quoted(site)}`)"
        )
    return f"was merged from {len(meta.sources)} runs"


def progress_of(site: Site, url: str | None = None) -> Progress:
    """Returns the progress of the run of a dataset; see `progress_in`."""
    with read_ledger(site, url) as connection:
        return progress_in(connection, site, url)


def progress_in(connection: Connection, site: Site, url: str | None = None) -> Progress:
    """Returns the progress of the run of an open ledger; without a running coordinator, no worker counts as alive.

    A PostgreSQL server reports whether a coordinator writes to the ledger, on any host. An SQLite ledger in another
    location does not; there, heartbeats decide whether workers are alive.

    Args:
        connection: ledger that was opened with `read_ledger`.
        site: location of the dataset.
        url: URL of the ledger; `None` for the ledger of the dataset.
    """
    shards = len(shard_places(site.place))
    progress = read_progress(connection, datetime.now(UTC)).model_copy(update={"shards": shards})
    has_coordinator = is_held(site.state_dir) if url is None else has_writer(connection)
    return without_coordinator(connection, progress) if has_coordinator is False else progress

"""Opens the ledger of a run: creates it from a plan, or checks that it belongs to the same plan and scenes.

The module does not change jobs; `claims`, `outcomes` and `operator` do.
"""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import xxhash
from pydantic import TypeAdapter
from sqlalchemy import Engine, Row, insert, inspect, or_, select
from sqlalchemy.engine import Connection

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import PlannedJob, expand_each
from coordinator.ledger.builds import built_layouts, insert_builds, unbuilt_layouts
from coordinator.ledger.database.engine import is_server, public_url, sqlite_url
from coordinator.ledger.states import OPEN_STATES, JobState
from coordinator.ledger.tables import (
    BUILD,
    FORMER_FORMATS,
    LEDGER_FORMAT,
    METADATA,
    PLANNED,
    PLANNED_EPISODES,
    info,
    jobs,
)
from coordinator.ledger.tallies import install_tallies
from schemas.base import Line, Model, Sha256
from schemas.dataset.run_shard import RunShard, parse_shard
from schemas.episode_spec import EpisodeSpec
from schemas.errors import UsageError, WorldError
from schemas.plan import Plan
from schemas.storage.dataset_files import LEDGER_FILE, LEDGER_PLACE_FILE

_INSERT_ROWS = 5000
_MOST_DIFFERENCES, _VALUE_CHARS = 12, 60
_DIGITS = re.compile("[0-9]{1,9}")
_SCENES = TypeAdapter(dict[str, Sha256])
_TEXTS = TypeAdapter(tuple[Line, ...])
_SANDBOX, _SHARD, _OPENED, _VERSIONS = "sandbox", "shard", "opened_at", "versions"
_MOST_PLACE_BYTES = 1 << 16
_MOST_VERSIONS = 100
"""Largest number of recorded versions; the newest are kept."""
_BEGUN_WITH = ("plan_digest", "scenes", "created_at")
_BUILDING = select(jobs.c.scene).where(jobs.c.tier == BUILD)
_IDENTITY = ("idx", "scene", "tier", "split", "category", "target_id", "colour", "template_id", "instruction")


class _LedgerPlace(Model):
    """Content of `ledger.json`."""

    kind: Literal["sqlite", "postgresql"]
    """Kind of the database."""
    url: Line
    """URL of the database, without password."""


@dataclass(frozen=True)
class LedgerInfo:
    """Description of the run in the ledger."""

    format: int
    """Format version of the ledger."""
    run: str
    """Name of the run."""
    plan: Plan
    """Plan of the run."""
    scenes: Mapping[str, str]
    """Mapping of scene name to SHA-256 of the compiled package at the start of the run."""
    lease_ttl_s: float
    """Duration of a lease, seconds."""
    created_at: datetime
    """Creation time of the run."""
    opened_at: datetime
    """Time at which a coordinator last opened the unfinished run."""
    sandbox: tuple[str, ...] = ()
    """Active sandbox layers of the validating processes; empty if none was started."""
    shard: RunShard | None = None
    """Shard of the run that the ledger contains; `None` if it contains the whole run."""
    layouts: Mapping[str, str] = field(default_factory=dict)
    """Mapping of layout to SHA-256 of the package that a worker has built."""
    episodes: int | None = None
    """Number of episodes, including those of unbuilt layouts; `None` if the run was created with all scenes."""


def ledger_url_of(root: Path, url: str | None = None) -> str:
    """Returns `url`, or by default the URL of the ledger in a dataset directory.

    Raises:
        UsageError: no URL is given, and the ledger of the dataset is elsewhere.
    """
    elsewhere = recorded_ledger(root) if url is None else ""
    if elsewhere:
        secret = ", with its password if it needs one" if is_server(elsewhere) else ""
        raise UsageError(
            f"the ledger of {root} is {elsewhere}: give it as --ledger or in MINIVLA_LEDGER{secret}; without it, a "
            "second ledger would be made"
        )
    return url or sqlite_url(root / LEDGER_FILE)


def record_ledger(root: Path, url: str) -> None:
    """Writes where the ledger of a dataset is, without password, unless it is the file in the directory.

    Args:
        root: directory of the dataset, or its state directory.
        url: URL of the ledger.
    """
    path = root / LEDGER_PLACE_FILE
    if url == sqlite_url(root / LEDGER_FILE):
        path.unlink(missing_ok=True)
        return
    kind = "postgresql" if is_server(url) else "sqlite"
    part = path.with_name(f"{path.name}.part")
    part.write_text(json.dumps({"kind": kind, "url": public_url(url)}) + "\n", encoding="utf-8")
    part.replace(path)


def recorded_ledger(root: Path) -> str:
    """Returns the recorded URL of a ledger elsewhere, without password; empty if none is recorded.

    Raises:
        WorldError: the record is damaged.
    """
    path = root / LEDGER_PLACE_FILE
    try:
        with path.open("rb") as file:
            return _LedgerPlace.model_validate_json(file.read(_MOST_PLACE_BYTES)).url
    except (FileNotFoundError, NotADirectoryError):
        return ""
    except ValueError as error:
        raise WorldError(
            f"{path} is damaged: remove it, and give the ledger of the run as --ledger; the next start writes it again"
        ) from error


def open_run(
    engine: Engine,
    plan: Plan,
    catalog: Catalog,
    lease_ttl_s: float,
    now: datetime,
    planned: Iterable[PlannedJob] | None = None,
    shard: RunShard | None = None,
) -> bool:
    """Creates the run in an empty database, or checks that the database contains this run.

    Args:
        engine: engine of the writer.
        plan: plan of the run.
        catalog: compiled scenes of the plan.
        lease_ttl_s: duration of a lease, seconds.
        now: current time.
        planned: jobs of a new run; `None` expands the plan.
        shard: shard of the run that the ledger contains; `None` for the whole run.

    Returns:
        Whether the run is new.

    Raises:
        UsageError: the database belongs to another plan or shard, or has another format.
        WorldError: a scene differs from the scene at the start of the run.
        InvalidPlan: the plan requires targets that its scenes do not have.
    """
    if shard is not None and unbuilt_layouts(plan, catalog):
        raise ValueError("a shard of a run needs the packages of all layouts")
    with engine.begin() as connection:
        if holds_run(connection):
            recorded = read_info(connection)
            _check_is_ours(recorded, plan, catalog, {**recorded.scenes, **recorded.layouts})
            require_shard(recorded.shard, shard)
            install_tallies(connection)
            write_info(connection, {"lease_ttl_s": str(lease_ttl_s)})
            note_opened(connection, now)
            return False
        unbuilt = unbuilt_layouts(plan, catalog) if planned is None else []
        planned = expand_each(plan, catalog) if planned is None else planned
        if shard is not None:
            numbers = shard.numbers(plan.episodes)
            planned = (job for job in planned if job.index in numbers)
        METADATA.create_all(connection)
        insert_planned(connection, planned, now)
        if unbuilt:
            insert_builds(connection, plan, unbuilt, now)
            write_info(connection, {PLANNED_EPISODES: str(plan.episodes)})
        install_tallies(connection)
        write_info(connection, _facts(plan, catalog, lease_ttl_s, now))
        if shard is not None:
            write_info(connection, {_SHARD: str(shard)})
        write_info(connection, {PLANNED: planned_digest(connection)})
        return True


def _has_open_jobs(connection: Connection) -> bool:
    query = select(jobs.c.id).where(jobs.c.superseded.is_(False), jobs.c.state.in_(OPEN_STATES)).limit(1)
    return connection.execute(query).first() is not None


def read_info(connection: Connection) -> LedgerInfo:
    """Returns the description of the run.

    Raises:
        UsageError: the ledger has another format, or the database contains no ledger.
        WorldError: the description is damaged.
    """
    if not holds_run(connection):
        raise UsageError("the database contains no ledger: start a run with `factory run`")
    facts = {row.key: row.value for row in connection.execute(select(info))}
    _check_format(connection, facts.get("format"))
    try:
        recorded = _info_of(facts)
        return replace(recorded, layouts=built_layouts(connection, recorded.plan.episodes))
    except (KeyError, ValueError, TypeError, OverflowError) as error:
        reason = str(error).splitlines()[0]
        raise WorldError(f"the ledger is damaged: its description cannot be read ({reason})") from error


class FormerFormat(UsageError):
    """Ledger of an older format, which `factory repair` replaces.

    A start does not replace it, as it would a damaged ledger: the older version can still finish the run, and a rebuilt
    ledger lacks what only the old one records.

    Args:
        found: format of the ledger.
        on_server: whether a database server stores the ledger.
    """

    def __init__(self, found: int, *, on_server: bool) -> None:
        self.why = (
            f"has format {found} of minivla-factory {FORMER_FORMATS[found]}, and this version reads format "
            f"{LEDGER_FORMAT} only"
        )
        """Predicate of a sentence about the ledger."""
        repair = "`factory repair DIR`" + (" with an empty database as --ledger" if on_server else "")
        super().__init__(
            f"the ledger {self.why}: rebuild it from the episodes with {repair}, or finish the run with version "
            f"{FORMER_FORMATS[found]}"
        )


def require_current_format(connection: Connection) -> None:
    """Checks that this software can read the ledger; a database without a ledger or with a damaged one passes.

    Raises:
        FormerFormat: the ledger has an older format.
        UsageError: the ledger has a newer format.
    """
    if holds_run(connection):
        _check_format(connection, connection.execute(select(info.c.value).where(info.c.key == "format")).scalar())


def _check_format(connection: Connection, recorded: object) -> None:
    found = int(recorded) if isinstance(recorded, str) and _DIGITS.fullmatch(recorded) else 0
    if found > LEDGER_FORMAT:
        raise UsageError(
            f"the ledger has format {found}, and this version reads format {LEDGER_FORMAT} only: use the newer "
            "minivla-factory that wrote it"
        )
    if found in FORMER_FORMATS:
        raise FormerFormat(found, on_server=connection.dialect.name != "sqlite")


@functools.lru_cache(maxsize=2)
def _read_plan(text: str) -> Plan:
    """Parses a plan; cached, because a reader needs the same plan each time it reads the progress."""
    return Plan.model_validate_json(text)


def _info_of(facts: Mapping[str, str]) -> LedgerInfo:
    if (format_number := int(facts["format"])) != LEDGER_FORMAT:
        raise ValueError(f"format {format_number} does not exist")
    plan = _read_plan(facts["plan"])
    if (plan.digest, plan.run) != (facts["plan_digest"], facts["run"]):
        raise ValueError(f"its plan is not that of run {facts['run']}")
    return LedgerInfo(
        format=format_number,
        run=facts["run"],
        plan=plan,
        scenes=_SCENES.validate_json(facts["scenes"]),
        lease_ttl_s=float(facts["lease_ttl_s"]),
        created_at=datetime.fromisoformat(facts["created_at"]),
        sandbox=tuple(facts.get(_SANDBOX, "").split()),
        shard=parse_shard(facts[_SHARD]) if _SHARD in facts else None,
        episodes=int(facts[PLANNED_EPISODES]) if PLANNED_EPISODES in facts else None,
        opened_at=datetime.fromisoformat(facts.get(_OPENED, facts["created_at"])),
    )


def note_version(connection: Connection, version: str) -> str:
    """Records the version that continues an unfinished run; returns the last recorded one if it differs, else empty.

    A run without open jobs produces no more episodes, so nothing is recorded.
    """
    if not _has_open_jobs(connection):
        return ""
    versions = recorded_versions(connection)
    if versions[-1:] == (version,):
        return ""
    write_info(connection, {_VERSIONS: json.dumps([*versions, version][-_MOST_VERSIONS:])})
    return versions[-1] if versions else ""


def note_opened(connection: Connection, now: datetime) -> None:
    """Records when an unfinished run was opened; the rate counts the episodes that were archived after this time."""
    if _has_open_jobs(connection):
        write_info(connection, {_OPENED: now.isoformat()})


def recorded_versions(connection: Connection) -> tuple[str, ...]:
    """Returns the versions of minivla-factory that have run the coordinator, oldest first; empty in old ledgers.

    Raises:
        WorldError: the record is damaged.
    """
    text = connection.execute(select(info.c.value).where(info.c.key == _VERSIONS)).scalar()
    if text is None:
        return ()
    try:
        return _TEXTS.validate_json(text)
    except ValueError as error:
        raise WorldError(f"the ledger is damaged: its record of versions {text[:80]!r} cannot be read") from error


def note_sandbox(connection: Connection, layers: Sequence[str]) -> None:
    """Records the active sandbox layers of the validating processes."""
    write_info(connection, {_SANDBOX: " ".join(layers)})


def planned_digest(connection: Connection, span: range | None = None) -> str:
    """Returns a digest of the initial state of the run: its scenes, the first draw of every episode, and the builds.

    Args:
        connection: connection for reading.
        span: numbers of the episodes of one layout that a worker has built; the digest then covers these episodes only.
            `None`: all builds, and all episodes except those of layouts that workers build.
    """
    digest = xxhash.xxh3_128()
    facts = select(info).where(info.c.key.in_(_BEGUN_WITH)).order_by(info.c.key)
    digest.update(repr([tuple(row) for row in connection.execute(facts)]).encode("utf-8", "surrogatepass"))
    query = select(*(jobs.c[name] for name in _IDENTITY)).where(jobs.c.draw == 0).order_by(jobs.c.idx)
    if span is None:
        query = query.where(or_(jobs.c.tier == BUILD, jobs.c.scene.not_in(_BUILDING)))
    else:
        query = query.where(jobs.c.idx.between(span[0], span[-1]))
    rows = iter(connection.execute(query.execution_options(yield_per=_INSERT_ROWS)))
    while batch := [tuple(row) for row in islice(rows, _INSERT_ROWS)]:
        digest.update(repr(batch).encode("utf-8", "surrogatepass"))
    return digest.hexdigest()


def holds_run(connection: Connection) -> bool:
    """Returns whether the database contains a run; `False` if the first transaction of a run was interrupted."""
    return inspect(connection).has_table(info.name)


def insert_planned(connection: Connection, planned: Iterable[PlannedJob], now: datetime, attempt: int = 1) -> None:
    """Inserts draws as pending jobs with the given attempt number."""
    start = {"state": JobState.PENDING, "attempt": attempt, "changed_at": now.timestamp()}
    rows: Iterator[dict[str, Any]] = (_row_of(job) | start for job in planned)
    while batch := list(islice(rows, _INSERT_ROWS)):
        connection.execute(insert(jobs), batch)


def planned_of(row: Row[Any]) -> PlannedJob:
    return PlannedJob(row.idx, row.draw, EpisodeSpec.of(row))


def _row_of(planned: PlannedJob) -> dict[str, Any]:
    return {"idx": planned.index, "draw": planned.draw, **dict(planned.episode)}


def _facts(plan: Plan, catalog: Catalog, lease_ttl_s: float, now: datetime) -> dict[str, str]:
    return {
        "format": str(LEDGER_FORMAT),
        "run": plan.run,
        "plan_digest": plan.digest,
        "plan": plan.model_dump_json(),
        "scenes": json.dumps({name: entry.sha256 for name, entry in sorted(catalog.items())}),
        "lease_ttl_s": str(lease_ttl_s),
        "created_at": now.isoformat(),
    }


def write_info(connection: Connection, facts: Mapping[str, str]) -> None:
    """Writes values of the table `info`; replaces earlier ones."""
    for key, value in facts.items():
        if connection.execute(info.update().where(info.c.key == key).values(value=value)).rowcount == 0:
            connection.execute(info.insert().values(key=key, value=value))


def require_plan(recorded: Plan, plan: Plan) -> None:
    """Checks that a plan equals the plan of the ledger.

    Raises:
        UsageError: the plans differ.
    """
    if recorded.digest != plan.digest:
        raise UsageError(
            f"the directory contains run {recorded.run} ({recorded.episodes} episodes, seed {recorded.seed}), but "
            f"{plan.run} ({plan.episodes} episodes, seed {plan.seed}) was requested: to continue it, run "
            "`factory run --out DIR` without PLAN and its options; otherwise choose another --out"
            + "".join(f"\n  - {line}" for line in plan_differences(recorded, plan))
        )


def plan_differences(recorded: Plan, plan: Plan) -> list[str]:
    """Returns a line for each key whose value differs between two plans, with both values."""
    former, wanted = (dict(_flat(one.model_dump(mode="json"))) for one in (recorded, plan))
    keys = [key for key in {**former, **wanted} if former.get(key) != wanted.get(key)]
    lines = [f"{key}: recorded {_shown(former.get(key))}, requested {_shown(wanted.get(key))}" for key in keys]
    return lines if len(lines) <= _MOST_DIFFERENCES else [*lines[:_MOST_DIFFERENCES], f"{len(lines)} keys in all"]


def _flat(value: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """Yields the values in nested data with their keys, e.g. `scenes[0].episodes`."""
    if isinstance(value, dict) and value:
        for name, inner in value.items():
            yield from _flat(inner, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        for number, inner in enumerate(value):
            yield from _flat(inner, f"{key}[{number}]")
    else:
        yield key, value


def _shown(value: Any) -> str:
    text = "nothing" if value is None else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _VALUE_CHARS else f"{text[:_VALUE_CHARS]}..."


def require_shard(recorded: RunShard | None, shard: RunShard | None) -> None:
    """Checks that a shard equals the shard of the ledger.

    Raises:
        UsageError: the shards differ.
    """
    if recorded != shard:
        had = "the whole run" if recorded is None else f"shard {recorded} of the run"
        wanted = "the whole run" if shard is None else f"shard {shard} of it"
        remedy = "without --shard" if recorded is None else f"with --shard {recorded}"
        raise UsageError(
            f"the directory contains {had}, but {wanted} was requested: continue it {remedy}, or choose another --out"
        )


def _check_is_ours(recorded: LedgerInfo, plan: Plan, catalog: Catalog, scenes: Mapping[str, str]) -> None:
    require_plan(recorded.plan, plan)
    for name, sha256 in scenes.items():
        if name not in catalog or catalog[name].sha256 != sha256:
            now = catalog[name].sha256[:16] if name in catalog else "none"
            raise WorldError(
                f"scene {name!r} has SHA-256 {now}, but had {sha256[:16]} when run {recorded.run} began, so new "
                "episodes "
                "would differ from the existing ones: restore the original scene, or choose another --out"
            )

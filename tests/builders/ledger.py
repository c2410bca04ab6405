"""Builds a minimal run with a ledger: one room, a few chairs, an in-memory database and a test clock."""

from __future__ import annotations

import functools
import hashlib
import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from sqlalchemy import Engine, Row, select
from sqlalchemy.engine import Connection

from coordinator.expansion.catalog import Catalog, SceneEntry
from coordinator.expansion.draw import redraw
from coordinator.ledger import claims, outcomes
from coordinator.ledger.claims import lease_of
from coordinator.ledger.database.engine import open_writer
from coordinator.ledger.opening import open_run
from coordinator.ledger.tables import jobs
from schemas.dataset.rows import EpisodeSummary, summary_of
from schemas.episode import EpisodeMeta
from schemas.plan import Budget, Plan, ScenePlan
from schemas.protocol.messages import Done, Fail, Lease
from schemas.scene import Instance, SceneInfo, Target
from schemas.terms import FailReason, Recording, Split, Tier
from tests.builders.bundle import GOAL_M, TARGET_ID, job_for, parts_for, short_task
from tests.builders.package import package_without_arrays

TTL_S = 10.0
SHA256 = "c" * 64


def room_plan(episodes: int = 3, record: Recording = Recording.FRAMES, **budget: int) -> Plan:
    """Returns a plan for which the smallest bundle is a valid result of every job."""
    return Plan(
        name="room",
        scenes=(ScenePlan(name="room", episodes=episodes, usd="room.usda", seen=("chair",)),),
        tiers={Tier.NEAR: 1.0},
        splits={Split.TRAIN_ID: 1.0},
        budget=Budget(**budget),
        task=short_task(),
        record=record,
    )


def room_catalog(folder: Path | None = None, seed: int = 0) -> Catalog:
    """Returns a catalog of one scene with three chairs at the same position.

    With a folder, a package of 1.5 MB without arrays is written there."""
    targets = tuple(
        Target(
            target_id=f"chair_{number:03d}",
            category="chair",
            instance_id=TARGET_ID,
            prim_path="/World/chair_1",
            centroid_m=GOAL_M,
            size_m=(0.5, 0.5, 1.0),
            colour="red",
            straight_tiers=tuple(Tier),
            connected_tiers=tuple(Tier),
        )
        for number in (1, 2, 3)
    )
    info = SceneInfo(
        name="room",
        source="test",
        source_sha256="0" * 64,
        metres_per_unit=1.0,
        bounds_m=((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
        grid_origin_m=(0.0, 0.0),
        targets=targets,
        instances=(Instance(id=TARGET_ID, prim_path="/World/chair_1", category="chair"),),
    )
    data = package_without_arrays(info, bytes([seed]) + bytes(range(256)) * 6000)
    path = (folder or Path("nowhere")) / "room.scene"
    if folder is not None:
        path.write_bytes(data)
    return {"room": SceneEntry(info, hashlib.sha256(data).hexdigest(), len(data), path)}


def summary_for(row: Row[Any]) -> EpisodeSummary:
    """Returns the row of an archived episode for a submitted job."""
    job = job_for(row.idx, draw=row.draw, attempt=row.attempt)
    meta = _smallest_meta().model_copy(update={"job": job, "episode_id": job.episode_id})
    return summary_of(meta, row.sha256 or SHA256, row.size or 1000)


@functools.cache
def _smallest_meta() -> EpisodeMeta:
    return parts_for().meta


class TimedLedger:
    """A ledger with a clock that tests advance. As in the protocol, each call is one transaction."""

    def __init__(self, plan: Plan | None = None, url: str = "sqlite://", catalog: Catalog | None = None) -> None:
        self.plan = plan or room_plan()
        self.catalog = catalog or room_catalog()
        self.now = datetime(2026, 1, 2, tzinfo=UTC)
        self.engine: Engine = open_writer(url)
        self._tokens = itertools.count(1)
        self._holders: dict[str, str] = {}
        open_run(self.engine, self.plan, self.catalog, TTL_S, self.now)

    @contextmanager
    def open(self) -> Iterator[Connection]:
        with self.engine.begin() as connection:
            yield connection

    def tick(self, seconds: float) -> int:
        """Advances the clock and sweeps; returns the number of expired leases."""
        self.now += timedelta(seconds=seconds)
        with self.open() as connection:
            return claims.expire(connection, self.now)

    def new_token(self) -> str:
        return f"{next(self._tokens):032x}"

    def claim(self, sid: str = "host-1", token: str | None = None) -> Row[Any] | None:
        token = token or self.new_token()
        self._holders.setdefault(token, sid)
        with self.open() as connection:
            return claims.claim(connection, sid, token, self.now, TTL_S)

    def holder_of(self, lease: Lease) -> str:
        """Returns the session that claimed the job."""
        return self._holders.get(lease.token, "host-1")

    def lease(self, sid: str = "host-1") -> Lease:
        """Claims a job and returns its lease; a job must be available."""
        row = self.claim(sid)
        assert row is not None
        return lease_of(row)

    def done(self, lease: Lease, sid: str | None = None, sha256: str = SHA256) -> bool:
        report = Done(sid=sid or self.holder_of(lease), lease=lease, sha256=sha256, size=1000)
        with self.open() as connection:
            return outcomes.announce(connection, report, self.now, TTL_S).accepted

    def fail(self, lease: Lease, reason: FailReason, sid: str | None = None, detail: str = "measured") -> bool:
        report = Fail(sid=sid or self.holder_of(lease), lease=lease, reason=reason, detail=detail, steps=7, seconds=1.5)
        with self.open() as connection:
            return outcomes.fail(
                connection,
                report,
                self.now,
                self.plan.budget,
                lambda planned: redraw(self.plan, self.catalog, planned),
            )

    def archive(self, lease: Lease) -> bool:
        """Records a pulled episode as archived, which is the last step of a puller."""
        with self.open() as connection:
            row = connection.execute(select(jobs).where(jobs.c.id == lease.job_id)).one()
            return outcomes.archive(connection, lease, summary_for(row), self.now)

    def rows(self, index: int | None = None) -> list[Any]:
        query = select(jobs).order_by(jobs.c.idx, jobs.c.draw)
        with self.open() as connection:
            return list(connection.execute(query if index is None else query.where(jobs.c.idx == index)).all())

    def row(self, job_id: int) -> Any:
        (found,) = [row for row in self.rows() if row.id == job_id]
        return found

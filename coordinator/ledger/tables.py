"""Defines the SQLAlchemy tables of the ledger. Executes no statement.

Times are seconds since 1970 in UTC. Every change of the tables, or of the meaning of their values, increases
`LEDGER_FORMAT`. Only the current format can be opened.
"""

from __future__ import annotations

from types import MappingProxyType

from sqlalchemy import BigInteger, Boolean, Column, Double, ForeignKey, Index, Integer, MetaData, String, Table, Text
from sqlalchemy import text as sql

LEDGER_FORMAT = 4
"""Format version."""

FORMER_FORMATS = MappingProxyType({1: "0.1.0", 2: "0.1.0", 3: "0.1.0"})
"""Mapping of older formats to the last version of minivla-factory that wrote them."""

PLANNED = "planned"
"""Key of `info` with the digest of the initial jobs."""

PLANNED_EPISODES = "episodes"
"""Key of `info` with the number of episodes, including those of layouts that are not built yet; absent in a ledger
that was created with all scenes."""

BUILD = "build"
"""Tier and split of a job that builds the package of a layout. Such jobs have larger numbers than the episodes."""

METADATA = MetaData()

# SQLite autoincrements only keys of type INTEGER.
_RowId = BigInteger().with_variant(Integer, "sqlite")

info = Table(
    "info",
    METADATA,
    Column("key", String(40), primary_key=True),
    Column("value", Text, nullable=False),
    comment="Format version, plan and run; written once.",
)

jobs = Table(
    "jobs",
    METADATA,
    Column("id", _RowId, primary_key=True, comment="job_id of a lease"),
    Column("idx", Integer, nullable=False, comment="episode of the plan, from 1"),
    Column("draw", Integer, nullable=False),
    Column("scene", String(64), nullable=False),
    Column("tier", String(16), nullable=False),
    Column("split", String(32), nullable=False),
    Column("category", String(64), nullable=False),
    Column("target_id", String(64), nullable=False),
    Column("colour", String(64), nullable=False),
    Column("template_id", String(64), nullable=False),
    Column("instruction", Text, nullable=False),
    Column("state", String(16), nullable=False),
    Column("superseded", Boolean, nullable=False, default=False, comment="a later draw of the episode exists"),
    # Design: docs/design/jobs.md#attempts-and-fences.
    Column("attempt", Integer, nullable=False, default=1, comment="attempt that is running, or that a claim starts"),
    Column("misses", Integer, nullable=False, default=0, comment="task failures of this draw"),
    Column("crashes", Integer, nullable=False, default=0, comment="worker failures"),
    Column(
        "losses", Integer, nullable=False, default=0, comment="consecutive expired leases; they delay the next claim"
    ),
    Column("fence", Integer, nullable=False, default=0, comment="increases with each claim"),
    Column("token", String(32), comment="token of the lease in force or fulfilled"),
    Column("sid", String(80), comment="worker of the lease"),
    Column("lease_until", Double),
    Column("not_before", Double, nullable=False, default=0.0),
    Column("step", Integer, nullable=False, default=0, comment="steps in the last heartbeat"),
    Column("sha256", String(64), comment="digest of the announced bundle"),
    Column("size", BigInteger, comment="size of the announced bundle, bytes"),
    Column("reason", Text, nullable=False, default="", comment="reason of the failure"),
    Column("changed_at", Double, nullable=False, default=0.0),
    Index("ux_jobs_draw", "idx", "draw", unique=True),
    Index("ix_jobs_queue", "state", "not_before", "id"),
)
Index(
    "ix_jobs_lease",
    jobs.c.lease_until,
    sqlite_where=sql("lease_until IS NOT NULL"),
    postgresql_where=sql("lease_until IS NOT NULL"),
)
Index(
    "ux_jobs_token",
    jobs.c.token,
    unique=True,
    sqlite_where=sql("token IS NOT NULL"),
    postgresql_where=sql("token IS NOT NULL"),
)

IS_EPISODE = jobs.c.tier != BUILD
"""Condition that a job produces an episode, not a layout."""

attempts = Table(
    "attempts",
    METADATA,
    Column("id", _RowId, primary_key=True),
    Column("job_id", _RowId, ForeignKey(jobs.c.id), nullable=False),
    Column("idx", Integer, nullable=False),
    Column("draw", Integer, nullable=False),
    Column("attempt", Integer, nullable=False),
    Column("fence", Integer, nullable=False),
    Column("outcome", String(16), nullable=False, comment="success, a fail reason, expired, cancelled or lost"),
    Column("settles", Boolean, nullable=False, comment="final outcome: success or task failure"),
    Column("detail", Text, nullable=False, default=""),
    Column("steps", Integer, nullable=False, default=0),
    Column("seconds", Double, nullable=False, default=0.0),
    Column("sid", String(80), nullable=False),
    Column("at", Double, nullable=False),
    Index("ix_attempts_job", "job_id", "fence"),
    Index("ix_attempts_outcome", "outcome"),
)
Index(
    "ux_attempts_settled",
    attempts.c.idx,
    attempts.c.attempt,
    unique=True,
    sqlite_where=sql("settles"),
    postgresql_where=sql("settles"),
)

events = Table(
    "events",
    METADATA,
    Column("id", _RowId, primary_key=True),
    Column("at", Double, nullable=False),
    Column("job_id", _RowId, nullable=False),
    Column("event", String(16), nullable=False),
    Column("state", String(16), nullable=False, comment="state after the event"),
    Column("attempt", Integer, nullable=False),
    Column("fence", Integer, nullable=False),
    Column("sid", String(80), nullable=False, default=""),
    Column("detail", Text, nullable=False, default=""),
    Index("ix_events_job", "job_id"),
)

episodes = Table(
    "episodes",
    METADATA,
    Column("idx", Integer, primary_key=True, autoincrement=False),
    Column("job_id", _RowId, ForeignKey(jobs.c.id), nullable=False),
    Column("attempt", Integer, nullable=False),
    Column("sha256", String(64), nullable=False),
    Column("size", BigInteger, nullable=False),
    Column("content_digest", String(32), nullable=False),
    Column("summary", Text, nullable=False, comment="EpisodeSummary as JSON"),
    Column("archived_at", Double, nullable=False),
    Index("ix_episodes_at", "archived_at"),
)

gateway_episodes = Table(
    "keepers",
    METADATA,
    Column("idx", Integer, primary_key=True, autoincrement=False),
    Column("gateway", String(80), nullable=False),
    comment="Archived episodes that a gateway stores; the coordinator stores the others.",
)

hosts = Table(
    "hosts",
    METADATA,
    Column("host", String(80), primary_key=True),
    Column("strikes", Integer, nullable=False, comment="failures attributed to the host, reduced by successes"),
    Column("last_job", _RowId, nullable=False, comment="job of the last strike"),
    Column("resumes_at", Double, nullable=False, comment="earliest time of the next job"),
    Column("barred_at", Double, comment="time of the bar, which lasts until an admin request releases the host"),
    Column("reason", Text, nullable=False, comment="last failure"),
    comment="Hosts with failed attempts; other hosts have no row.",
)

unchecked_episodes = Table(
    "unchecked_episodes",
    METADATA,
    Column("idx", Integer, primary_key=True, autoincrement=False),
    Column("host", String(80), nullable=False),
    Index("ix_unchecked_host", "host"),
    comment="Archived episodes whose frames only the worker has validated.",
)

workers = Table(
    "workers",
    METADATA,
    Column("sid", String(80), primary_key=True),
    Column("host", String(80), nullable=False),
    Column("slots", Integer, nullable=False),
    Column("version", String(40), nullable=False, default=""),
    Column("archived", Integer, nullable=False, default=0),
    Column("last_beat", Double, nullable=False),
    Index("ix_workers_host", "host", "last_beat"),
)

job_tallies = Table(
    "job_tallies",
    METADATA,
    Column("state", String(16), primary_key=True),
    Column("scene", String(64), primary_key=True),
    Column("tier", String(16), primary_key=True),
    Column("split", String(32), primary_key=True),
    Column("superseded", Boolean, primary_key=True),
    Column("jobs", Integer, nullable=False, comment="number of jobs"),
    comment="Number of jobs by state and cell; triggers update it.",
)

attempt_tallies = Table(
    "attempt_tallies",
    METADATA,
    Column("outcome", String(16), primary_key=True),
    Column("attempts", Integer, nullable=False, comment="number of attempts"),
    Column("steps", BigInteger, nullable=False, comment="sum of their steps"),
    comment="Number of attempts by outcome; triggers update it.",
)

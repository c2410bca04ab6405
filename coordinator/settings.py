"""Defines the operational settings of a coordinator: leases, transfers, free space and intervals."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from coordinator.defaults import CHECKPOINT_S, LEASE_TTL_S, MAX_PULLERS
from schemas.base import Model, NonNegative, Positive
from schemas.protocol.keys import MAX_CHUNK_BYTES
from schemas.storage.shards import MAX_SHARD_EPISODES


class CoordinatorSettings(Model):
    """Operational settings of a coordinator, which do not affect the contents of the dataset."""

    lease_ttl_s: Positive = LEASE_TTL_S
    """Duration of a lease without a heartbeat, seconds."""
    lease_limit_s: Positive = 7200.0
    """Longest time from claim to archived episode, seconds. The job of a worker that sends heartbeats without a result
    then returns to the queue. A bundle of 50 MB takes 7 minutes at `min_bytes_per_s`."""
    retry_after_s: Positive = 1.0
    """Pause of a worker before its next claim if no job is due, seconds."""
    sweep_s: Positive = 0.25
    """Pause between two checks for expired leases, seconds."""
    pullers: Annotated[int, Field(ge=1, le=MAX_PULLERS)] = 2
    """Number of threads that transfer and validate bundles, each with a validating process."""
    spot_checks: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    """Share of the bundles that is validated completely although their worker has validated them; `None`: workers
    validate nothing, and the coordinator validates all bundles."""
    chunk_bytes: Annotated[int, Field(ge=1024, le=MAX_CHUNK_BYTES)] = MAX_CHUNK_BYTES
    """Size of a requested chunk, bytes."""
    pull_timeout_s: Positive = 2.0
    """Timeout of a chunk request, seconds."""
    min_bytes_per_s: Positive = 128 << 10
    """Least transfer rate, bytes per second. A bundle that arrives more slowly is refused, and its job returns to the
    queue."""
    slow_start_s: NonNegative = 10.0
    """Time at the start of a transfer during which the least rate does not apply, seconds."""
    reserve_bytes: Annotated[int, Field(ge=0)] = 2 << 30
    """Free space below which no job is leased and no bundle is pulled, bytes."""
    checkpoint_s: Positive = CHECKPOINT_S
    """Interval of writing the dataset's tables, seconds."""
    shard_episodes: Annotated[int, Field(ge=1, le=MAX_SHARD_EPISODES)] = MAX_SHARD_EPISODES
    """Size of the range of episode numbers in a shard of states. A dataset of at most this size is not packed."""
    transport_lease_s: Positive = 5.0
    """Time without traffic after which zenoh closes a link, seconds."""
    admission_s: Positive = 2.0
    """Interval of reading the admission list with TLS, seconds."""
    ledger_outage_s: Positive = 300.0
    """Longest time for which the server of the ledger may not answer, seconds; a longer outage ends the coordinator."""
    backlog: Annotated[int, Field(ge=1)] = 20_000
    """Maximum number of waiting requests; further requests get no reply and are repeated by the client."""

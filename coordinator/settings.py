"""The coordinator's own numbers: how long leases last, how it pulls, when it stops for want of space."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from schemas.base import Model, NonNegative, Positive
from schemas.keys import MAX_CHUNK_BYTES

__all__ = ["CoordinatorSettings"]


class CoordinatorSettings(Model):
    """Everything that may differ between two coordinators without changing a byte of the dataset."""

    lease_ttl_s: Positive = 15.0
    """How long a job stays with a silent worker."""
    lease_limit_s: Positive = 7200.0
    """Longest time from claim to archived episode. The job of a worker that beats and brings nothing then goes to
    others. A bundle of 50 MB takes 7 minutes at `min_bytes_per_s`."""
    retry_after_s: Positive = 1.0
    """How long a worker waits when nothing is due."""
    sweep_s: Positive = 0.25
    """Pause between two looks for expired leases."""
    pullers: Annotated[int, Field(ge=1, le=16)] = 2
    chunk_bytes: Annotated[int, Field(ge=1024, le=MAX_CHUNK_BYTES)] = MAX_CHUNK_BYTES
    """Bytes asked of a worker at a time."""
    pull_timeout_s: Positive = 2.0
    """How long a worker may take to answer for one chunk."""
    min_bytes_per_s: Positive = 128 << 10
    """Rate at which a worker has to serve a bundle; a slower one is refused, and the job goes to others."""
    slow_start_s: NonNegative = 10.0
    """How long a transfer may take before it has to keep that rate."""
    reserve_bytes: Annotated[int, Field(ge=0)] = 2 << 30
    """Free space below which no job is given out and no bundle pulled."""
    checkpoint_s: Positive = 30.0
    """Pause between two writings of the dataset's tables."""
    transport_lease_s: Positive = 5.0
    """Silence after which zenoh closes a link."""
    admission_s: Positive = 2.0
    """Pause between two looks at who is admitted, with TLS."""
    backlog: Annotated[int, Field(ge=1)] = 20_000
    """Requests that may wait; further ones get no answer and are asked again."""

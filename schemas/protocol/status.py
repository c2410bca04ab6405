"""Models of the state of a run, its workers and its hosts, computed from the ledger."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from pydantic import Field

from schemas.base import Count, Line, Model, NonNegative, Text
from schemas.terms import FailReason

_MAX_SESSIONS = 100_000
_MAX_GROUPS = 1000


class WorkerStatus(Model):
    """State of a worker in the ledger."""

    sid: Line
    """Session id of the worker."""
    host: Line
    """Name of its host."""
    slots: Count
    """Number of simulations that it runs at a time."""
    leased: Count
    """Number of jobs that it holds."""
    archived: Count
    """Number of archived episodes that it has made."""
    last_beat: datetime
    """Time of its last heartbeat, UTC."""
    alive: bool
    """Whether its last heartbeat is younger than the lease time."""


class HostStatus(Model):
    """State in the ledger of a host whose attempts were refused or crashed."""

    host: Line
    """Name of the host."""
    strikes: Count
    """Number of failures attributed to the host; each episode that it delivers halves the number."""
    resumes_at: datetime
    """Time until which it gets no job, UTC."""
    barred_at: datetime | None
    """Time since which it gets no job until an operator releases it, UTC; `None` if it is not barred."""
    reason: Text
    """Last failure that was attributed to the host."""


Counts = Annotated[dict[Line, Count], Field(max_length=_MAX_GROUPS)]
Groups = Annotated[dict[Line, Counts], Field(max_length=_MAX_GROUPS)]


class Progress(Model):
    """Progress of a run, computed from the ledger."""

    run: Line
    """Name of the run."""
    planned: Count
    """Number of episodes in the plan."""
    jobs: Counts
    """Number of episodes by the state of their current draw (`pending` in unbuilt layouts); the sum is `planned`."""
    by_scene: Groups
    """Number of episodes by scene or family and state, without unbuilt layouts."""
    by_tier: Groups
    """Number of episodes by tier and state, without unbuilt layouts."""
    by_split: Groups
    """Number of episodes by split and state, without unbuilt layouts."""
    redrawn: Count
    """Number of draws that were replaced after too many failed attempts."""
    attempts: Counts
    """Number of attempts by outcome: `success` or the fail reason."""
    workers: Annotated[tuple[WorkerStatus, ...], Field(max_length=_MAX_SESSIONS)]
    """Workers of the run."""
    hosts: Annotated[tuple[HostStatus, ...], Field(max_length=_MAX_SESSIONS)] = ()
    """Hosts that are paused or barred."""
    by_gateway: Counts = Field(default_factory=dict)
    """Number of archived episodes that each gateway stores, by its name; the coordinator stores all others."""
    layouts: Counts = Field(default_factory=dict)
    """Number of layouts that workers build, by state; empty if all scenes existed when the run started."""
    shards: Count = 0
    """Number of shards of the dataset; 0 if no episode is packed."""
    episodes_per_hour: NonNegative | None
    """Rate of archived episodes since the coordinator started, over at most ten minutes, 1/h; `None` until it can
    be known, and while no worker is alive."""
    eta_s: NonNegative | None
    """Time to the end at the rate of the last two minutes, seconds; `None` if unknown, 0 if finished."""
    stopped_at: datetime | None = None
    """Last recorded activity of an unfinished run without a coordinator, UTC; `None` if one runs, or if that cannot be
    known."""
    finished: bool
    """Whether no job can change its state without a `retry`."""
    paused: bool = False
    """Whether no job is leased until an operator resumes the run."""
    versions: Annotated[tuple[Line, ...], Field(max_length=_MAX_GROUPS)] = ()
    """Versions of minivla-factory that have run the coordinator, oldest first; empty in a ledger that records none."""
    sandbox: Annotated[tuple[Line, ...], Field(max_length=_MAX_GROUPS)] = ()
    """Sandbox mechanisms of the coordinator's validation processes, e.g. `seccomp`; empty before the first bundle."""

    @property
    def missing(self) -> int:
        """Number of planned episodes that are not archived."""
        return self.planned - self.jobs.get("archived", 0)

    @property
    def built_layouts(self) -> str:
        """Numbers of built layouts and of all layouts as text, e.g. `3 of 8 layouts built`; empty without layouts."""
        built, total = self.layouts.get("archived", 0), sum(self.layouts.values())
        return f"{built} of {total} layouts built" if total else ""

    @property
    def failures(self) -> dict[str, int]:
        """Number of failed attempts by reason; a job that its worker returned without a failure is not counted."""
        return {name: count for name, count in self.attempts.items() if name not in {"success", FailReason.RELEASED}}

    @property
    def given_back(self) -> int:
        """Number of interrupted attempts, e.g. by Ctrl-C; their jobs are pending again with an unchanged budget."""
        return self.attempts.get(FailReason.RELEASED, 0)

"""Messages of an operator to the coordinator: retry, cancel, drain, release, pause and resume."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import FailFast, Field

from schemas.base import Count, Line, Model, Ordinal
from schemas.plan import MAX_EPISODES
from schemas.protocol.messages import HostName

MAX_INDICES = 100_000
"""Largest number of episodes in one admin request."""
MAX_HOSTS = 10_000
"""Largest number of hosts in one admin request."""

Hosts = Annotated[tuple[HostName, ...], Field(max_length=MAX_HOSTS), FailFast()]


class AdminAction(StrEnum):
    """Action of an operator on a run."""

    RETRY = "retry"  # returns failed or cancelled episodes to the queue
    CANCEL = "cancel"  # cancels episodes that have not ended
    DRAIN = "drain"  # lets every worker finish its current jobs and exit
    RELEASE = "release"  # assigns jobs to barred hosts again
    PAUSE = "pause"  # leases no further job until `resume`; running jobs continue
    RESUME = "resume"  # leases jobs again


class AdminRequest(Model):
    """Request of an operator; a repetition has no further effect."""

    action: AdminAction
    """Action to execute."""
    indices: Annotated[tuple[Ordinal, ...], Field(max_length=MAX_INDICES), FailFast()] = ()
    """Episodes to change, by number; empty selects all episodes that the action applies to."""
    hosts: Hosts = ()
    """Hosts to change; empty selects all hosts that the action applies to."""


class AdminReply(Model):
    """Result of an admin request."""

    changed: Annotated[tuple[Count, ...], Field(max_length=MAX_EPISODES)]
    """Episodes that changed their state."""
    refused: Annotated[dict[Count, Line], Field(max_length=MAX_INDICES)] = Field(default_factory=dict)
    """Requested episodes that the action does not apply to, with the reason."""
    hosts: Hosts = ()
    """Hosts that changed their state."""
    refused_hosts: Annotated[dict[HostName, Line], Field(max_length=MAX_HOSTS)] = Field(default_factory=dict)
    """Requested hosts that the action does not apply to, with the reason."""

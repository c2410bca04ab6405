"""Defines the state machine of a job: states, events and the table of transitions.

The module uses no database and no clock. `diagram` generates the diagram in ARCHITECTURE.md.
"""

from __future__ import annotations

import sys
from enum import StrEnum
from types import MappingProxyType

from schemas.errors import FactoryError


class JobState(StrEnum):
    """State of one draw of one episode."""

    PENDING = "pending"  # in the queue
    LEASED = "leased"  # a worker simulates it under a lease
    SUBMITTED = "submitted"  # the bundle is in a worker's spool, announced and not archived
    ARCHIVED = "archived"  # the episode is validated, stored and recorded
    FAILED = "failed"  # the budget of the draw is used, or the job is quarantined
    CANCELLED = "cancelled"  # cancelled by an admin request


class Event(StrEnum):
    """Event of a job; recorded in the table `events` in the transaction that changes the job."""

    CLAIMED = "claimed"  # a worker claimed it under a new fence
    ANNOUNCED = "announced"  # its worker announced that the bundle can be pulled
    ARCHIVED = "archived"  # the bundle was validated and published
    ADOPTED = "adopted"  # found at the start: the bundle was published, but the ledger had not committed the episode
    TASK_FAILED = "task_failed"  # task failure; the next attempt follows
    EXHAUSTED = "exhausted"  # task failure that uses up the attempts of this draw, or a layout that is refused
    RELEASED = "released"  # its worker returned it without an outcome
    EXPIRED = "expired"  # the lease expired without a heartbeat
    WORKER_FAILED = "worker_failed"  # worker failure: crash, hang or invalid bundle
    QUARANTINED = "quarantined"  # worker failure that exceeds the crash budget
    LOST = "lost"  # the archived file is missing or damaged
    RETRIED = "retried"  # retried by an admin request
    CANCELLED = "cancelled"  # cancelled by an admin request


class InvalidTransition(FactoryError):
    """Event that is not allowed in the current state of the job."""


_HELD = (JobState.LEASED, JobState.SUBMITTED)

TRANSITIONS = MappingProxyType(
    {
        (JobState.PENDING, Event.CLAIMED): JobState.LEASED,
        (JobState.PENDING, Event.CANCELLED): JobState.CANCELLED,
        (JobState.LEASED, Event.ANNOUNCED): JobState.SUBMITTED,
        (JobState.LEASED, Event.TASK_FAILED): JobState.PENDING,
        **{(held, Event.EXHAUSTED): JobState.FAILED for held in _HELD},
        **{(held, Event.RELEASED): JobState.PENDING for held in _HELD},
        **{(held, Event.EXPIRED): JobState.PENDING for held in _HELD},
        **{(held, Event.WORKER_FAILED): JobState.PENDING for held in _HELD},
        **{(held, Event.QUARANTINED): JobState.FAILED for held in _HELD},
        **{(held, Event.CANCELLED): JobState.CANCELLED for held in _HELD},
        (JobState.SUBMITTED, Event.ANNOUNCED): JobState.SUBMITTED,
        (JobState.SUBMITTED, Event.ARCHIVED): JobState.ARCHIVED,
        (JobState.SUBMITTED, Event.ADOPTED): JobState.ARCHIVED,
        (JobState.ARCHIVED, Event.LOST): JobState.PENDING,
        (JobState.FAILED, Event.RETRIED): JobState.PENDING,
        (JobState.CANCELLED, Event.RETRIED): JobState.PENDING,
    }
)
"""Mapping of (state, event) to the next state. Other pairs are not allowed. All transitions of an event have the same
next state."""

OPEN_STATES = (JobState.PENDING, JobState.LEASED, JobState.SUBMITTED)
"""States that can change without an admin request."""


def next_state(state: JobState, event: Event) -> JobState:
    """Returns the state after an event.

    Raises:
        InvalidTransition: the event is not allowed in the state.
    """
    try:
        return TRANSITIONS[state, event]
    except KeyError:
        fitting = ", ".join(sources(event))
        raise InvalidTransition(
            f"a job that is {state} cannot be {event}; it must be in one of the states: {fitting}"
        ) from None


def sources(event: Event) -> tuple[JobState, ...]:
    """Returns the states in which an event is allowed."""
    return tuple(state for (state, listed) in TRANSITIONS if listed is event)


def target(event: Event) -> JobState:
    """Returns the state after an event, which is the same for all its source states."""
    (state,) = {after for (_, listed), after in TRANSITIONS.items() if listed is event}
    return state


def diagram() -> str:
    """Returns the table of transitions as a Mermaid state diagram."""
    moves: dict[tuple[JobState, JobState], list[Event]] = {}
    for (before, event), after in TRANSITIONS.items():
        moves.setdefault((before, after), []).append(event)
    lines = [f"    {before} --> {after}: {', '.join(events)}" for (before, after), events in moves.items()]
    return "\n".join(["stateDiagram-v2", f"    [*] --> {JobState.PENDING}", *lines])


if __name__ == "__main__":
    sys.stdout.write(diagram() + "\n")

"""All about the life of a job: its states, what can happen to it, and the one table that says where that leads.

Knows no database and no clock; the ledger asks it, and the diagram in ARCHITECTURE.md is printed from it.
"""

from __future__ import annotations

import sys
from enum import StrEnum
from types import MappingProxyType

from schemas.errors import FactoryError

__all__ = [
    "OPEN_STATES",
    "TRANSITIONS",
    "Event",
    "IllegalMove",
    "JobState",
    "diagram",
    "next_state",
    "sources",
    "target",
]


class JobState(StrEnum):
    """Where one draw of one episode stands."""

    PENDING = "pending"  # waits for a worker
    LEASED = "leased"  # a worker simulates it, as long as its lease lasts
    SUBMITTED = "submitted"  # the bundle is in a worker's spool, announced but not archived
    ARCHIVED = "archived"  # the episode is validated, on disk and recorded
    FAILED = "failed"  # given up: the budget of the draw is used, or it kills workers
    CANCELLED = "cancelled"  # given up by an operator


class Event(StrEnum):
    """What can happen to a job; each is written to the ledger's log in the transaction that moves the job."""

    CLAIMED = "claimed"  # a worker took it under a new fence
    ANNOUNCED = "announced"  # its worker says that the bundle can be pulled
    ARCHIVED = "archived"  # the bundle was validated and published
    ADOPTED = "adopted"  # found published at start, although the commit was lost
    MISSED = "missed"  # the world said no; the next attempt follows
    EXHAUSTED = "exhausted"  # the world said no for the last time in this draw
    RELEASED = "released"  # its worker gave it back unharmed
    EXPIRED = "expired"  # nothing was heard of its worker for a whole lease
    HURT = "hurt"  # it crashed, hung, or brought an invalid bundle
    QUARANTINED = "quarantined"  # it did so too often
    LOST = "lost"  # the archived file is gone or damaged
    RETRIED = "retried"  # an operator wants it once more
    CANCELLED = "cancelled"  # an operator gave it up


class IllegalMove(FactoryError):
    """An event that the state does not know: the caller's picture of the job is wrong."""


_HELD = (JobState.LEASED, JobState.SUBMITTED)

TRANSITIONS = MappingProxyType(
    {
        (JobState.PENDING, Event.CLAIMED): JobState.LEASED,
        (JobState.PENDING, Event.CANCELLED): JobState.CANCELLED,
        (JobState.LEASED, Event.ANNOUNCED): JobState.SUBMITTED,
        (JobState.LEASED, Event.MISSED): JobState.PENDING,
        (JobState.LEASED, Event.EXHAUSTED): JobState.FAILED,
        **{(held, Event.RELEASED): JobState.PENDING for held in _HELD},
        **{(held, Event.EXPIRED): JobState.PENDING for held in _HELD},
        **{(held, Event.HURT): JobState.PENDING for held in _HELD},
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
"""(state, event) -> state. What is not listed does not happen. An event leads to one state from wherever it starts."""

OPEN_STATES = (JobState.PENDING, JobState.LEASED, JobState.SUBMITTED)
"""States that change without an operator."""


def next_state(state: JobState, event: Event) -> JobState:
    """Returns where the event leads.

    Raises:
        IllegalMove: the table does not list the pair.
    """
    try:
        return TRANSITIONS[state, event]
    except KeyError:
        fitting = ", ".join(sources(event))
        raise IllegalMove(f"a job that is {state} cannot be {event}; only from: {fitting}") from None


def sources(event: Event) -> tuple[JobState, ...]:
    """Returns the states in which an event can find a job."""
    return tuple(state for (state, listed) in TRANSITIONS if listed is event)


def target(event: Event) -> JobState:
    """Returns the one state that an event leads to."""
    (state,) = {after for (_, listed), after in TRANSITIONS.items() if listed is event}
    return state


def diagram() -> str:
    """Returns the table as a mermaid state diagram."""
    moves: dict[tuple[JobState, JobState], list[Event]] = {}
    for (before, event), after in TRANSITIONS.items():
        moves.setdefault((before, after), []).append(event)
    lines = [f"    {before} --> {after}: {', '.join(events)}" for (before, after), events in moves.items()]
    return "\n".join(["stateDiagram-v2", f"    [*] --> {JobState.PENDING}", *lines])


if __name__ == "__main__":
    sys.stdout.write(diagram() + "\n")

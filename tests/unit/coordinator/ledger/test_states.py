"""The table of job states: complete, single-valued, and the source of the diagram."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from coordinator.ledger.states import (
    OPEN_STATES,
    TRANSITIONS,
    Event,
    InvalidTransition,
    JobState,
    diagram,
    next_state,
    sources,
    target,
)

ARCHITECTURE = Path(__file__).parents[4] / "ARCHITECTURE.md"


@pytest.mark.parametrize("event", Event)
def test_every_event_has_a_source_and_leads_to_one_state(event):
    assert sources(event)
    assert all(next_state(state, event) is target(event) for state in sources(event))


@pytest.mark.parametrize(("state", "event"), sorted(set(itertools.product(JobState, Event)) - set(TRANSITIONS)))
def test_an_unlisted_pair_of_state_and_event_raises_an_error_that_names_both(state, event):
    with pytest.raises(InvalidTransition, match=f"a job that is {state} cannot be {event}"):
        next_state(state, event)


def test_every_state_can_be_reached_from_the_first():
    reached = {JobState.PENDING}
    for _ in JobState:
        reached |= {after for (before, _), after in TRANSITIONS.items() if before in reached}
    assert reached == set(JobState)


def test_only_an_operator_or_a_lost_file_reopens_a_finished_job():
    waking = {event for (before, event) in TRANSITIONS if before not in OPEN_STATES}
    assert waking == {Event.RETRIED, Event.LOST}


def test_the_diagram_draws_every_transition():
    text = diagram()
    assert text.startswith("stateDiagram-v2\n")
    for (before, event), after in TRANSITIONS.items():
        assert any(line.strip().startswith(f"{before} --> {after}:") and event in line for line in text.splitlines())


@pytest.mark.skipif(not ARCHITECTURE.exists(), reason="no ARCHITECTURE.md in this checkout")
def test_the_printed_diagram_is_the_one_in_the_architecture_document():
    assert diagram() in ARCHITECTURE.read_text()

"""Shows the progress of the shards of a run, read from their state files. Opens no ledger."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rich.console import Group
from rich.text import Text

from factory.commands.common.output import FittedTable
from schemas.dataset.run_shard import ShardState
from schemas.storage.place import Place

_LISTED = 50
_WITHOUT_FAILURE = frozenset({"success", "released"})
Shards = Sequence[tuple[Place, ShardState]]


def shards_as_json(shards: Shards) -> dict[str, Any]:
    """Returns the state of each shard and the sums as JSON data."""
    states = [{"place": str(place), **state.model_dump(mode="json")} for place, state in shards]
    return {"shards": states, **_sums([state for _, state in shards])}


def draw_shards(shards: Shards) -> Group:
    """Returns the state of each shard as a table; unfinished shards come first."""
    states = [state for _, state in shards]
    found, count = _sums(states), max(state.shard.count for state in states)
    rows = [
        _row(place, state) for place, state in sorted(shards, key=lambda one: (one[1].finished, one[1].shard.number))
    ]
    head = f"{states[0].run}: {found['archived']} of {found['planned']} episodes archived, "
    head += f"{found['finished_shards']} of {count} shards finished"
    columns = ("shard", "archived", "planned", "failed", "failed attempts", "state", "place")
    notes = [
        Text(note)
        for note in _notes(len(rows), sorted(set(range(1, count + 1)) - {one.shard.number for one in states}))
    ]
    return Group(Text(head, style="bold"), FittedTable("", columns, rows[:_LISTED]), *notes)


def _notes(rows: int, absent: Sequence[int]) -> Iterator[str]:
    if rows > _LISTED:
        yield f"{rows - _LISTED} more shards are not listed; --json lists all"
    if absent:
        yield f"not started: {', '.join(map(str, absent[:_LISTED]))}{', ...' if len(absent) > _LISTED else ''}"


def _sums(states: Sequence[ShardState]) -> dict[str, int]:
    return {
        "planned": sum(state.planned for state in states),
        "archived": sum(state.jobs.get("archived", 0) for state in states),
        "failed": sum(state.jobs.get("failed", 0) for state in states),
        "failed_attempts": sum(map(_failed_attempts, states)),
        "finished_shards": sum(state.finished for state in states),
    }


def _failed_attempts(state: ShardState) -> int:
    return sum(count for outcome, count in state.attempts.items() if outcome not in _WITHOUT_FAILURE)


def _row(place: Place, state: ShardState) -> tuple[str | int, ...]:
    is_at = "finished" if state.finished else f"unfinished at {state.updated_at:%Y-%m-%d %H:%M:%S} UTC on {state.host}"
    jobs = state.jobs
    counts = jobs.get("archived", 0), state.planned, jobs.get("failed", 0), _failed_attempts(state)
    return str(state.shard), *counts, is_at, place.name

"""Shows the progress of a run, from its ledger or its coordinator, and of its shards, from their state files.

Opens neither.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from rich.console import Group
from rich.live import Live
from rich.text import Text

from coordinator.validation.sandbox import SECCOMP
from factory.support.terminal import FittedTable, stdout
from factory.support.text import format_duration
from schemas.dataset.run_shard import ShardState
from schemas.errors import TransientError
from schemas.protocol.status import HostStatus, Progress, WorkerStatus
from schemas.storage.place import Place
from schemas.terms import BUILTIN_CATEGORIES

_PAUSE_S = 1.0
_PATIENCE_S = 60.0
"""Time without an answer after which `--watch` gives up, seconds; a restart of a coordinator takes a few seconds."""
_FIRST = max(map(len, BUILTIN_CATEGORIES))
"""Minimum width of the first column of each table, characters. It aligns the numbers of all tables."""
_REASON_CHARS = 200
_COLUMNS = ("pending", "leased", "submitted", "archived", "failed", "cancelled")
_ALWAYS = ("pending", "leased", "archived")
"""States whose columns are always shown; the columns of other states are shown if a job has the state."""
_LISTED = 50
_WITHOUT_FAILURE = frozenset({"success", "released"})
Shards = Sequence[tuple[Place, ShardState]]


def watch_progress(source: Callable[[], Progress], pause_s: float = _PAUSE_S, patience_s: float = _PATIENCE_S) -> None:
    """Shows the progress of a run until it has finished; tolerates a restart of its coordinator.

    Args:
        source: returns the progress; raises `TransientError` if the coordinator does not answer.
        pause_s: time between two requests, seconds.
        patience_s: time without an answer after which the error is raised, seconds.
    """
    progress = source()
    answered_at = time.monotonic()
    with Live(draw_progress(progress), console=stdout, auto_refresh=False) as live:
        while not progress.finished:
            time.sleep(pause_s)
            try:
                progress = source()
            except TransientError:
                silence_s = time.monotonic() - answered_at
                if silence_s > patience_s:
                    raise
                remark = Text(f"no answer for {format_duration(silence_s)}; retrying", style="yellow")
                live.update(Group(draw_progress(progress), remark), refresh=True)
            else:
                answered_at = time.monotonic()
                live.update(draw_progress(progress), refresh=True)


def draw_progress(progress: Progress) -> Group:
    """Returns the progress of a run as text and tables."""
    done = progress.jobs.get("archived", 0)
    rate = "-" if progress.episodes_per_hour is None else f"{progress.episodes_per_hour:.0f}/h"
    left = "finished" if progress.finished else f"ETA {format_duration(progress.eta_s)}"
    pace = "" if progress.stopped_at is not None else f", {rate}, {left}"
    head = f"{progress.run}: {done} of {progress.planned} episodes archived{pace}"
    tries = ", ".join(f"{count} {name}" for name, count in progress.failures.items()) or "none"
    is_waiting = progress.paused and not progress.finished
    paused = [Text("paused; continue with `factory jobs resume DIR`", style="yellow")] if is_waiting else []
    back = f"; returned jobs: {progress.given_back}" if progress.given_back else ""
    packed = [Text(f"shards of packed episodes: {progress.shards}")] if progress.shards else []
    layouts = [Text(progress.built_layouts)] if progress.layouts else []
    foot = f"failed attempts: {tries}{back}; redrawn targets: {progress.redrawn}"
    kept = ", ".join(f"{count} at {gateway}" for gateway, count in progress.by_gateway.items())
    away = [Text(f"stored at gateways: {kept}; copy them into one dataset with `factory gather`")] if kept else []
    groups = {"scene": progress.by_scene, "tier": progress.by_tier, "split": progress.by_split}
    states = [state for state in _COLUMNS if state in _ALWAYS or progress.jobs.get(state)]
    tables = [_group_table(name, rows, states) for name, rows in groups.items()]
    hosts = map(_describe_host, progress.hosts)
    sandbox = _describe_sandbox(progress.sandbox)
    mixed = [Text(f"made by {' and then '.join(progress.versions)}", style="yellow")] if progress.versions[1:] else []
    stopped = [Text(why_stopped(progress), style="yellow")] if progress.stopped_at is not None else []
    top = (Text(head, style="bold"), *stopped, *paused, *mixed, *layouts, *away, *packed)
    return Group(*top, *tables, _workers(progress), *hosts, *sandbox, Text(foot))


def why_stopped(progress: Progress) -> str:
    """Returns the sentence about a run without a coordinator; empty if one runs."""
    if progress.stopped_at is None:
        return ""
    since = f"{progress.stopped_at:%Y-%m-%d %H:%M:%S} UTC"
    return f"No coordinator is running since {since}; continue with the command that started the run"


def _describe_sandbox(layers: tuple[str, ...]) -> list[Text]:
    """Returns the sandbox layers of the validating processes, and a remedy if seccomp is missing."""
    if not layers or SECCOMP in layers:
        return [Text(f"validator sandbox: {', '.join(layers)}")] if layers else []
    remedy = "install the extra `sandbox` and the system's libseccomp2 to add seccomp"
    return [Text(f"validator sandbox: {', '.join(layers)} only; {remedy}", style="yellow")]


def _describe_host(host: HostStatus) -> Text:
    """Returns why a host is barred or limited to one job at a time; for a barred host, also what to do."""
    why = f"{host.strikes} failures, last: {' '.join(host.reason[:_REASON_CHARS].split())}"
    if host.barred_at is None:
        return Text(f"host {host.host} is limited to one job at a time, with pauses: {why}", style="yellow")
    since = f"{host.barred_at:%H:%M:%S}"
    remedy = f"repair the host, then run `factory jobs release DIR {host.host}`"
    return Text(f"host {host.host} is barred since {since}: {why}; {remedy}", style="bold red")


def _group_table(name: str, rows: dict[str, dict[str, int]], states: list[str]) -> FittedTable:
    body = [(key, *(counts.get(state, 0) for state in states)) for key, counts in rows.items()]
    return FittedTable("", (name, *states), body, _FIRST)


def _workers(progress: Progress) -> FittedTable:
    barred = {host.host for host in progress.hosts if host.barred_at is not None and not progress.finished}
    body = [
        (w.sid, w.slots, w.leased, w.archived, "barred" if w.host in barred else _state_of(w, progress.finished))
        for w in progress.workers
    ]
    return FittedTable("", ("worker", "slots", "leased", "archived", "state"), body, _FIRST)


def _state_of(worker: WorkerStatus, is_finished: bool) -> str:
    """Returns the displayed state of a worker; workers of a finished run are shown as `left`."""
    if is_finished:
        return "left"
    return "alive" if worker.alive else f"silent since {worker.last_beat:%H:%M:%S}"


def shards_as_json(shards: Shards) -> dict[str, Any]:
    """Returns the state of each shard and the sums as JSON data."""
    states = [{"place": str(place), **state.model_dump(mode="json")} for place, state in shards]
    return {"shards": states, **_sums([state for _, state in shards])}


def draw_shards(shards: Shards) -> Group:
    """Returns the state of each shard as a table; unfinished shards come first."""
    states = [state for _, state in shards]
    sums, count = _sums(states), max(state.shard.count for state in states)
    rows = [
        _shard_row(place, state)
        for place, state in sorted(shards, key=lambda one: (one[1].finished, one[1].shard.number))
    ]
    head = f"{states[0].run}: {sums['archived']} of {sums['planned']} episodes archived, "
    head += f"{sums['finished_shards']} of {count} shards finished"
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


def _shard_row(place: Place, state: ShardState) -> tuple[str | int, ...]:
    is_at = "finished" if state.finished else f"unfinished at {state.updated_at:%Y-%m-%d %H:%M:%S} UTC on {state.host}"
    jobs = state.jobs
    counts = jobs.get("archived", 0), state.planned, jobs.get("failed", 0), _failed_attempts(state)
    return str(state.shard), *counts, is_at, place.name

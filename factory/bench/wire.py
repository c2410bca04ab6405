"""What a coordinator bears over the network: cycles, sessions, many bundles at once. Conducts processes on loopback."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from coordinator.expansion.catalog import Catalog
from factory.bench.fleet import (
    Effort,
    bundle_of,
    claim_and_announce,
    claim_until_told,
    deliver_together,
    stay_connected,
)
from factory.bench.hub import Condition, Opened, serve_hub
from factory.bench.model import Crowd, Rush, Spread, WireBench
from schemas.episode import EpisodeMeta
from schemas.errors import WorldError
from schemas.plan import Plan

__all__ = ["bench_wire"]

_CYCLES = 5000
"""Of one run, all workers together; fewer on a small ledger, for each takes a job."""
_CYCLE_BUNDLE_BYTES = 1 << 20
"""Pulled beside the cycles: one chunk."""
_MEMBERS_A_PROCESS = 500
_BYSTANDER_PAUSE_S = 0.02
_PATIENCE_S = 600.0
_SPAWN = multiprocessing.get_context("spawn")


def bench_wire(
    plan: Plan,
    catalog: Catalog,
    meta: EpisodeMeta,
    root: Path,
    *,
    workers: int,
    sessions: int,
    bundle_bytes: int,
    repeats: int,
) -> WireBench:
    """Starts a coordinator on a filled ledger, works on it over zenoh, and returns the figures.

    Args:
        plan: what the ledger in `root` holds, with jobs enough for every claim made here.
        catalog: its scenes.
        meta: of a real episode, that all bundles are taken for.
        root: of the ledger.
        workers: that ask at the same time, and finish at the same moment.
        sessions: of the crowd.
        bundle_bytes: of each bundle in the rush.
        repeats: of the cycles and of the start.

    Raises:
        WorldError: one of the processes ended early.
    """
    rounds = max(1, min(_CYCLES, plan.episodes // (4 * repeats)) // workers)
    light = (root, plan, catalog, meta, *_named(_CYCLE_BUNDLE_BYTES))
    runs = [_cycles(light, plan.run, workers, rounds) for _ in range(repeats)]
    heavy = (root, plan, catalog, meta, *_named(bundle_bytes))
    return WireBench(
        cycles_per_s=Spread.of([run.cycles / run.fleet.seconds for run in runs]),
        archived_per_s=Spread.of([run.archived / run.fleet.seconds for run in runs]),
        coordinator_cpu_ms=Spread.of([1000 * run.coordinator_cpu_s / run.cycles for run in runs]),
        workers_cpu_ms=Spread.of([1000 * run.fleet.cpu_s / run.cycles for run in runs]),
        start_s=Spread.of([run.start_s for run in runs]),
        crowd=_crowd(heavy, plan.run, sessions),
        rush=_rush(heavy, plan.run, workers, bundle_bytes),
    )


class _Run(NamedTuple):
    """Cycles on a coordinator that was started for them."""

    cycles: int
    start_s: float
    fleet: Effort
    coordinator_cpu_s: float
    archived: int
    """Bundles of theirs that were archived before the last cycle was answered."""


def _named(size: int) -> tuple[str, int]:
    return sha256(bundle_of(size)).hexdigest(), size


def _cycles(facts: tuple[Any, ...], run: str, workers: int, rounds: int) -> _Run:
    episodes: Path = facts[0] / "episodes"
    with _process(serve_hub, *facts) as hub:
        opened: Opened = _hear(hub)
        with _process(claim_and_announce, opened.endpoints, run, workers, rounds, _CYCLE_BUNDLE_BYTES) as fleet:
            _hear(fleet)
            before, there = _condition(hub), len(list(episodes.iterdir()))
            fleet.send("go")
            effort: Effort = _hear(fleet)
            archived, after = len(list(episodes.iterdir())) - there, _condition(hub)
            return _Run(rounds * workers, opened.seconds, effort, after.cpu_s - before.cpu_s, archived)


def _crowd(facts: tuple[Any, ...], run: str, sessions: int) -> Crowd:
    with _process(serve_hub, *facts) as hub:
        opened: Opened = _hear(hub)
        shares = [min(_MEMBERS_A_PROCESS, sessions - start) for start in range(0, sessions, _MEMBERS_A_PROCESS)]
        with _processes(stay_connected, [(opened.endpoints, run, share) for share in shares]) as fleets:
            connected = sum(_hear(fleet) for fleet in fleets)
            return Crowd(sessions=connected, memory=_condition(hub).memory)


def _rush(facts: tuple[Any, ...], run: str, workers: int, bundle_bytes: int) -> Rush:
    with _process(serve_hub, *facts) as hub:
        opened: Opened = _hear(hub)
        with (
            _process(deliver_together, opened.endpoints, run, workers, bundle_bytes) as fleet,
            _process(claim_until_told, opened.endpoints, run, _BYSTANDER_PAUSE_S) as bystander,
        ):
            _hear(fleet)
            _hear(bystander)
            fleet.send("go")
            seconds = _hear(fleet)
            bystander.send("stop")
            waits_ms = 1000 * np.array(_hear(bystander))
            return Rush(
                workers=workers,
                bundle_mb=bundle_bytes / 1e6,
                seconds=seconds,
                mb_per_s=workers * bundle_bytes / 1e6 / seconds,
                claims=len(waits_ms),
                claim_p50_ms=float(np.percentile(waits_ms, 50)),
                claim_p99_ms=float(np.percentile(waits_ms, 99)),
                memory=_condition(hub).memory,
            )


def _condition(hub: Connection) -> Condition:
    hub.send("how do you do")
    condition: Condition = _hear(hub)
    return condition


def _hear(pipe: Connection) -> Any:
    try:
        if pipe.poll(_PATIENCE_S):
            return pipe.recv()
    except EOFError as error:
        raise WorldError("a process of the benchmark ended early; see its error above") from error
    raise WorldError(f"a process of the benchmark did not answer for {_PATIENCE_S:.0f} s")


@contextmanager
def _processes(target: Callable[..., None], errands: list[tuple[Any, ...]]) -> Iterator[list[Connection]]:
    pipes, processes = [], []
    try:
        for errand in errands:
            ours, theirs = _SPAWN.Pipe()
            process = _SPAWN.Process(target=target, args=(theirs, *errand), daemon=True)
            process.start()
            theirs.close()
            pipes.append(ours)
            processes.append(process)
        yield pipes
    finally:
        for pipe in pipes:
            pipe.close()
        for process in processes:
            process.join()


@contextmanager
def _process(target: Callable[..., None], *errand: Any) -> Iterator[Connection]:
    with _processes(target, [errand]) as (pipe,):
        yield pipe

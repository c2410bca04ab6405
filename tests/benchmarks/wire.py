"""Benchmarks a coordinator over the network: request cycles, sessions, simultaneous deliveries.

Runs coordinator and workers as processes on loopback. Simulates no episodes.
"""

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
from factory.bench.results import Memory, Spread
from schemas.base import Model
from schemas.episode import EpisodeMeta
from schemas.errors import WorldError
from schemas.plan import Plan
from tests.benchmarks.coordinator_process import CoordinatorReady, CoordinatorUsage, serve_coordinator
from tests.benchmarks.fleet import (
    WorkCost,
    bundle_of,
    claim_and_announce,
    claim_until_stopped,
    deliver_together,
    stay_connected,
)

_CYCLES = 5000
"""Largest number of cycles in one run, summed over all workers. A small ledger allows fewer cycles, because each cycle
uses up one job."""
_CYCLE_BUNDLE_BYTES = 1 << 20
"""Size of a bundle during the cycles, bytes: one chunk."""
_WORKERS_PER_PROCESS = 500
_CLAIM_PAUSE_S = 0.02
_TIMEOUT_S = 600.0
_SPAWN = multiprocessing.get_context("spawn")


class SessionLoad(Model):
    """Result of many simultaneous worker sessions."""

    sessions: int
    memory: Memory
    """Memory of the coordinator with all sessions."""


class DeliveryLoad(Model):
    """Result of simultaneous deliveries: all workers finish a large bundle, while another worker claims jobs."""

    workers: int
    bundle_mb: float
    """Size of each bundle, MB (1e6 bytes)."""
    seconds: float
    """Wall time until the last bundle was archived and deleted, seconds."""
    mb_per_s: float
    claims: int
    """Number of claims that the other worker sent during the deliveries."""
    claim_p50_ms: float
    claim_p99_ms: float
    memory: Memory
    """Memory of the coordinator."""


class WireBench(Model):
    """Result for a complete coordinator in a separate process, with worker processes over zenoh on loopback."""

    cycles_per_s: Spread
    """Cycles of claim and announcement per second of wall time. The coordinator replies when a change is durable."""
    archived_per_s: Spread
    """Small bundles that the coordinator pulls and archives per second while the workers claim and announce."""
    coordinator_cpu_ms: Spread
    """CPU time of the coordinator process per cycle, including the concurrent pulling, milliseconds."""
    workers_cpu_ms: Spread
    """CPU time of the worker process per cycle, milliseconds. The process shares the cores with the coordinator."""
    start_s: Spread
    """Time from the start of the coordinator with a filled ledger until it listens, seconds."""
    session_load: SessionLoad
    delivery_load: DeliveryLoad


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
    """Starts a coordinator on a filled ledger, runs the loads over zenoh, and returns the measurements.

    Args:
        plan: Plan of the ledger in `root`, with enough jobs for all claims.
        catalog: Scenes of the plan.
        meta: Metadata of a real episode, which are used for every bundle.
        root: Directory of the ledger.
        workers: Number of concurrent workers.
        sessions: Number of simultaneous sessions for the memory measurement.
        bundle_bytes: Size of each bundle in the simultaneous deliveries, bytes.
        repeats: Number of runs of the cycles; each run starts a coordinator.

    Raises:
        WorldError: A process of the benchmark exited early.
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
        session_load=_measure_sessions(heavy, plan.run, sessions),
        delivery_load=_measure_deliveries(heavy, plan.run, workers, bundle_bytes),
    )


class _Run(NamedTuple):
    """Measurements of one run of cycles. Each run starts a new coordinator."""

    cycles: int
    start_s: float
    fleet: WorkCost
    coordinator_cpu_s: float
    archived: int
    """Number of bundles that the coordinator archived before it answered the last announcement."""


def _named(size: int) -> tuple[str, int]:
    return sha256(bundle_of(size)).hexdigest(), size


def _cycles(arguments: tuple[Any, ...], run: str, workers: int, rounds: int) -> _Run:
    episodes: Path = arguments[0] / "episodes"
    with process(serve_coordinator, *arguments) as coordinator:
        opened: CoordinatorReady = receive(coordinator)
        with process(claim_and_announce, opened.endpoints, run, workers, rounds, _CYCLE_BUNDLE_BYTES) as fleet:
            receive(fleet)
            before, there = usage(coordinator), len(list(episodes.iterdir()))
            fleet.send("go")
            cost: WorkCost = receive(fleet)
            archived, after = len(list(episodes.iterdir())) - there, usage(coordinator)
            return _Run(rounds * workers, opened.seconds, cost, after.cpu_s - before.cpu_s, archived)


def _measure_sessions(arguments: tuple[Any, ...], run: str, sessions: int) -> SessionLoad:
    with process(serve_coordinator, *arguments) as coordinator:
        opened: CoordinatorReady = receive(coordinator)
        shares = [min(_WORKERS_PER_PROCESS, sessions - start) for start in range(0, sessions, _WORKERS_PER_PROCESS)]
        with _processes(stay_connected, [(opened.endpoints, run, share) for share in shares]) as fleets:
            connected = sum(receive(fleet) for fleet in fleets)
            return SessionLoad(sessions=connected, memory=usage(coordinator).memory)


def _measure_deliveries(arguments: tuple[Any, ...], run: str, workers: int, bundle_bytes: int) -> DeliveryLoad:
    with process(serve_coordinator, *arguments) as coordinator:
        opened: CoordinatorReady = receive(coordinator)
        with (
            process(deliver_together, opened.endpoints, run, workers, bundle_bytes) as fleet,
            process(claim_until_stopped, opened.endpoints, run, _CLAIM_PAUSE_S) as claimer,
        ):
            receive(fleet)
            receive(claimer)
            fleet.send("go")
            seconds = receive(fleet)
            claimer.send("stop")
            waits_ms = 1000 * np.array(receive(claimer))
            return DeliveryLoad(
                workers=workers,
                bundle_mb=bundle_bytes / 1e6,
                seconds=seconds,
                mb_per_s=workers * bundle_bytes / 1e6 / seconds,
                claims=len(waits_ms),
                claim_p50_ms=float(np.percentile(waits_ms, 50)),
                claim_p99_ms=float(np.percentile(waits_ms, 99)),
                memory=usage(coordinator).memory,
            )


def usage(coordinator: Connection) -> CoordinatorUsage:
    """Returns the current memory and CPU time of a coordinator process."""
    coordinator.send("usage")
    found: CoordinatorUsage = receive(coordinator)
    return found


def receive(pipe: Connection) -> Any:
    """Returns the next message of a process.

    Raises:
        WorldError: The process exited, or sent no message.
    """
    try:
        if pipe.poll(_TIMEOUT_S):
            return pipe.recv()
    except EOFError as error:
        raise WorldError("a process of the benchmark exited early; see its error message above") from error
    raise WorldError(
        f"a process of the benchmark sent no message for {_TIMEOUT_S:.0f} s; repeat on a less busy machine"
    )


@contextmanager
def _processes(target: Callable[..., None], argument_sets: list[tuple[Any, ...]]) -> Iterator[list[Connection]]:
    pipes, processes = [], []
    try:
        for arguments in argument_sets:
            ours, theirs = _SPAWN.Pipe()
            process = _SPAWN.Process(target=target, args=(theirs, *arguments), daemon=True)
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
def process(target: Callable[..., None], *arguments: Any) -> Iterator[Connection]:
    """Starts a process; yields its pipe and closes it at the end."""
    with _processes(target, [arguments]) as (pipe,):
        yield pipe

"""Simulates the sessions of thousands of workers against the protocol handlers and the ledger of one coordinator.

Time is virtual: sessions claim, send heartbeats and announce bundles as workers of a given pace would. Measures the CPU
time of parsing, ledger and replies. Opens no connection and transfers no bundle.

    python -m tests.benchmarks.sessions --sessions 10000
"""

from __future__ import annotations

import heapq
import random
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import partial
from itertools import count
from pathlib import Path

import click

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.plan_file import load_plan, shrink
from coordinator.ledger.database.engine import open_writer
from coordinator.ledger.database.writer import Writer
from coordinator.ledger.opening import ledger_url_of, open_run
from coordinator.protocol.protocol import ParsedRequest, ProtocolAnswer, Terms, parse, serve
from factory.bench.machine import describe_machine
from factory.bench.results import Machine
from factory.bench.tables import progress_bar
from factory.bench.workload import SAMPLE_PLAN, make_sample, narrow, temporary_folder
from factory.cli.options import count_option, json_option, number_option
from factory.runs.catalog import open_catalog
from factory.support.settings import scene_cache
from factory.support.terminal import print_result, print_table
from schemas.base import Model
from schemas.bundle import BundleReader
from schemas.episode import EpisodeMeta
from schemas.plan import Plan
from schemas.protocol.keys import Verb
from schemas.protocol.messages import Beat, Claim, ClaimReply, Done, Hello, Lease, LeaseProgress
from schemas.storage.dataset_files import LEDGER_FILE
from schemas.terms import Recording
from tests.benchmarks.command import run
from tests.benchmarks.coordinator import archiving
from workers.sim.context import SimulationContext

_START = datetime(2026, 1, 1, tzinfo=UTC)
_WINDOW_S = 0.02
"""Length of a window in virtual time, seconds. All requests in a window are handled together; a commit to disk takes
about this time."""
_ARCHIVE_S = 1.0
"""Time from the announcement of a bundle to the archived episode, seconds."""
_BEATS_PER_LEASE = 4
_VERSION = "bench"
_ARCHIVE = "archive"
"""Name that the results use for the ledger's work to record an archived episode, which is not a request."""


class VerbLoad(Model):
    """Requests of one verb."""

    per_s: float
    """Requests per second of simulated time."""
    received_bytes: float
    """Mean size of a request, bytes."""
    sent_bytes: float
    """Mean size of a reply, bytes."""
    cpu_us: float
    """Mean CPU time of a request for parsing, ledger and reply, without commit and network, microseconds."""


class SessionsBench(Model):
    """Result of the benchmark."""

    bench: str = "sessions"
    machine: Machine
    sessions: int
    """Number of workers, each with one session."""
    cores: int
    """Number of simulations of each worker."""
    episode_s: float
    """Mean duration of an attempt, seconds."""
    lease_s: float
    """Lease time, seconds."""
    seconds: float
    """Simulated time, seconds."""
    verbs: dict[str, VerbLoad]
    """Verb -> load. The entry `archive` is not a request: it is the ledger's work to record an archived episode."""
    episodes_per_s: float
    """Archived episodes per second of simulated time."""
    commits_per_s: float
    """Commits of the ledger per second of simulated time; each is one fsync."""
    commit_us: float
    """CPU time of a commit, microseconds."""
    ledger_bytes_per_episode: float
    """Growth of the ledger per archived episode, bytes."""
    coordinator_cores: float
    """CPU time per second of simulated time, without network and bundles."""


@dataclass(frozen=True)
class SessionsLoad:
    """Workload of a simulation."""

    sessions: int
    """Number of workers, each with one session."""
    cores: int
    """Number of simulations of each worker."""
    episode_s: float
    """Mean duration of an attempt, seconds."""
    lease_s: float
    """Lease time, seconds; a worker sends four heartbeats in this time."""
    seconds: float
    """Simulated time after the start of all workers, seconds."""


@dataclass
class _Session:
    """Worker as the coordinator sees it."""

    sid: str
    host: str
    live: list[Lease] = field(default_factory=list)
    spool: list[Lease] = field(default_factory=list)


class _Meter:
    """Number, size and CPU time of requests."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.received: Counter[str] = Counter()
        self.sent: Counter[str] = Counter()
        self.cpu_s: defaultdict[str, float] = defaultdict(float)

    def loads(self, seconds: float) -> dict[str, VerbLoad]:
        """Returns the load by verb."""
        return {
            verb: VerbLoad(
                per_s=number / seconds,
                received_bytes=self.received[verb] / number,
                sent_bytes=self.sent[verb] / number,
                cpu_us=1e6 * self.cpu_s[verb] / number,
            )
            for verb, number in sorted(self.counts.items())
        }


def bench_sessions(plan: Plan, catalog: Catalog, meta: EpisodeMeta, folder: Path, load: SessionsLoad) -> SessionsBench:
    """Simulates the sessions and returns the load of the coordinator.

    Args:
        plan: Plan with one scene.
        catalog: Scenes of the plan.
        meta: Metadata of a real episode, which are used for every episode.
        folder: Directory of the ledger.
        load: Workload.
    """
    jobs = int(load.sessions * load.cores * (2.5 + load.seconds / load.episode_s))
    plan = plan.model_copy(update={"scenes": (plan.scenes[0].model_copy(update={"episodes": jobs}),)})
    engine = open_writer(ledger_url_of(folder))
    open_run(engine, plan, catalog, load.lease_s, _START)
    terms = Terms(plan, catalog, _VERSION, load.lease_s, 1.0)
    with Writer(engine) as writer:
        fleet = _Fleet(writer, terms, meta, load)
        fleet.run_until(load.episode_s)  # the workers start one after another
        fleet.meter = meter = _Meter()
        commits, size, writer_s = writer.commits, _ledger_bytes(folder), writer.cpu_s()
        fleet.run_until(load.episode_s + load.seconds)
        served_s = sum(meter.cpu_s.values())
        commit_s = writer.cpu_s() - writer_s - fleet.in_writer_s
        commits, size = writer.commits - commits, _ledger_bytes(folder) - size
    engine.dispose()
    archived = meter.counts[_ARCHIVE]
    return SessionsBench(
        machine=describe_machine(),
        sessions=load.sessions,
        cores=load.cores,
        episode_s=load.episode_s,
        lease_s=load.lease_s,
        seconds=load.seconds,
        verbs=meter.loads(load.seconds),
        episodes_per_s=archived / load.seconds,
        commits_per_s=commits / load.seconds,
        commit_us=1e6 * commit_s / max(1, commits),
        ledger_bytes_per_episode=size / max(1, archived),
        coordinator_cores=(served_s + commit_s) / load.seconds,
    )


def _ledger_bytes(folder: Path) -> int:
    return (folder / LEDGER_FILE).stat().st_size


class _Fleet:
    """Event queue of all sessions in virtual time."""

    def __init__(self, writer: Writer, terms: Terms, meta: EpisodeMeta, load: SessionsLoad) -> None:
        self._writer, self._terms, self._meta, self._load = writer, terms, meta, load
        self._rng, self._order, self._tokens = random.Random(0), count(), count(1)
        self._events: list[tuple[float, int, Callable[[float], None]]] = []
        self._waiting: list[Callable[[], None]] = []
        self.meter = _Meter()
        self.in_writer_s = 0.0
        """CPU time of requests in the writer's thread since the last start of `run_until`, seconds."""
        for number in range(load.sessions):
            session = _Session(f"host-{number}.1", f"host-{number}")
            self._at(self._rng.uniform(0.0, load.episode_s / 2), partial(self._hello, session))

    def run_until(self, end: float) -> None:
        """Handles all events before a virtual time, in windows; the requests of a window are queued together."""
        self.in_writer_s = 0.0
        while self._events and self._events[0][0] < end:
            closing = self._events[0][0] + _WINDOW_S
            while self._events and self._events[0][0] < closing:
                at, _, event = heapq.heappop(self._events)
                event(at)
            waiting, self._waiting = self._waiting, []
            for finish in waiting:
                finish()

    def _at(self, at: float, event: Callable[[float], None]) -> None:
        heapq.heappush(self._events, (at, next(self._order), event))

    def _hello(self, session: _Session, now: float) -> None:
        hello = Hello(sid=session.sid, host=session.host, slots=self._load.cores, version=_VERSION)
        self._ask(session, Verb.HELLO, hello, now, lambda _reply: None)
        for _ in range(self._load.cores):
            self._claim(session, now)
        first = now + self._rng.uniform(0.0, self._load.lease_s / _BEATS_PER_LEASE)
        self._at(first, lambda at: self._beat(session, at))

    def _claim(self, session: _Session, now: float) -> None:
        claim = Claim(sid=session.sid, token=f"{next(self._tokens):032x}")

        def work(reply: Model) -> None:
            assert isinstance(reply, ClaimReply)
            assert reply.lease is not None
            assert reply.job is not None
            lease, index = reply.lease, reply.job.index
            session.live.append(lease)
            seconds = self._load.episode_s * self._rng.uniform(0.5, 1.5)
            self._at(now + seconds, lambda at: self._done(session, lease, index, at))

        self._ask(session, Verb.CLAIM, claim, now, work)

    def _done(self, session: _Session, lease: Lease, index: int, now: float) -> None:
        session.live.remove(lease)
        session.spool.append(lease)
        done = Done(sid=session.sid, lease=lease, sha256="c" * 64, size=1000)
        self._ask(session, Verb.DONE, done, now, lambda _reply: None)
        self._at(now + _ARCHIVE_S, lambda _at: self._archive(session, lease, index))
        self._claim(session, now)

    def _archive(self, session: _Session, lease: Lease, index: int) -> None:
        work = archiving(lease, index, self._meta)
        future = self._writer.submit(lambda connection: self._timed(_ARCHIVE, lambda: work(connection)))
        self.meter.counts[_ARCHIVE] += 1
        self._waiting.append(lambda: session.spool.remove(lease) if future.result() else None)

    def _beat(self, session: _Session, now: float) -> None:
        live = tuple(LeaseProgress(lease=lease, step=100) for lease in session.live)
        beat = Beat(sid=session.sid, live=live, spool=tuple(session.spool))
        self._ask(session, Verb.BEAT, beat, now, lambda _reply: None)
        pause_s = self._load.lease_s / _BEATS_PER_LEASE * self._rng.uniform(0.8, 1.2)
        self._at(now + pause_s, lambda at: self._beat(session, at))

    def _ask(self, session: _Session, verb: Verb, message: Model, now: float, then: Callable[[Model], None]) -> None:
        payload, at = message.model_dump_json().encode(), _START + timedelta(seconds=now)
        meter = self.meter
        meter.counts[verb] += 1
        meter.received[verb] += len(payload)
        started = time.thread_time()
        request = parse(verb, session.host, payload)
        meter.cpu_s[verb] += time.thread_time() - started
        assert isinstance(request, ParsedRequest), request
        future: Future[ProtocolAnswer] = self._writer.submit(
            lambda connection: self._timed(verb, lambda: serve(connection, request, self._terms, at))
        )

        def finish() -> None:
            answer = future.result()
            started = time.thread_time()
            meter.sent[verb] += len(answer.reply.model_dump_json())
            meter.cpu_s[verb] += time.thread_time() - started
            then(answer.reply)

        self._waiting.append(finish)

    def _timed(self, verb: str, work: Callable[[], ProtocolAnswer]) -> ProtocolAnswer:
        """Runs work in the writer's thread and records its CPU time."""
        started = time.thread_time()
        result = work()
        spent_s = time.thread_time() - started
        self.meter.cpu_s[verb] += spent_s
        self.in_writer_s += spent_s
        return result


@click.command()
@count_option("--sessions", 10_000, "Number of workers, each with one session.", most=10_000)
@count_option("--cores", 1, "Number of simulations of each worker.", most=256)
@number_option("SECONDS", "--attempt", 10.0, "Mean duration of an attempt, seconds.", "episode_s", least=0.1)
@number_option(
    "SECONDS", "--lease", 15.0, "Lease time, seconds; a worker sends four heartbeats per lease.", "lease_s", least=1.0
)
@number_option("SECONDS", "--seconds", 30.0, "Simulated time after the start of all workers, seconds.", least=1.0)
@json_option
def command(sessions: int, cores: int, episode_s: float, lease_s: float, seconds: float, as_json: bool) -> None:
    """Simulate thousands of workers against one coordinator.

    The requests of the workers run through the real handlers and a ledger on disk, in virtual time. Measures the CPU
    time, the messages and the commits. The benchmarks `coordinator` and `delivery` measure network and bundles.
    """
    plan = shrink(narrow(load_plan(SAMPLE_PLAN), ("office",), 2), record=Recording.STATES)
    with progress_bar("sample", plan.episodes) as tell, temporary_folder() as folder:
        catalog = open_catalog(plan, folder, scene_cache())
        with SimulationContext() as stage:
            samples = make_sample(folder / "sample", plan, catalog, stage, tell)
        with samples[0].path.open("rb") as file, BundleReader(file) as bundle:
            meta = bundle.meta
        load = SessionsLoad(sessions, cores, episode_s, lease_s, seconds)
        report = bench_sessions(plan, catalog, meta, folder, load)
    print_result(report, as_json, _show)


def _show(report: SessionsBench) -> None:
    title = (
        f"{report.sessions} sessions of {report.cores} cores, an attempt every {report.episode_s:g} s, lease "
        f"{report.lease_s:g} s, {report.seconds:g} s simulated"
    )
    rows = [
        (verb, *(f"{value:.0f}" for value in (load.per_s, load.received_bytes, load.sent_bytes, load.cpu_us)))
        for verb, load in report.verbs.items()
    ]
    print_table(title, ("request", "per second", "bytes", "bytes of the reply", "CPU us"), rows)
    totals = [
        ("archived episodes per second", f"{report.episodes_per_s:.0f}"),
        ("commits per second, one fsync each", f"{report.commits_per_s:.0f}"),
        ("CPU time of a commit, us", f"{report.commit_us:.0f}"),
        ("ledger, bytes per episode", f"{report.ledger_bytes_per_episode:.0f}"),
        ("cores of the coordinator, without network", f"{report.coordinator_cores:.2f}"),
    ]
    print_table("\nin total", ("quantity", "value"), totals)


if __name__ == "__main__":
    run(command)

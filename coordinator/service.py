"""Coordinator of one run: opens archive, ledger, writer, pullers and router in order and closes them in reverse.

The module connects the components and runs the periodic tasks (lease expiry, free space, tables). It does not implement
verbs or state transitions of jobs.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import structlog

from coordinator.archive.opening import open_archive
from coordinator.clock import ClockWatch, seconds_since_boot
from coordinator.expansion.catalog import Catalog
from coordinator.expansion.evaluation import Errands
from coordinator.lease_limit import LeaseLimit
from coordinator.ledger import claims
from coordinator.ledger.engine import open_reader, open_writer
from coordinator.ledger.hosts import troubled
from coordinator.ledger.opening import ledger_url_of, note_sandbox, open_run
from coordinator.ledger.reading.progress import count_frames, read_progress
from coordinator.ledger.reading.reader import Connection, translate_damage
from coordinator.ledger.writer import Writer
from coordinator.meters import Meter, Meters
from coordinator.periodic_tasks import PeriodicTasks
from coordinator.protocol.address_file import remove_address, write_address
from coordinator.protocol.dispatch import Dispatch
from coordinator.protocol.protocol import Terms
from coordinator.protocol.request_handler import RequestHandler
from coordinator.protocol.router import Router
from coordinator.protocol.tls import Guard
from coordinator.recovery.ledger_replacement import replace_unusable_ledger
from coordinator.recovery.reconcile import reconcile
from coordinator.settings import CoordinatorSettings
from coordinator.status.health import HealthMonitor
from coordinator.tables.checkpoint import is_checkpoint_owed, write_checkpoint
from coordinator.tables.split_tables import write_split_tables
from coordinator.transfer.local_ledger import LocalLedgerClient
from coordinator.transfer.puller import Judge, Nearby, Pullers, nothing_nearby
from coordinator.validation.validator import Validator, sandbox_of
from schemas.dataset_meta import GateOutcome
from schemas.errors import WorldError
from schemas.plan import Plan
from schemas.storage.object_path import ObjectPath
from schemas.support.closing import Closing
from schemas.wire import Progress

__all__ = ["DEFAULT_LISTEN", "Coordinator", "utc_now"]

DEFAULT_LISTEN = ("tcp/127.0.0.1:7447",)
_WAIT_S = 0.5
_THUMBNAILS_S = 2.0
"""Time limit of thumbnails when an unfinished run stops, seconds."""
_BARRED_S = 5.0
_SANDBOX_S = 1.0
_LEASE_LIMIT_S = 1.0
"""Pause between two checks of the lease limit, seconds."""
_DEPARTURE_S = 3.0
"""Least time for which the end of a run is announced, seconds: a worker may be reconnecting."""
_AGAIN = "start again: the ledger is rebuilt from the episodes"

log = structlog.get_logger(__name__)


def utc_now() -> datetime:
    """Returns the current time in UTC."""
    return datetime.now(UTC)


class Coordinator(Closing):
    """Running coordinator; a context manager. Closing it loses no data.

    Args:
        root: dataset directory, or with `store` the local home; created, or opened to resume the run.
        plan: plan of the run.
        catalog: compiled scenes of the plan.
        listen: zenoh endpoints; port 0 selects a free port.
        ledger_url: URL of the ledger; by default `ledger.db` in the directory.
        settings: operational settings, which do not affect the contents of the dataset.
        guard: TLS credentials and admission list; `None` admits every peer that can connect.
        checker: validator of bundles, closed with the coordinator; by default one sandboxed child process per puller.
        clock: wall clock; tests provide one to let leases expire.
        elapsed: monotonic clock, seconds, to detect changes of the wall clock.
        gate: results of the pilot before a new run, recorded in the dataset's metadata.
        store: root of the dataset in object storage; `None` for a dataset in a directory.
        errands: jobs of an evaluation, which replace the plan's draws; their results are archived without episode
            tables.
        connect: endpoints of other coordinators, whose workers may also execute jobs of this one.
        nearby: function that finds bundles of workers on this machine, to avoid the transfer over the network.

    Raises:
        UsageError: the directory holds another plan.
        WorldError: another coordinator holds the directory, the disk cannot be written, or an endpoint is in use.
    """

    def __init__(
        self,
        root: Path,
        plan: Plan,
        catalog: Catalog,
        listen: Sequence[str] = DEFAULT_LISTEN,
        ledger_url: str | None = None,
        settings: CoordinatorSettings | None = None,
        *,
        guard: Guard | None = None,
        checker: Judge | None = None,
        clock: Callable[[], datetime] = utc_now,
        elapsed: Callable[[], float] = seconds_since_boot,
        gate: Sequence[GateOutcome] = (),
        store: ObjectPath | None = None,
        errands: Errands | None = None,
        connect: Sequence[str] = (),
        nearby: Nearby = nothing_nearby,
    ) -> None:
        self._gate = tuple(gate)
        self._settings = settings = settings or CoordinatorSettings()
        self._clock = clock
        self._watch = ClockWatch(clock, elapsed)
        self._draining = threading.Event()
        self._changed = threading.Event()
        self._has_room = True
        self._barred: frozenset[str] = frozenset()
        self._has_written = False
        self._noted_sandbox: tuple[str, ...] = ()
        self._meters = Meters()
        self._terms = Terms(
            plan=plan,
            catalog=catalog,
            version=version("minivla-factory"),
            lease_ttl_s=settings.lease_ttl_s,
            retry_after_s=settings.retry_after_s,
            is_draining=self._draining.is_set,
            has_room=lambda: self._has_room,
            errands=errands,
        )
        url = ledger_url_of(root, ledger_url)
        self._checker = checker = checker or Validator(settings.pullers)
        with ExitStack() as stack:
            stack.callback(checker.close)
            self._archive = stack.enter_context(open_archive(root, store))
            replace_unusable_ledger(self._archive, url, catalog)
            self._open_ledger(stack, url, checker)
            self._writer = stack.enter_context(Writer(self._engine))
            stack.callback(self._note_sandbox)
            stack.callback(self._write_split_tables)
            stack.callback(self._write_tables)
            self._pullers = stack.enter_context(self._open_pullers(checker, nearby))
            stack.callback(checker.close)  # before the pullers end, so that they do not wait for a long validation
            limit_s = settings.lease_limit_s
            self._lease_limit = LeaseLimit(self._reading, self._writer.call, self._terms, clock, limit_s)
            self._check_free_space()
            handler = stack.enter_context(self._open_request_handler())
            files = errands.files if errands is not None else {}
            router = Router(plan.run, listen, catalog, settings, handler.take, handler.note_gone, guard, connect, files)
            self._router = stack.enter_context(router)
            stack.enter_context(self._open_periodic_tasks())
            # a separate thread: writing the tables of a large run takes seconds, and leases expire meanwhile
            stack.enter_context(PeriodicTasks({"write_tables": (settings.checkpoint_s, self._write_tables)}))
            self.health = self._measured()
            """Health and metrics of the coordinator."""
            write_address(root, plan.run, router.endpoints)
            stack.callback(remove_address, root)
            self._stack = stack.pop_all()
        log.info("coordinator_started", run=plan.run, endpoints=router.endpoints, directory=str(store or root))

    @property
    def endpoints(self) -> tuple[str, ...]:
        """Endpoints for workers."""
        return self._router.endpoints

    @property
    def run(self) -> str:
        """Name of the run."""
        return self._terms.plan.run

    def progress(self) -> Progress:
        """Returns the progress of the run."""
        with self._reading() as connection:
            return read_progress(connection, self._clock())

    def is_finished(self) -> bool:
        """Returns whether no job can change any more without an admin request."""
        with self._reading() as connection:
            return not claims.has_open_jobs(connection)

    def wait(self, timeout_s: float | None = None, stop: threading.Event | None = None) -> bool:
        """Waits until the run is finished.

        Args:
            timeout_s: timeout, seconds; `None` waits without a limit.
            stop: event that ends the wait early.

        Returns:
            Whether the run is finished.
        """
        stop = stop or threading.Event()
        left = timeout_s
        while not self.is_finished():
            if left is not None and left <= 0:
                return False
            if stop.wait(_WAIT_S if left is None else min(_WAIT_S, left)):
                return self.is_finished()
            left = None if left is None else left - _WAIT_S
        return True

    def wait_for_departures(self, stop: threading.Event | None = None) -> None:
        """Waits until the workers of a finished run were notified and disconnected, at most about one lease duration.

        Args:
            stop: event that ends the wait early.
        """
        stop = stop or threading.Event()
        begun = time.monotonic()
        least = begun + _DEPARTURE_S
        most = begun + _DEPARTURE_S + self._settings.lease_ttl_s
        while (now := time.monotonic()) < most and (now < least or self._router.present):
            if stop.wait(_WAIT_S):
                return

    def drain(self) -> None:
        """Stops leasing jobs; workers stop after their current jobs."""
        self._draining.set()

    def close(self) -> None:
        """Stops listening, completes the queued work, writes the tables and releases the directory."""
        self._stack.close()

    @contextmanager
    def _reading(self) -> Iterator[Connection]:
        """Yields a connection for reading; raises `WorldError` if the ledger is damaged or was removed."""
        if self._writer.damage:
            raise WorldError(f"the ledger of run {self.run} is damaged: {self._writer.damage}; {_AGAIN}")
        with translate_damage(self._url), self._reader.connect() as connection:
            yield connection

    def _open_ledger(self, stack: ExitStack, url: str, checker: Judge) -> None:
        terms = self._terms
        self._url = url
        self._engine = open_writer(url)
        stack.callback(self._engine.dispose)
        planned = terms.errands.planned if terms.errands is not None else None
        is_new = open_run(self._engine, terms.plan, terms.catalog, terms.lease_ttl_s, self._clock(), planned)
        for name, entry in terms.catalog.items():
            self._archive.add_scene(entry.path, name, entry.sha256)
        self._reader = open_reader(url)
        stack.callback(self._reader.dispose)
        reconciled = reconcile(self._archive, self._engine, terms, checker, self._clock())
        with self._reader.connect() as connection:
            is_owed = is_checkpoint_owed(self._archive, connection)
        if is_new or reconciled.adopted or reconciled.requeued or is_owed:
            self._changed.set()

    def _open_pullers(self, checker: Judge, nearby: Nearby) -> Pullers:
        return Pullers(
            self._archive,
            LocalLedgerClient(self._writer, self._terms, self._clock),
            lambda sid, lease, chunk: self._router.fetch(sid, lease, chunk),
            checker,
            self._settings,
            self._changed.set,
            self._meters,
            nearby,
        )

    def _open_request_handler(self) -> RequestHandler:
        return RequestHandler(
            self._writer,
            self._terms,
            self._clock,
            read_progress=self.progress,
            dispatch=Dispatch(self._pullers.offer),
            on_archived=self._changed.set,
            on_drain=self.drain,
            backlog=self._settings.backlog,
            meters=self._meters,
        )

    def _measured(self) -> HealthMonitor:
        return HealthMonitor(
            self._writer,
            self._meters,
            self._read_figures,
            self._archive.free_bytes,
            self._settings.reserve_bytes,
            lambda: self._router.is_open,
            lambda: sandbox_of(self._checker),
        )

    def _read_figures(self) -> tuple[Progress, int]:
        with self._reading() as connection:
            return read_progress(connection, self._clock()), count_frames(connection)

    def _open_periodic_tasks(self) -> PeriodicTasks:
        settings = self._settings
        return PeriodicTasks(
            {
                "expire": (settings.sweep_s, self._expire),
                "limit_leases": (_LEASE_LIMIT_S, self._limit_leases),
                "check_free_space": (1.0, self._check_free_space),
                "admit": (settings.admission_s, self._admit),
                "note_sandbox": (_SANDBOX_S, self._note_sandbox),
                "warn_of_barred": (_BARRED_S, self._warn_of_barred),
            }
        )

    def _expire(self) -> None:
        self._check_clock()
        expired = self._writer.call(lambda connection: claims.expire(connection, self._clock()))
        if expired:
            self._meters.add(Meter.EXPIRED, expired)
            log.warning("leases_expired", jobs=expired, remedy="they are given to other workers")

    def _limit_leases(self) -> None:
        self._check_clock()
        if not self._has_room:
            self._lease_limit.restart()  # the full disk delays the bundles, not the workers
        self._meters.add(Meter.EXPIRED, self._lease_limit.enforce())

    def _note_sandbox(self) -> None:
        """Records the sandbox layers of the validating processes for `factory status`, after the first has started."""
        layers = sandbox_of(self._checker)
        if layers != self._noted_sandbox:
            self._writer.submit(lambda connection: note_sandbox(connection, layers))
            self._noted_sandbox = layers

    def _warn_of_barred(self) -> None:
        with self._reader.connect() as connection:
            barred = {host.host: host for host in troubled(connection) if host.barred_at is not None}
        for name in sorted(barred.keys() - self._barred):
            remedy = f"put it right, then `factory jobs release DIR {name}`"
            log.warning(
                "host_barred", host=name, failures=barred[name].strikes, last=barred[name].reason, remedy=remedy
            )
        self._barred = frozenset(barred)

    def _check_clock(self) -> None:
        """Restarts all leases after the wall clock was set, because they end at times of the previous clock."""
        jump_s = self._watch.jump_s()
        if jump_s:
            ttl_s = self._settings.lease_ttl_s
            held = self._writer.call(lambda connection: claims.grant_grace(connection, self._clock(), ttl_s))
            self._watch.accept()
            self._lease_limit.restart()
            log.warning("clock_was_set", by_s=round(jump_s), leases=held, remedy="none; all leases restart")

    def _admit(self) -> None:
        if self._router.admit():
            log.warning("admission_changed", remedy="none; workers reconnect within seconds")

    def _check_free_space(self) -> None:
        free = self._archive.free_bytes()
        has_room = free >= self._settings.reserve_bytes
        if has_room != self._has_room:
            self._has_room = has_room
            event = "disk_space_recovered" if has_room else "disk_low_no_jobs_leased"
            log.warning(
                event,
                free_bytes=free,
                reserve_bytes=self._settings.reserve_bytes,
                directory=str(self._archive.root),
                remedy="none" if has_room else "free some space; the run then continues",
            )

    def _write_tables(self) -> None:
        if self._changed.is_set() and self._terms.errands is None:
            self._changed.clear()
            try:
                with self._reading() as connection:
                    terms, is_over = self._terms, not claims.has_open_jobs(connection)
                    # the first and the last checkpoint use the ledger only, independently of the existing file
                    anew = is_over or not self._has_written
                    write_checkpoint(
                        self._archive, connection, terms.plan, terms.catalog, self._clock(), self._gate, anew=anew
                    )
                self._has_written = True
            except Exception:
                self._changed.set()  # written by the next call
                raise

    def _write_split_tables(self) -> None:
        """Writes the split tables once, at the end: it reads a frame per new episode. Stopped runs limit the time."""
        if self._terms.errands is not None or self._changed.is_set():
            return  # their source tables are not up to date
        try:
            limit_s = None if self.is_finished() else _THUMBNAILS_S
        except WorldError as error:
            log.warning("split_tables_not_written", error=str(error), remedy=_AGAIN)
            return
        write_split_tables(self._archive, limit_s)

"""The coordinator of one run: opens archive, ledger, writer, pullers and router in order and closes them in reverse.

Wires the parts and keeps house (expiry, free space, tables); what a verb means or how a job moves is decided elsewhere.
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
from coordinator.expansion.evaluation import EvalJobs
from coordinator.housekeeper import Housekeeper
from coordinator.lease_limit import LeaseLimit
from coordinator.ledger import claims
from coordinator.ledger.engine import open_reader, open_writer
from coordinator.ledger.hosts import troubled
from coordinator.ledger.opening import ledger_url_of, note_sandbox, open_run
from coordinator.ledger.reading.look import Connection, damage_translated
from coordinator.ledger.reading.progress import count_frames, read_progress
from coordinator.ledger.writer import Writer
from coordinator.meters import Meter, Meters
from coordinator.protocol.address_file import remove_address, write_address
from coordinator.protocol.dispatch import Dispatch
from coordinator.protocol.front import Front
from coordinator.protocol.protocol import Terms
from coordinator.protocol.router import Router
from coordinator.protocol.tls import Guard
from coordinator.recovery.reconcile import reconcile
from coordinator.recovery.renewal import renew_ledger
from coordinator.settings import CoordinatorSettings
from coordinator.status.vitals import Vitals
from coordinator.tables.checkpoint import is_checkpoint_owed, write_checkpoint
from coordinator.tables.split_tables import write_split_tables
from coordinator.transfer.book import LedgerBook
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
"""Time for thumbnails at the end of a run that is not finished."""
_BARRED_S = 5.0
_SANDBOX_S = 1.0
_LEASE_LIMIT_S = 1.0
"""Pause between two looks for leases that are too old."""
_FAREWELL_S = 3.0
"""How long a finished run is announced at least: a worker may just be reconnecting."""
_AGAIN = "start again: the ledger is rebuilt from the episodes"

log = structlog.get_logger(__name__)


def utc_now() -> datetime:
    """Returns the time of this machine, in UTC."""
    return datetime.now(UTC)


class Coordinator(Closing):
    """A running coordinator; a context manager whose exit loses nothing.

    Args:
        root: dataset directory, or with `store` the home of what cannot lie there; it is created, or resumed.
        plan: what to make.
        catalog: the compiled scenes of the plan.
        listen: zenoh endpoints; port 0 takes a free one.
        ledger_url: another database than `ledger.db` in the directory.
        settings: numbers that change no byte of the dataset.
        guard: certificates and who is admitted; `None` lets in whoever can connect.
        checker: judges bundles and is closed with the coordinator; by default sandboxed children, one a puller.
        clock: the time; an argument, so that a test can let leases run out.
        elapsed: seconds that pass evenly, by which a clock that was set is noticed.
        gate: what a pilot found before a new run; goes into the dataset's description.
        store: where the dataset lies, when in object storage.
        evaluation: jobs instead of the plan's draws; their results are kept, and no tables of episodes are written.
        connect: endpoints of other coordinators, whose workers may work for this one too.
        nearby: where bundles of workers on this machine lie, which then need not come over the network.

    Raises:
        UsageError: the directory holds another plan.
        WorldError: another coordinator works there, the disk refuses, or an endpoint is taken.
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
        evaluation: EvalJobs | None = None,
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
            evaluation=evaluation,
        )
        url = ledger_url_of(root, ledger_url)
        self._checker = checker = checker or Validator(settings.pullers)
        with ExitStack() as stack:
            stack.callback(checker.close)
            self._archive = stack.enter_context(open_archive(root, store))
            renew_ledger(self._archive, url, catalog)
            self._open_ledger(stack, url, checker)
            self._writer = stack.enter_context(Writer(self._engine))
            stack.callback(self._note_sandbox)
            stack.callback(self._write_split_tables)
            stack.callback(self._write_tables)
            self._pullers = stack.enter_context(self._open_pullers(checker, nearby))
            stack.callback(checker.close)  # before the pullers end, so that they need not wait for a long check
            limit_s = settings.lease_limit_s
            self._lease_limit = LeaseLimit(self._reading, self._writer.call, self._terms, clock, limit_s)
            self._look_for_room()
            front = stack.enter_context(self._open_front())
            files = evaluation.files if evaluation is not None else {}
            router = Router(plan.run, listen, catalog, settings, front.take, front.note_gone, guard, connect, files)
            self._router = stack.enter_context(router)
            stack.enter_context(self._open_housekeeper())
            # a thread of its own: writing the tables of a large run takes seconds, and leases expire meanwhile
            stack.enter_context(Housekeeper({"write_tables": (settings.checkpoint_s, self._write_tables)}))
            self.vitals = self._measured()
            """How it does."""
            write_address(root, plan.run, router.endpoints)
            stack.callback(remove_address, root)
            self._stack = stack.pop_all()
        log.info("coordinator_started", run=plan.run, endpoints=router.endpoints, directory=str(store or root))

    @property
    def endpoints(self) -> tuple[str, ...]:
        """Where workers connect."""
        return self._router.endpoints

    @property
    def run(self) -> str:
        """Name of the run."""
        return self._terms.plan.run

    def progress(self) -> Progress:
        """Returns where the run stands."""
        with self._reading() as connection:
            return read_progress(connection, self._clock())

    def is_finished(self) -> bool:
        """Whether no job can change any more without an operator."""
        with self._reading() as connection:
            return not claims.has_open_jobs(connection)

    def wait(self, timeout_s: float | None = None, stop: threading.Event | None = None) -> bool:
        """Waits until the run is finished.

        Args:
            timeout_s: how long at most; `None` waits for ever.
            stop: ends the wait early when set.

        Returns:
            Whether it is finished.
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

    def see_off(self, stop: threading.Event | None = None) -> None:
        """Stays until the workers of a finished run have heard that it is, and have left; a lease long at most.

        Args:
            stop: ends the wait early when set.
        """
        stop = stop or threading.Event()
        begun = time.monotonic()
        least = begun + _FAREWELL_S
        most = begun + _FAREWELL_S + self._settings.lease_ttl_s
        while (now := time.monotonic()) < most and (now < least or self._router.present):
            if stop.wait(_WAIT_S):
                return

    def drain(self) -> None:
        """Gives out no more jobs and lets workers leave when theirs are done."""
        self._draining.set()

    def close(self) -> None:
        """Stops listening, finishes what is queued, writes the tables and releases the directory."""
        self._stack.close()

    @contextmanager
    def _reading(self) -> Iterator[Connection]:
        """Yields a reading connection; a ledger that was damaged or removed meanwhile is a `WorldError`."""
        if self._writer.damage:
            raise WorldError(f"the ledger of run {self.run} is damaged: {self._writer.damage}; {_AGAIN}")
        with damage_translated(self._url), self._reader.connect() as connection:
            yield connection

    def _open_ledger(self, stack: ExitStack, url: str, checker: Judge) -> None:
        terms = self._terms
        self._url = url
        self._engine = open_writer(url)
        stack.callback(self._engine.dispose)
        planned = terms.evaluation.planned if terms.evaluation is not None else None
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
            LedgerBook(self._writer, self._terms, self._clock),
            lambda sid, lease, chunk: self._router.fetch(sid, lease, chunk),
            checker,
            self._settings,
            self._changed.set,
            self._meters,
            nearby,
        )

    def _open_front(self) -> Front:
        return Front(
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

    def _measured(self) -> Vitals:
        return Vitals(
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

    def _open_housekeeper(self) -> Housekeeper:
        settings = self._settings
        return Housekeeper(
            {
                "expire": (settings.sweep_s, self._expire),
                "limit_leases": (_LEASE_LIMIT_S, self._limit_leases),
                "look_for_room": (1.0, self._look_for_room),
                "admit": (settings.admission_s, self._admit),
                "note_sandbox": (_SANDBOX_S, self._note_sandbox),
                "warn_of_barred": (_BARRED_S, self._warn_of_barred),
            }
        )

    def _expire(self) -> None:
        self._mind_clock()
        expired = self._writer.call(lambda connection: claims.expire(connection, self._clock()))
        if expired:
            self._meters.add(Meter.EXPIRED, expired)
            log.warning("leases_expired", jobs=expired, remedy="they are given to other workers")

    def _limit_leases(self) -> None:
        self._mind_clock()
        if not self._has_room:
            self._lease_limit.restart()  # no worker is to blame that its bundle waits
        self._meters.add(Meter.EXPIRED, self._lease_limit.enforce())

    def _note_sandbox(self) -> None:
        """Records for `factory status` what confines the validating processes, once the first one has been started."""
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

    def _mind_clock(self) -> None:
        """Starts all leases anew when the clock was set, for they end at times of the former one."""
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

    def _look_for_room(self) -> None:
        free = self._archive.free_bytes()
        has_room = free >= self._settings.reserve_bytes
        if has_room != self._has_room:
            self._has_room = has_room
            event = "disk_has_room_again" if has_room else "disk_low_nothing_is_given_out"
            log.warning(
                event,
                free_bytes=free,
                reserve_bytes=self._settings.reserve_bytes,
                directory=str(self._archive.root),
                remedy="none" if has_room else "free some space; the run then continues",
            )

    def _write_tables(self) -> None:
        if self._changed.is_set() and self._terms.evaluation is None:
            self._changed.clear()
            try:
                with self._reading() as connection:
                    terms, is_over = self._terms, not claims.has_open_jobs(connection)
                    # the first and the last time from the ledger alone, whatever became of the file meanwhile
                    anew = is_over or not self._has_written
                    write_checkpoint(
                        self._archive, connection, terms.plan, terms.catalog, self._clock(), self._gate, anew=anew
                    )
                self._has_written = True
            except Exception:
                self._changed.set()  # they are still owed
                raise

    def _write_split_tables(self) -> None:
        """Runs once, at the end, as it reads a frame of each new episode; a run that is stopped limits its time."""
        if self._terms.evaluation is not None or self._changed.is_set():
            return  # the tables that they are made from are not up to date
        try:
            limit_s = None if self.is_finished() else _THUMBNAILS_S
        except WorldError as error:
            log.warning("split_tables_not_written", error=str(error), remedy=_AGAIN)
            return
        write_split_tables(self._archive, limit_s)

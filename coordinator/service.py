"""The coordinator of one run: opens context, pullers, front and router in order and closes them in reverse.

Connects the parts; what a verb means or how a job moves is decided elsewhere.
"""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack
from importlib.metadata import version
from pathlib import Path

import structlog

from coordinator.chores import RoomWatch, RunChores
from coordinator.context import RunContext, open_context
from coordinator.expansion.catalog import Catalog
from coordinator.housekeeper import Housekeeper
from coordinator.options import CoordinatorOptions
from coordinator.protocol.address_file import remove_address, write_address
from coordinator.protocol.dispatch import Dispatch
from coordinator.protocol.front import Front
from coordinator.protocol.protocol import Terms
from coordinator.protocol.router import Router
from coordinator.status.vitals import Vitals
from coordinator.table_writer import TableWriter
from coordinator.transfer.book import LedgerBook
from coordinator.transfer.puller import Nearby, Pullers
from coordinator.validation.validator import sandbox_of
from schemas.plan import Plan
from schemas.support.closing import Closing
from schemas.wire import Progress

__all__ = ["Coordinator"]

_WAIT_S = 0.5
_FAREWELL_S = 3.0
"""How long a finished run is announced at least: a worker may just be reconnecting."""

log = structlog.get_logger(__name__)


class Coordinator(Closing):
    """A running coordinator; a context manager whose exit loses nothing.

    Args:
        root: dataset directory, or with `options.store` the home of what cannot be stored there; it is created, or
            resumed.
        plan: what to make.
        catalog: the compiled scenes of the plan.
        options: how to run; by default on loopback, with a ledger in the directory.

    Raises:
        UsageError: the directory holds another plan.
        WorldError: another coordinator works there, the disk refuses, or an endpoint is taken.
    """

    def __init__(self, root: Path, plan: Plan, catalog: Catalog, options: CoordinatorOptions | None = None) -> None:
        options = options or CoordinatorOptions()
        self._settings = options.settings
        self._draining = threading.Event()
        room = RoomWatch(options.settings.reserve_bytes)
        terms = self._terms_of(plan, catalog, options, room)
        with ExitStack() as stack:
            self._run = run = open_context(stack, root, terms, options)
            chores = RunChores(run, room, options.elapsed)
            stack.callback(chores.note_sandbox)
            self._tables = TableWriter(run, options.gate)
            stack.callback(self._tables.write_splits)
            stack.callback(self._tables.write)
            self._pullers = stack.enter_context(self._open_pullers(run, options.nearby))
            stack.callback(run.checker.close)  # before the pullers end, so that they need not wait for a long check
            chores.look_for_room()
            front = stack.enter_context(self._open_front(run))
            self._router = stack.enter_context(_open_router(run, options, front))
            stack.enter_context(Housekeeper(chores.table(self._router.admit)))
            # a thread of its own: writing the tables of a large run takes seconds, and leases expire meanwhile
            tables = {"write_tables": (options.settings.checkpoint_s, self._tables.write)}
            stack.enter_context(Housekeeper(tables))
            self.vitals = self._measured(run)
            """How it does."""
            write_address(root, plan.run, self.endpoints)
            stack.callback(remove_address, root)
            self._stack = stack.pop_all()
        log.info("coordinator_started", run=plan.run, endpoints=self.endpoints, directory=str(options.store or root))

    @property
    def endpoints(self) -> tuple[str, ...]:
        """Where workers connect."""
        return self._router.endpoints

    @property
    def run(self) -> str:
        """Name of the run."""
        return self._run.terms.plan.run

    def progress(self) -> Progress:
        """Returns where the run stands."""
        return self._run.ledger.progress()

    def is_finished(self) -> bool:
        """Whether no job can change any more without an operator."""
        return self._run.ledger.is_finished()

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

    def _terms_of(self, plan: Plan, catalog: Catalog, options: CoordinatorOptions, room: RoomWatch) -> Terms:
        return Terms(
            plan=plan,
            catalog=catalog,
            version=version("minivla-factory"),
            lease_ttl_s=options.settings.lease_ttl_s,
            retry_after_s=options.settings.retry_after_s,
            is_draining=self._draining.is_set,
            has_room=lambda: room.has_room,
            evaluation=options.evaluation,
        )

    def _open_pullers(self, run: RunContext, nearby: Nearby) -> Pullers:
        return Pullers(
            run.archive,
            LedgerBook(run.ledger.writer, run.terms, run.clock),
            lambda sid, lease, chunk: self._router.fetch(sid, lease, chunk),
            run.checker,
            run.settings,
            self._tables.note_change,
            run.meters,
            nearby,
        )

    def _open_front(self, run: RunContext) -> Front:
        return Front(
            run.ledger.writer,
            run.terms,
            run.clock,
            read_progress=self.progress,
            dispatch=Dispatch(self._pullers.offer),
            on_archived=self._tables.note_change,
            on_drain=self.drain,
            backlog=run.settings.backlog,
            meters=run.meters,
        )

    def _measured(self, run: RunContext) -> Vitals:
        return Vitals(
            run.ledger.writer,
            run.meters,
            run.ledger.figures,
            run.archive.free_bytes,
            run.settings.reserve_bytes,
            lambda: self._router.is_open,
            lambda: sandbox_of(run.checker),
        )


def _open_router(run: RunContext, options: CoordinatorOptions, front: Front) -> Router:
    terms = run.terms
    return Router(
        terms.plan.run,
        options.listen,
        terms.catalog,
        run.settings,
        front.take,
        front.note_gone,
        options.guard,
        options.connect,
        terms.evaluation.files if terms.evaluation is not None else {},
    )

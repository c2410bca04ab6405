"""Coordinator of one run: opens context, pullers, handler and router in order and closes them in reverse order.

The module connects the parts. It does not implement verbs or state transitions of jobs.
"""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, MutableMapping
from contextlib import ExitStack
from pathlib import Path

import structlog

from coordinator.context import RunContext, open_context
from coordinator.expansion.catalog import Catalog, SceneEntry
from coordinator.housekeeping import FreeSpaceMonitor, Housekeeping
from coordinator.ledger.administration import execute
from coordinator.options import CoordinatorOptions
from coordinator.periodic_tasks import PeriodicTasks
from coordinator.protocol.dispatch import Dispatch
from coordinator.protocol.protocol import Terms
from coordinator.protocol.request_handler import RequestHandler
from coordinator.protocol.router import Router
from coordinator.recheck import Rechecks
from coordinator.status.health import HealthMonitor
from coordinator.table_writer import TableWriter
from coordinator.transfer.contract import FindLocalBundle
from coordinator.transfer.layouts import LayoutStore
from coordinator.transfer.local_ledger import LocalLedgerClient
from coordinator.transfer.puller import Pullers
from coordinator.validation.validator import Validator, sandbox_of
from schemas.plan import Plan
from schemas.protocol.address_file import remove_address, usable_endpoints, write_address
from schemas.protocol.administration import AdminAction, AdminReply, AdminRequest
from schemas.protocol.messages import Hello
from schemas.protocol.status import Progress
from schemas.support.closing import Closing
from schemas.support.product import product_version

_WAIT_S = 0.5
_ADMIN_S = 30.0
"""Timeout of an admin request of this process, seconds."""
_RECHECK_S = 1.0
"""Pause between two searches for unchecked episodes of barred hosts, seconds."""
_FIRST_TABLES_S = 1.0
"""Pause between two checks whether a new run has its first episode and therefore gets its first tables, seconds."""
_DISCONNECT_S = 3.0
"""Minimum time for which the end of a run is announced, because a worker may be reconnecting, seconds."""

log = structlog.get_logger(__name__)


class Coordinator(Closing):
    """Running coordinator; a context manager. Closing it loses no data.

    Args:
        root: dataset directory, or with `options.store` the state directory; created, or opened to resume the run.
        plan: plan of the run.
        catalog: compiled scenes of the plan.
        options: options of the coordinator; by default it listens on loopback, with a ledger in the directory.

    Raises:
        UsageError: the directory contains a run of another plan.
        WorldError: another coordinator uses the directory, the disk cannot be written, or an endpoint is in use.
    """

    def __init__(self, root: Path, plan: Plan, catalog: Catalog, options: CoordinatorOptions | None = None) -> None:
        options = options or CoordinatorOptions()
        self._settings = options.settings
        self._draining, self._finished = threading.Event(), threading.Event()
        room = FreeSpaceMonitor(options.settings.reserve_bytes)
        scenes = dict(catalog)
        terms = self._terms_of(plan, scenes, options, room)
        with ExitStack() as stack:
            self._run = run = open_context(stack, root, terms, options)
            self._housekeeping = housekeeping = Housekeeping(run, room, options.elapsed)
            stack.callback(housekeeping.note_sandbox)
            self._tables = TableWriter(run, options.gate)
            stack.callback(self._tables.write_splits)
            stack.callback(self._tables.write)
            self._pullers = stack.enter_context(self._open_pullers(run, options.find_local_bundle, root, scenes))
            stack.callback(run.checker.close)  # before the pullers end, so they do not wait for a long validation
            housekeeping.check_free_space()
            housekeeping.check_views()
            self._handler = handler = stack.enter_context(self._open_request_handler(run, options.on_joined))
            self._router = stack.enter_context(_open_router(run, options, handler))
            self._periodic_tasks = [stack.enter_context(PeriodicTasks(housekeeping.table(self._router.admit)))]
            # the tables have a separate thread, so the expiry of leases does not wait for the tables of a large run
            tables = {
                "write_tables": (options.settings.checkpoint_s, self._tables.write),
                "write_first_tables": (_FIRST_TABLES_S, self._tables.write_first),
            }
            self._periodic_tasks.append(stack.enter_context(PeriodicTasks(tables)))
            rechecks = Rechecks(run, self._tables.note_change)
            self._periodic_tasks.append(
                stack.enter_context(PeriodicTasks({"recheck": (_RECHECK_S, rechecks.check_some)}))
            )
            self.health = self._measured(run)
            """Health and metrics of the coordinator."""
            self.reachable = usable_endpoints(self.endpoints, options.hosts or (socket.gethostname(),))
            """Endpoints with the names of this host instead of wildcard addresses."""
            write_address(root, plan.run, self.reachable, self.endpoints)
            stack.callback(remove_address, root)
            self._stack = stack.pop_all()
        log.info("coordinator_started", run=plan.run, endpoints=self.endpoints, directory=str(options.store or root))

    @property
    def endpoints(self) -> tuple[str, ...]:
        """Endpoints for workers."""
        return self._router.endpoints

    @property
    def run(self) -> str:
        return self._run.terms.plan.run

    def progress(self) -> Progress:
        return self._run.ledger.progress().model_copy(update={"shards": len(self._run.archive.shards())})

    def is_finished(self) -> bool:
        """Returns whether no job can change any more without an admin request.

        Raises:
            RuntimeError: the coordinator fails by an error of this software that repetition cannot change.
            WorldError: the camera of most attempts shows nothing.
        """
        self._housekeeping.require_view()
        self._pullers.require_no_fault()
        self._handler.require_no_fault()
        for tasks in self._periodic_tasks:
            tasks.require_no_fault()
        if self._run.ledger.is_finished():
            self._finished.set()
        else:
            self._finished.clear()
        return self._finished.is_set()

    def wait(self, timeout_s: float | None = None, stop: threading.Event | None = None) -> bool:
        """Waits until the run is finished.

        Args:
            timeout_s: timeout, seconds; `None` waits without a limit.
            stop: event that ends the wait early.

        Returns:
            Whether the run is finished.

        Raises:
            RuntimeError, WorldError: see `is_finished`.
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

    def wait_for_workers_to_disconnect(self, stop: threading.Event | None = None) -> None:
        """Waits until the workers of a finished run were notified and disconnected, at most about one lease duration.

        Args:
            stop: event that ends the wait early.
        """
        stop = stop or threading.Event()
        started = time.monotonic()
        least = started + _DISCONNECT_S
        most = started + _DISCONNECT_S + self._settings.lease_ttl_s
        while (now := time.monotonic()) < most and (now < least or self._router.present):
            if stop.wait(_WAIT_S):
                return

    def administer(self, request: AdminRequest) -> AdminReply:
        """Executes an admin request of this process.

        Raises:
            WorldError: the ledger is damaged or does not commit.
        """
        now = self._run.clock()
        reply = self._run.ledger.writer.submit(lambda connection: execute(connection, request, now)).result(_ADMIN_S)
        if request.action is AdminAction.DRAIN:
            self.drain()
        return reply

    def drain(self) -> None:
        """Stops leasing jobs; workers stop after their current jobs."""
        self._draining.set()

    def close(self) -> None:
        """Stops listening, completes the queued work, writes the tables and releases the directory."""
        self._stack.close()

    def _terms_of(self, plan: Plan, catalog: Catalog, options: CoordinatorOptions, room: FreeSpaceMonitor) -> Terms:
        return Terms(
            plan=plan,
            catalog=catalog,
            version=product_version(),
            lease_ttl_s=options.settings.lease_ttl_s,
            retry_after_s=options.settings.retry_after_s,
            is_draining=self._draining.is_set,
            is_finished=self._finished.is_set,
            has_room=lambda: room.has_room,
            evaluation=options.evaluation,
            is_pulled=lambda index: self._pullers.has(index),
            find_states=options.find_states,
            role_of=(lambda _host: None) if options.guard is None else options.guard.role_of,
            workers_validate=options.settings.spot_checks is not None and options.evaluation is None,
        )

    def _open_pullers(
        self,
        run: RunContext,
        find_local_bundle: FindLocalBundle,
        state_dir: Path,
        scenes: MutableMapping[str, SceneEntry],
    ) -> Pullers:
        layouts = None
        if isinstance(run.checker, Validator):  # evaluations use another validator and build no layouts
            check = run.checker.check_package
            layouts = LayoutStore(
                run.archive,
                state_dir,
                writer=run.ledger.writer,
                terms=run.terms,
                catalog=scenes,
                packages=run.packages,
                check=check,
                clock=run.clock,
            )
        return Pullers(
            run.archive,
            LocalLedgerClient(run.ledger.writer, run.terms, run.clock),
            fetch=lambda sid, ranges: self._router.fetch(sid, ranges),
            checker=run.checker,
            settings=run.settings,
            on_archived=self._tables.note_change,
            meters=run.meters,
            find_local_bundle=find_local_bundle,
            layouts=layouts,
        )

    def _open_request_handler(self, run: RunContext, on_joined: Callable[[Hello], None]) -> RequestHandler:
        return RequestHandler(
            run.ledger.writer,
            run.terms,
            run.clock,
            read_progress=self.progress,
            dispatch=Dispatch(self._pullers.offer),
            on_archived=self._tables.note_change,
            on_drain=self.drain,
            on_joined=on_joined,
            backlog=run.settings.backlog,
            meters=run.meters,
        )

    def _measured(self, run: RunContext) -> HealthMonitor:
        return HealthMonitor(
            run.ledger.writer,
            run.meters,
            read=run.ledger.figures,
            free_bytes=run.archive.free_bytes,
            reserve_bytes=run.settings.reserve_bytes,
            is_listening=lambda: self._router.is_open,
            sandbox=lambda: sandbox_of(run.checker),
        )


def _open_router(run: RunContext, options: CoordinatorOptions, handler: RequestHandler) -> Router:
    terms = run.terms
    return Router(
        terms.plan.run,
        options.listen,
        packages=run.packages,
        settings=run.settings,
        on_inquiry=handler.take,
        on_gone=handler.note_gone,
        guard=options.guard,
        connect=options.connect,
        files=terms.evaluation.files if terms.evaluation is not None else {},
    )

"""Gateway of a run: a router for its workers, pullers, a local archive directory and a link to the core.

Bundles are transferred to the gateway only. The core records which episodes the gateway stores, with the same fencing
as for its own episodes. The gateway has no ledger.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import structlog

from coordinator.archive.directory import DirectoryArchive
from coordinator.gateway.core import CoreLink, RemoteLedgerClient, has_owner, require_owner, write_owner
from coordinator.gateway.inventory import reconcile_directory
from coordinator.meters import Meters
from coordinator.periodic_tasks import PeriodicTasks
from coordinator.protocol.bundles import IncomingBundle
from coordinator.protocol.node import ZenohNode
from coordinator.protocol.relay import MAX_ORDERS, Join, JoinReply, Orders, OrdersRequest, RelayOrder
from coordinator.protocol.tls import Guard
from coordinator.protocol.zenoh_config import router_config
from coordinator.settings import CoordinatorSettings
from coordinator.status.health import Snapshot
from coordinator.transfer.contract import EpisodeValidator
from coordinator.transfer.puller import Pullers
from coordinator.validation.validator import Validator, sandbox_of
from schemas.errors import TransientError
from schemas.protocol.keys import BundleRange, Verb
from schemas.support.closing import Closing
from schemas.support.product import product_version

_ORDERS_S = 0.25
_SILENCE_S = 10.0

log = structlog.get_logger(__name__)


class Gateway(Closing):
    """Running gateway; a context manager. Closing it loses no data.

    Args:
        root: directory of the gateway; created, or opened with its existing files.
        name: name of the gateway at the core; with TLS the common name of its certificate.
        connect: endpoints of the core.
        listen: endpoints for workers; port 0 selects a free port.
        settings: operational settings, as for a coordinator.
        guard: TLS credentials and admission list; `None` admits every peer that can connect.
        checker: validator of bundles, closed with the gateway; by default one sandboxed child process per puller.
        stop: event that ends waiting for the core during the start.

    Raises:
        UsageError: the directory belongs to another run or gateway.
        WorldError: another process holds the directory, an endpoint is in use, or the core refuses the gateway.
        TransientError: `stop` was set before the core replied.
    """

    def __init__(
        self,
        root: Path,
        name: str,
        connect: Sequence[str],
        listen: Sequence[str],
        settings: CoordinatorSettings | None = None,
        *,
        guard: Guard | None = None,
        checker: EpisodeValidator | None = None,
        stop: threading.Event | None = None,
    ) -> None:
        self._settings = settings = settings or CoordinatorSettings()
        self._guard = guard
        self._connect = tuple(connect)
        self._closing = stop = stop or threading.Event()
        self._finished = False
        self._meters = Meters()
        self._checker = checker = checker or Validator(settings.pullers)
        with ExitStack() as stack:
            stack.callback(checker.close)
            self._archive = stack.enter_context(DirectoryArchive(root))
            self._node = stack.enter_context(self._open_node(listen))
            self._core = CoreLink(self._node, name)
            self.run = self._join(root, name, checker, stop)
            """Name of the run."""
            self._pullers = stack.enter_context(self._open_pullers(checker))
            stack.callback(checker.close)  # before the pullers end, so they do not wait for a long validation
            stack.callback(stop.set)
            self._periodic_tasks = stack.enter_context(self._open_periodic_tasks())
            self._stack = stack.pop_all()
        log.info("gateway_started", run=self.run, name=name, endpoints=self.endpoints, directory=str(root))

    @property
    def endpoints(self) -> tuple[str, ...]:
        """Endpoints for workers."""
        return self._node.endpoints

    def require_no_fault(self) -> None:
        """Raises `RuntimeError` if the gateway fails by an error of this software that repetition cannot change."""
        self._pullers.require_no_fault()
        self._periodic_tasks.require_no_fault()

    @property
    def is_finished(self) -> bool:
        """Whether the run was finished when the core answered last."""
        return self._finished

    def is_alive(self) -> bool:
        """Returns whether the thread that fetches orders runs; if it has ended, restart the process."""
        return self._periodic_tasks.is_alive

    def troubles(self) -> tuple[str, ...]:
        """Returns the reasons why the gateway cannot serve now; empty if it can.

        A full disk is not such a reason: workers must stay connected to deliver their bundles.
        """
        findings = [] if self._node.is_open else ["not listening to workers"]
        if self._core.silence_s > _SILENCE_S:
            findings.append(f"the core has not answered for {self._core.silence_s:.0f} s")
        return tuple(findings)

    def snapshot(self) -> Snapshot:
        """Returns the metrics of the gateway; the metrics of the run are available from the core."""
        return Snapshot(
            progress=None,
            frames=0,
            sums=self._meters.sums(),
            requests=self._meters.requests(),
            free_bytes=self._archive.free_bytes(),
            reserve_bytes=self._settings.reserve_bytes,
            backlog=self._pullers.waiting,
            sandbox=sandbox_of(self._checker),
        )

    def close(self) -> None:
        """Stops fetching orders, stops transfers at the next chunk and releases the directory."""
        self._stack.close()

    def _open_node(self, listen: Sequence[str]) -> ZenohNode:
        guard, lease_s = self._guard, self._settings.transport_lease_s
        files = guard.files if guard is not None else None
        return ZenohNode(
            listen,
            lambda endpoints, admitted: router_config(
                endpoints, lease_s, tls=files, admitted=admitted, connect=self._connect
            ),
            guard.admitted if guard is not None else dict,
        )

    def _join(self, root: Path, name: str, checker: EpisodeValidator, stop: threading.Event) -> str:
        """Joins the run of the core and reconciles the directory with the ledger."""
        join = Join(version=product_version(), router=self._node.router_id)
        terms = self._core.request_until_reply(Verb.JOIN, join, JoinReply, stop)
        is_new = not has_owner(root)
        require_owner(root, terms.run, name)
        self._core.run = terms.run
        reconcile_directory(self._archive, self._core, checker, stop, is_new=is_new)
        write_owner(root, terms.run, name)
        return terms.run

    def _open_pullers(self, checker: EpisodeValidator) -> Pullers:
        return Pullers(
            self._archive,
            RemoteLedgerClient(self._core, self._archive, self._closing),
            fetch=self._fetch,
            checker=checker,
            settings=self._settings,
            on_archived=lambda: None,
            meters=self._meters,
        )

    def _fetch(self, sid: str, ranges: Sequence[BundleRange]) -> bytes:
        return self._node.fetch(self.run, sid, ranges, self._settings.pull_timeout_s)

    def _open_periodic_tasks(self) -> PeriodicTasks:
        return PeriodicTasks(
            {"fetch_orders": (_ORDERS_S, self._fetch_orders), "admit": (self._settings.admission_s, self._admit)}
        )

    def _fetch_orders(self) -> None:
        """Fetches orders; with too little free space it requests none, and only reports that it runs."""
        has_room = self._archive.free_bytes() >= self._settings.reserve_bytes
        free = max(0, MAX_ORDERS - self._pullers.waiting) if has_room else 0
        duty = OrdersRequest(router=self._node.router_id, most=free, busy=self._pullers.busy_hosts)
        try:
            reply = self._core.ask(Verb.ORDERS, duty, Orders)
        except TransientError as error:
            log.debug("no_orders", error=str(error))
            return
        self._finished = reply.finished
        for order in reply.orders:
            self._pullers.offer(_bundle_of(order))

    def _admit(self) -> None:
        if self._node.admit():
            log.warning("admission_changed", remedy="none; workers reconnect within seconds")


def _bundle_of(order: RelayOrder) -> IncomingBundle:
    return IncomingBundle(
        order.lease, order.sid, sha256=order.sha256, size=order.size, job=order.job, candidates=order.candidates
    )

"""Handles the requests that the router receives: parses them, queues them for the ledger and replies after COMMIT.

The module does not block. It receives requests in zenoh's threads and replies in the writer's answering thread. The
number and size of waiting requests are limited, in total and per host.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import datetime
from functools import partial

import structlog
from sqlalchemy.exc import SQLAlchemyError

from coordinator.ledger import claims, hosts
from coordinator.ledger.database.writer import Writer
from coordinator.meters import Meter, Meters
from coordinator.protocol.dispatch import Dispatch
from coordinator.protocol.protocol import ParsedRequest, ProtocolAnswer, Terms, parse, serve
from coordinator.protocol.relay import Archived, InventoryReply, Join, JoinReply, OrdersRequest
from coordinator.protocol.relay_handlers import RELAY_MESSAGES, orders_for, serve_gateway
from coordinator.protocol.router import Inquiry
from schemas.errors import TransientError
from schemas.protocol.administration import AdminAction, AdminRequest
from schemas.protocol.keys import Verb
from schemas.protocol.messages import Ack, ClaimReply, Hello, HelloReply, Refusal
from schemas.protocol.status import Progress
from schemas.support.closing import Closing
from schemas.support.log_limit import LogLimit, Repeated, describe_error

_HOST_SHARE = 8
"""The limits of one host are the total limits divided by this number, so a few busy hosts cannot use up the total."""
_READS_WAITING = 16
_WAITING_BYTES = 16 << 20
"""Maximum total size of messages that wait for the ledger, bytes; a parsed message takes ten times as much memory."""
_VERBS = frozenset(verb.value for verb in Verb)

log = structlog.get_logger(__name__)


class Load:
    """Thread-safe counter of waiting requests.

    Args:
        requests: maximum number of waiting requests in total.
        octets: maximum size of waiting messages in total, bytes.
    """

    def __init__(self, requests: int, octets: int) -> None:
        self._most = (requests, octets)
        self._host_most = (max(1, requests // _HOST_SHARE), octets // _HOST_SHARE)
        self._guard = threading.Lock()
        self._requests: Counter[str] = Counter()
        self._octets: Counter[str] = Counter()
        self._all_octets = 0
        self._all_requests = 0

    def enter(self, host: str, octets: int) -> bool:
        """Adds a request; returns `False` if a limit is reached."""
        with self._guard:
            if self._all_requests >= self._most[0] or self._all_octets + octets > self._most[1]:
                return False
            if self._requests[host] >= self._host_most[0] or self._octets[host] + octets > self._host_most[1]:
                return False
            self._requests[host] += 1
            self._octets[host] += octets
            self._all_requests += 1
            self._all_octets += octets
            return True

    def leave(self, host: str, octets: int) -> None:
        """Removes a request that was added."""
        with self._guard:
            self._requests[host] -= 1
            self._octets[host] -= octets
            self._all_requests -= 1
            self._all_octets -= octets
            if not self._requests[host]:
                del self._requests[host], self._octets[host]


class RequestHandler(Closing):
    """Request handler between router and ledger writer; a context manager.

    Args:
        writer: writer of the ledger.
        terms: terms of the run.
        clock: wall clock.
        read_progress: function that reads the progress from the ledger; runs in a separate thread.
        dispatch: assignment of announced bundles to gateways.
        on_archived: callback after a gateway archived or lost an episode.
        on_drain: callback after a drain request.
        on_joined: callback after the first registration of a worker.
        backlog: maximum number of waiting requests, an eighth of them per host. Further requests get no reply and are
            repeated by the client.
        meters: counters of requests.
    """

    def __init__(
        self,
        writer: Writer,
        terms: Terms,
        clock: Callable[[], datetime],
        *,
        read_progress: Callable[[], Progress],
        dispatch: Dispatch,
        on_archived: Callable[[], None],
        on_drain: Callable[[], None],
        on_joined: Callable[[Hello], None],
        backlog: int,
        meters: Meters | None = None,
    ) -> None:
        self._writer = writer
        self._terms = terms
        self._clock = clock
        self._read_progress = read_progress
        self._dispatch = dispatch
        self._on_archived = on_archived
        self._on_drain, self._on_joined = on_drain, on_joined
        self._backlog = backlog
        self._meters = meters or Meters()
        self._reads = ThreadPoolExecutor(1, thread_name_prefix="ledger-reader")
        self._unread = Repeated(log, "read_failed", (SQLAlchemyError,))
        self._failing = {
            str(verb): Repeated(log.bind(verb=verb), "request_failed", (SQLAlchemyError,)) for verb in _VERBS
        }
        self._free_reads = threading.Semaphore(_READS_WAITING)
        self._load = Load(backlog, _WAITING_BYTES)
        self._limit = LogLimit()
        self._joined: set[str] = set()
        """Sessions whose registration was logged."""

    def take(self, inquiry: Inquiry) -> None:
        """Accepts a request; the reply follows when the result is durable. Does not raise."""
        try:
            if inquiry.verb in _VERBS:
                self._meters.note_request(inquiry.verb)
            if inquiry.verb == Verb.PROGRESS:
                self._take_read(inquiry)
            else:
                self._take_message(inquiry)
        except Exception as error:  # noqa: BLE001 - runs in zenoh's thread, which serves others too
            self._fail(inquiry, error)

    def note_gone(self, sid: str) -> None:
        """Shortens the leases of a worker whose connection closed; the worker may reconnect."""
        if self._writer.backlog > self._backlog:
            return  # the leases expire later without this request
        hint_s = self._terms.lease_ttl_s / 2
        self._writer.submit(lambda connection: claims.shorten(connection, sid, self._clock(), hint_s))

    def require_no_fault(self) -> None:
        """Raises `RuntimeError` if a verb fails by an error of this software; see `Repeated.require_no_fault`."""
        for failing in (*self._failing.values(), self._unread):
            failing.require_no_fault()

    def close(self) -> None:
        """Ends the reading thread."""
        self._reads.shutdown(cancel_futures=True)

    def _take_message(self, inquiry: Inquiry) -> None:
        is_relay = inquiry.verb in RELAY_MESSAGES
        request = parse(inquiry.verb, inquiry.host, inquiry.payload, RELAY_MESSAGES if is_relay else None)
        if isinstance(request, Refusal):
            self._log(log.info, "refused", inquiry, reason=request.error)
            inquiry.answer(request)
            return
        if isinstance(request.message, OrdersRequest):
            duty = request.message
            orders = self._dispatch.take(request.host, duty.router, duty.most, duty.busy)
            inquiry.answer(orders_for(orders, finished=self._terms.is_finished()))
            return
        octets = len(inquiry.payload)
        if self._writer.backlog > self._backlog or not self._load.enter(request.host, octets):
            inquiry.drop()
            return
        do = serve_gateway if is_relay else serve
        future = self._writer.submit(lambda connection: do(connection, request, self._terms, self._clock()))
        future.add_done_callback(partial(self._reply, inquiry, request, octets))

    def _reply(self, inquiry: Inquiry, request: ParsedRequest, octets: int, future: Future[ProtocolAnswer]) -> None:
        """Sends the reply in the answering thread. An error of one request does not affect the next."""
        self._load.leave(request.host, octets)
        error = future.exception()
        try:
            if isinstance(error, TransientError):
                inquiry.drop()
            elif error is not None:
                self._fail(inquiry, error)
            else:
                self._answer(inquiry, request, future.result())
                if inquiry.verb in self._failing:
                    self._failing[inquiry.verb].succeed()
        except Exception as unforeseen:  # noqa: BLE001 - see above
            self._fail(inquiry, unforeseen)

    def _answer(self, inquiry: Inquiry, request: ParsedRequest, answer: ProtocolAnswer) -> None:
        if isinstance(request.message, AdminRequest):
            self._handle_admin(request.message)
        if isinstance(request.message, Join) and isinstance(answer.reply, JoinReply):
            self._dispatch.take(request.host, request.message.router, 0)
        if _changes_tables(request, answer):
            self._on_archived()
        if isinstance(answer.reply, ClaimReply) and answer.reply.job is not None:
            self._meters.add(Meter.CLAIMS)
        inquiry.answer(answer.reply)
        for bundle in answer.bundles:
            self._dispatch.offer(bundle)
        if isinstance(request.message, Hello) and isinstance(answer.reply, HelloReply):
            self._note_joined(request.message)

    def _note_joined(self, hello: Hello) -> None:
        """Logs and reports the first registration of a session. Workers repeat their registration."""
        if hello.sid in self._joined:
            return
        if len(self._joined) >= hosts.SESSIONS:
            self._joined.clear()
        self._joined.add(hello.sid)
        log.info("worker_joined", host=hello.host, worker=hello.sid, cores=hello.slots)
        self._on_joined(hello)

    def _fail(self, inquiry: Inquiry, error: BaseException) -> None:
        if inquiry.verb in self._failing:
            self._failing[inquiry.verb].fail(error, host=inquiry.host)
        else:
            self._log(log.error, "request_failed", inquiry, error=describe_error(error))
        inquiry.answer(Refusal(error=f"{inquiry.verb}: the coordinator failed to process it; see its log"))

    def _log(self, write: Callable[..., None], event: str, inquiry: Inquiry, **fields: object) -> None:
        self._limit.write(write, event, inquiry.host, host=inquiry.host, verb=inquiry.verb, **fields)

    def _handle_admin(self, request: AdminRequest) -> None:
        log.info("operator", action=request.action, episodes=len(request.indices) or "all")
        if request.action is AdminAction.DRAIN:
            self._on_drain()

    def _take_read(self, inquiry: Inquiry) -> None:
        if not self._free_reads.acquire(blocking=False):
            inquiry.drop()
            return
        self._reads.submit(self._read_progress).add_done_callback(partial(self._answer_read, inquiry))

    def _answer_read(self, inquiry: Inquiry, future: Future[Progress]) -> None:
        self._free_reads.release()
        if future.cancelled():
            inquiry.drop()
        elif (error := future.exception()) is not None:
            self._unread.fail(error, verb=inquiry.verb)
            inquiry.drop()
        else:
            self._unread.succeed()
            inquiry.answer(future.result())


def _changes_tables(request: ParsedRequest, answer: ProtocolAnswer) -> bool:
    """Returns whether a gateway archived or lost an episode."""
    if isinstance(request.message, Archived):
        return answer.reply == Ack(accepted=True)
    return isinstance(answer.reply, InventoryReply) and bool(answer.reply.lost)

"""Manages a zenoh router session: listens, requests chunks from workers, and reopens when the admission list changes.

The module does not interpret messages. Access control is part of the configuration that the caller provides.
"""

from __future__ import annotations

import os
import resource
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence

import structlog
import zenoh

from coordinator.protocol.ask import query
from schemas.errors import TransientError, WorldError
from schemas.protocol.identity import Role
from schemas.protocol.keys import BundleRange, bundle_selector
from schemas.support.closing import Closing

Admitted = Mapping[str, Role]
Configure = Callable[[Sequence[str], Admitted], zenoh.Config]
"""Function of endpoints and admission list that returns the configuration."""

_THREADS = "(rx: (worker_threads: 8), acc: (worker_threads: 32))"
"""Numbers of threads of zenoh's runtimes; by default, two threads receive and one accepts. A client that stops reading
can block a receiving thread, so two such clients would stop all receiving. An accepting thread waits for the peer when
it closes a connection without a handshake; a single thread closed 150 such connections per second."""
_ANY_PORT = ":0"
_PORT_TRIES = 5
_REOPEN_PAUSE_S = 0.2

log = structlog.get_logger(__name__)


class ZenohNode(Closing):
    """Open router session; a context manager.

    Args:
        listen: endpoints; port 0 selects a free port.
        configure: function that returns the configuration; called each time the session is opened.
        admitted: function that returns the current admission list.
        declare: function that declares queryables and subscribers on a new session; by default none.

    Raises:
        WorldError: an endpoint cannot be listened on.
    """

    def __init__(
        self,
        listen: Sequence[str],
        configure: Configure,
        admitted: Callable[[], Admitted],
        declare: Callable[[zenoh.Session], None] = lambda _session: None,
    ) -> None:
        os.environ.setdefault("ZENOH_RUNTIME", _THREADS)
        _raise_file_limit()
        self._configure = configure
        self._read_admitted = admitted
        self._declare = declare
        self._admitted = admitted()
        self._opening = threading.Lock()
        self.endpoints, self._session = _listen(listen, lambda endpoints: configure(endpoints, self._admitted))
        """Endpoints with their actual ports."""
        self._declare(self._session)

    @property
    def is_open(self) -> bool:
        return not self._session.is_closed()

    @property
    def router_id(self) -> str:
        """zenoh id of the session."""
        return str(self._session.zid())

    def ask(self, selector: str, payload: str | None, timeout_s: float) -> Iterator[bytes]:
        """Sends a query and yields the replies; without a reply the outcome is unknown."""
        try:
            yield from query(self._session, selector, payload, timeout_s)
        except zenoh.ZError as error:
            log.debug("ask_failed", selector=selector, error=str(error))

    def fetch(self, run: str, sid: str, ranges: Sequence[BundleRange], timeout_s: float) -> bytes:
        """Requests ranges of spooled bundles from a worker, in one reply.

        There is no retry, so a frozen worker does not block a puller.

        Raises:
            TransientError: no reply arrived in time, or the reply has the wrong length.
        """
        length = sum(each.chunk.length for each in ranges)
        for data in self.ask(bundle_selector(run, sid, ranges), None, timeout_s):
            if len(data) == length:
                return data
        first, more = ranges[0], f" and {len(ranges) - 1} other jobs" if len(ranges) > 1 else ""
        raise TransientError(
            f"worker {sid} does not serve bytes {first.chunk.offset}+{first.chunk.length} of job {first.job_id}{more}"
        )

    def admit(self) -> bool:
        """Reopens the session if it is closed or the admission list has changed; workers reconnect automatically.

        Returns:
            Whether the session was reopened.

        Raises:
            UsageError: the list is invalid; the previous list stays in force.
            WorldError: the endpoints cannot be listened on now; retry later.
        """
        admitted = self._read_admitted()
        if admitted == self._admitted and self.is_open:
            return False
        self._admitted = admitted
        self.reopen()
        return True

    def reopen(self) -> None:
        """Reopens the session on the same endpoints; peers reconnect automatically.

        Raises:
            WorldError: the endpoints cannot be listened on now; retry later.
        """
        with self._opening:
            if self.is_open:
                self._session.close()
            self._session = _reopen(self.endpoints, lambda endpoints: self._configure(endpoints, self._admitted))
            self._declare(self._session)

    def close(self) -> None:
        """Closes the session and its zenoh threads."""
        with self._opening:
            if self.is_open:
                self._session.close()


Open = Callable[[Sequence[str]], zenoh.Config]


def _listen(wanted: Sequence[str], configure: Open) -> tuple[tuple[str, ...], zenoh.Session]:
    for trial in range(_PORT_TRIES):
        endpoints = tuple(_with_port(endpoint) for endpoint in wanted)
        try:
            return endpoints, zenoh.open(configure(endpoints))
        except zenoh.ZError as error:
            # another process may take the free port before the session listens on it
            if endpoints == tuple(wanted) or trial + 1 == _PORT_TRIES:
                named, reason = ", ".join(endpoints), str(error).split(" at /")[0]  # without zenoh's source paths
                raise WorldError(
                    f"cannot listen on {named}: {reason}; if another coordinator is running there, stop it, or give "
                    "another endpoint with --listen"
                ) from error
    raise AssertionError("unreachable")


def _reopen(endpoints: Sequence[str], configure: Open) -> zenoh.Session:
    for trial in range(_PORT_TRIES):
        try:
            return zenoh.open(configure(endpoints))
        except zenoh.ZError as error:
            if trial + 1 == _PORT_TRIES:
                raise WorldError(f"cannot listen on {', '.join(endpoints)} again: {error}") from error
            time.sleep(_REOPEN_PAUSE_S)
    raise AssertionError("unreachable")


def _with_port(endpoint: str) -> str:
    if not endpoint.endswith(_ANY_PORT):
        return endpoint
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"{endpoint.removesuffix(_ANY_PORT)}:{probe.getsockname()[1]}"


def _raise_file_limit() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < hard:
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))

"""One zenoh session that is a router: listens, asks workers for chunks, and opens anew when others are admitted.

Declares what it is told to and reads no message; who may do what stands in the configuration it is given.
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

from schemas.errors import TransientError, WorldError
from schemas.identity import Role
from schemas.keys import Chunk, bundle_selector
from schemas.support.closing import Closing
from schemas.wire import Lease

__all__ = ["Admitted", "Configure", "ZenohNode"]

Admitted = Mapping[str, Role]
Configure = Callable[[Sequence[str], Admitted], zenoh.Config]
"""(endpoints to listen on, who is admitted) -> configuration."""

_THREADS = "(rx: (worker_threads: 8), acc: (worker_threads: 32))"
"""Threads of zenoh's runtimes. Two receiving threads freeze when two clients block. An accepting thread waits for the
peer whenever it closes a connection that made no handshake; a single one closed 150 such connections a second."""
_ANY_PORT = ":0"
_PORT_TRIES = 5
_REOPEN_PAUSE_S = 0.2

log = structlog.get_logger(__name__)


class ZenohNode(Closing):
    """An open router session; a context manager.

    Args:
        listen: endpoints; port 0 takes a free one.
        configure: gives the session's configuration, again whenever it is opened.
        admitted: looks who is admitted now.
        declare: declares on a fresh session what it serves; by default nothing.

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
        self._look_admitted = admitted
        self._declare = declare
        self._admitted = admitted()
        self._opening = threading.Lock()
        self.endpoints, self._session = _listen(listen, lambda endpoints: configure(endpoints, self._admitted))
        """Endpoints in force, with their ports."""
        self._declare(self._session)

    @property
    def is_open(self) -> bool:
        """Whether others can be heard."""
        return not self._session.is_closed()

    @property
    def router_id(self) -> str:
        """Zenoh's id of the session: what those who are connected to it know it by."""
        return str(self._session.zid())

    def ask(self, selector: str, payload: str | None, timeout_s: float) -> Iterator[bytes]:
        """Yields the answers to a question as they come; none means unknown."""
        try:
            replies = self._session.get(
                selector,
                zenoh.handlers.FifoChannel(4),
                payload=payload,
                timeout=timeout_s,
                consolidation=zenoh.ConsolidationMode.NONE,
            )
            for reply in replies:
                if reply.ok is not None:
                    yield reply.ok.payload.to_bytes()
        except zenoh.ZError as error:
            log.debug("ask_failed", selector=selector, error=str(error))

    def fetch(self, run: str, sid: str, lease: Lease, chunk: Chunk, timeout_s: float) -> bytes:
        """Asks a worker for a part of a spooled bundle; never tries twice, so that no puller hangs on a frozen worker.

        Raises:
            TransientError: no answer in time, or not the bytes asked for.
        """
        for data in self.ask(bundle_selector(run, sid, lease, chunk), None, timeout_s):
            if len(data) == chunk.length:
                return data
        raise TransientError(f"worker {sid} does not serve bytes {chunk.offset}+{chunk.length} of job {lease.job_id}")

    def admit(self) -> bool:
        """Opens the session anew when who is admitted has changed; workers come back by themselves.

        Returns:
            Whether it did.

        Raises:
            UsageError: the list cannot be understood; those admitted before stay so.
            WorldError: the endpoints cannot be listened on now; ask again.
        """
        admitted = self._look_admitted()
        if admitted == self._admitted and self.is_open:
            return False
        self._admitted = admitted
        self.reopen()
        return True

    def reopen(self) -> None:
        """Opens the session anew under the same endpoints; who was connected comes back by himself.

        Raises:
            WorldError: the endpoints cannot be listened on now; ask again.
        """
        with self._opening:
            if self.is_open:
                self._session.close()
            self._session = _reopen(self.endpoints, lambda endpoints: self._configure(endpoints, self._admitted))
            self._declare(self._session)

    def close(self) -> None:
        """Closes the session; what zenoh runs in threads ends with it."""
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
            # between choosing a free port and listening on it somebody else may take it
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

"""The coordinator's door to zenoh: its session is the router, its callbacks only hand over, its pulls ask for chunks.

Reads no message and knows no ledger; whatever came in is bytes until `protocol.parse` has seen it.
"""

from __future__ import annotations

import os
import resource
import socket
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Self

import structlog
import zenoh

from coordinator.catalog import Catalog
from coordinator.settings import CoordinatorSettings
from coordinator.tls import Guard
from coordinator.zenoh_config import router_config
from schemas.base import Model
from schemas.errors import TransientError, WorldError
from schemas.keys import (
    Chunk,
    Verb,
    alive_pattern,
    bundle_selector,
    parse_chunk,
    scene_key,
    scene_pattern,
    sid_of_alive_key,
    verb_key,
    verb_pattern,
)
from schemas.wire import Lease

__all__ = ["Inquiry", "Router"]

_RX_THREADS = "(rx: (worker_threads: 8))"
_ANY_PORT = ":0"
_PORT_TRIES = 5
_REOPEN_PAUSE_S = 0.2
_VERBS = frozenset(verb.value for verb in Verb)

log = structlog.get_logger(__name__)


class Inquiry:
    """One question from outside; it is answered once or dropped, which the asker sees as unknown."""

    def __init__(self, run: str, query: zenoh.Query) -> None:
        *_, self.host, self.verb = str(query.key_expr).split("/")
        self.payload = query.payload.to_bytes() if query.payload is not None else b""
        self._run = run
        self._query = query

    def answer(self, reply: Model) -> None:
        """Sends the reply; an asker that is gone is no error."""
        # a client that does not know the run asks under a wildcard, but the reply needs a plain key
        key = verb_key(self._run, self.host, Verb(self.verb)) if self.verb in _VERBS else str(self._query.key_expr)
        try:
            with self._query:
                self._query.reply(key, reply.model_dump_json())
        except zenoh.ZError as error:
            log.debug("asker_gone", host=self.host, verb=self.verb, error=str(error))

    def drop(self) -> None:
        """Leaves the question unanswered; the asker repeats it."""
        self._query.drop()


class Router:
    """An open router session; a context manager.

    Args:
        run: name of the run in every key.
        listen: endpoints; port 0 takes a free one.
        catalog: scenes to serve.
        settings: the coordinator's.
        on_inquiry: takes a question and must not block.
        on_gone: takes the session id of a worker whose link has closed, and must not block.
        guard: certificates and who is admitted; `None` lets in whoever can connect.

    Raises:
        WorldError: an endpoint cannot be listened on.
    """

    def __init__(
        self,
        run: str,
        listen: Sequence[str],
        catalog: Catalog,
        settings: CoordinatorSettings,
        on_inquiry: Callable[[Inquiry], None],
        on_gone: Callable[[str], None],
        guard: Guard | None = None,
    ) -> None:
        self._run = run
        self._timeout_s = settings.pull_timeout_s
        self._on_inquiry = on_inquiry
        self._on_gone = on_gone
        self._scenes = _open_scenes(run, catalog)
        os.environ.setdefault("ZENOH_RUNTIME", _RX_THREADS)  # two receiving threads freeze when two clients block
        _raise_file_limit()
        self._settings = settings
        self._guard = guard
        self._admitted = guard.admitted() if guard is not None else {}
        self._opening = threading.Lock()
        self.endpoints, self._session = _listen(listen, self._config)
        """Endpoints in force, with their ports."""
        self._declare()

    def fetch(self, sid: str, lease: Lease, chunk: Chunk) -> bytes:
        """Asks a worker for a part of a spooled bundle; never tries twice, so that no puller hangs on a frozen worker.

        Raises:
            TransientError: no answer in time, or not the bytes asked for.
        """
        try:
            replies = self._session.get(
                bundle_selector(self._run, sid, lease, chunk),
                zenoh.handlers.FifoChannel(4),
                timeout=self._timeout_s,
                consolidation=zenoh.ConsolidationMode.NONE,
            )
            for reply in replies:
                if reply.ok is not None and len(reply.ok.payload) == chunk.length:
                    return reply.ok.payload.to_bytes()
        except zenoh.ZError as error:
            raise TransientError(f"worker {sid} cannot be asked: {error}") from error
        raise TransientError(f"worker {sid} does not serve bytes {chunk.offset}+{chunk.length} of job {lease.job_id}")

    @property
    def is_open(self) -> bool:
        """Whether workers can be heard."""
        return not self._session.is_closed()

    def admit(self) -> bool:
        """Opens the session anew when who is admitted has changed; workers come back by themselves.

        Returns:
            Whether it did.

        Raises:
            UsageError: the list cannot be understood; those admitted before stay so.
            WorldError: the endpoints cannot be listened on now; ask again.
        """
        admitted = self._guard.admitted() if self._guard is not None else {}
        if admitted == self._admitted and self.is_open:
            return False
        with self._opening:
            self._admitted = admitted
            self._session.close()
            self._session = _reopen(self.endpoints, self._config)
            self._declare()
        return True

    def close(self) -> None:
        """Closes the session; what zenoh runs in threads ends with it."""
        with self._opening:
            if not self._session.is_closed():
                self._session.close()
        for descriptor in self._scenes.values():
            os.close(descriptor)
        self._scenes = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _config(self, endpoints: Sequence[str]) -> zenoh.Config:
        files = self._guard.files if self._guard is not None else None
        return router_config(endpoints, self._settings.transport_lease_s, files, self._admitted)

    def _declare(self) -> None:
        self._session.declare_queryable(verb_pattern(self._run), self._take)
        self._session.declare_queryable(scene_pattern(self._run), self._serve_scene)
        self._session.liveliness().declare_subscriber(alive_pattern(self._run), self._note_token)

    def _take(self, query: zenoh.Query) -> None:
        self._on_inquiry(Inquiry(self._run, query))

    def _note_token(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.DELETE:
            self._on_gone(sid_of_alive_key(str(sample.key_expr)))

    def _serve_scene(self, query: zenoh.Query) -> None:
        with query:
            key = str(query.key_expr)
            descriptor = self._scenes.get(key)
            if descriptor is None:
                query.reply_err(f"no scene {key}")
                return
            try:
                chunk = parse_chunk({name: query.parameters.get(name) or "" for name in ("off", "n")})
            except ValueError as error:
                query.reply_err(str(error))
                return
            query.reply(key, os.pread(descriptor, chunk.length, chunk.offset))


def _open_scenes(run: str, catalog: Catalog) -> Mapping[str, int]:
    return {scene_key(run, entry.sha256): os.open(entry.path, os.O_RDONLY | os.O_CLOEXEC) for entry in catalog.values()}


Configure = Callable[[Sequence[str]], zenoh.Config]


def _listen(wanted: Sequence[str], configure: Configure) -> tuple[tuple[str, ...], zenoh.Session]:
    for trial in range(_PORT_TRIES):
        endpoints = tuple(_with_port(endpoint) for endpoint in wanted)
        try:
            return endpoints, zenoh.open(configure(endpoints))
        except zenoh.ZError as error:
            # between choosing a free port and listening on it somebody else may take it
            if endpoints == tuple(wanted) or trial + 1 == _PORT_TRIES:
                named, reason = ", ".join(endpoints), str(error).split(" at /")[0]  # without zenoh's source paths
                raise WorldError(
                    f"cannot listen on {named}: {reason}; is another coordinator running there? Stop it, or give "
                    "another endpoint with --listen"
                ) from error
    raise AssertionError("unreachable")


def _reopen(endpoints: Sequence[str], configure: Configure) -> zenoh.Session:
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

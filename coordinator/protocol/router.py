"""Connects the coordinator to zenoh: declares its queryables, serves scene files and requests chunks from workers.

The module does not parse messages and does not access the ledger; `protocol.parse` validates the received bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import structlog
import zenoh

from coordinator.protocol.node import Admitted, ZenohNode
from coordinator.protocol.tls import Guard
from coordinator.protocol.zenoh_config import router_config
from coordinator.settings import CoordinatorSettings
from schemas.base import Model
from schemas.protocol.keys import (
    BundleRange,
    Verb,
    alive_pattern,
    parse_chunk,
    scene_key,
    scene_pattern,
    sid_of_alive_key,
    verb_key,
    verb_pattern,
)
from schemas.support.closing import Closing

MAX_KEY_CHARS = 400
"""Maximum length of a request key, characters; the keys of this software have at most 300."""

_MAX_PRESENT = 10_000
_VERBS = frozenset(verb.value for verb in Verb)

log = structlog.get_logger(__name__)


class Inquiry:
    """Received request. It gets one reply or is dropped; the outcome of a dropped request is unknown to the client."""

    def __init__(self, run: str, query: zenoh.Query) -> None:
        *_, self.host, self.verb = str(query.key_expr).split("/")
        self.payload = query.payload.to_bytes() if query.payload is not None else b""
        self._run = run
        self._query = query
        self._is_open = True

    def answer(self, reply: Model) -> None:
        """Sends the reply unless one was sent already. A disconnected client is not an error."""
        if not self._is_open:
            return
        self._is_open = False
        # a client that does not know the run sends a wildcard key, but the reply needs a concrete key
        key = verb_key(self._run, self.host, Verb(self.verb)) if self.verb in _VERBS else str(self._query.key_expr)
        try:
            with self._query:
                self._query.reply(key, reply.model_dump_json())
        except zenoh.ZError as error:
            log.debug("client_gone", host=self.host, verb=self.verb, error=str(error))

    def drop(self) -> None:
        """Drops the request without a reply; the client repeats it."""
        self._is_open = False
        self._query.drop()


class Router(Closing):
    """Open router session of the coordinator; a context manager.

    Args:
        run: name of the run, part of every key.
        listen: endpoints; port 0 selects a free port.
        packages: scenes that are served to workers, by SHA-256; the mapping may grow.
        settings: settings of the coordinator.
        on_inquiry: callback for a received request; must not block.
        on_gone: callback with the session id of a worker whose connection closed; must not block.
        guard: TLS credentials and admission list; `None` admits every peer that can connect.
        connect: endpoints of other routers, whose workers are reachable too.
        files: additional served files by SHA-256.

    Raises:
        WorldError: an endpoint cannot be listened on.
    """

    def __init__(
        self,
        run: str,
        listen: Sequence[str],
        packages: Mapping[str, Path],
        settings: CoordinatorSettings,
        on_inquiry: Callable[[Inquiry], None],
        on_gone: Callable[[str], None],
        guard: Guard | None = None,
        connect: Sequence[str] = (),
        files: Mapping[str, Path] | None = None,
    ) -> None:
        self._run = run
        self._connect = tuple(connect)
        self._on_inquiry = on_inquiry
        self._on_gone = on_gone
        self._packages = packages
        self._files = files or {}
        self._settings = settings
        self._guard = guard
        self._present: set[str] = set()
        self._node = ZenohNode(listen, self._config, guard.admitted if guard is not None else dict, self._declare)
        self.endpoints = self._node.endpoints
        """Endpoints with their actual ports."""

    def fetch(self, sid: str, ranges: Sequence[BundleRange]) -> bytes:
        """Returns ranges of bundles in a worker's spool; see `ZenohNode.fetch`."""
        return self._node.fetch(self._run, sid, ranges, self._settings.pull_timeout_s)

    @property
    def is_open(self) -> bool:
        return self._node.is_open

    @property
    def present(self) -> int:
        """Number of connected workers."""
        return len(self._present)

    def admit(self) -> bool:
        """Reopens the session if the admission list has changed; see `ZenohNode.admit`."""
        return self._node.admit()

    def close(self) -> None:
        self._node.close()

    def _config(self, endpoints: Sequence[str], admitted: Admitted) -> zenoh.Config:
        files = self._guard.files if self._guard is not None else None
        return router_config(
            endpoints, self._settings.transport_lease_s, tls=files, admitted=admitted, connect=self._connect
        )

    def _declare(self, session: zenoh.Session) -> None:
        self._present.clear()  # workers that reconnect to a new session declare their liveliness token again
        session.declare_queryable(verb_pattern(self._run), self._take)
        session.declare_queryable(scene_pattern(self._run), self._serve_scene)
        session.liveliness().declare_subscriber(alive_pattern(self._run), self._on_token)

    def _take(self, query: zenoh.Query) -> None:
        if self._is_key_short(query):
            self._on_inquiry(Inquiry(self._run, query))

    def _on_token(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        if len(key) > MAX_KEY_CHARS:
            return
        sid = sid_of_alive_key(key)
        if sample.kind == zenoh.SampleKind.DELETE:
            self._present.discard(sid)
            self._on_gone(sid)
        elif len(self._present) < _MAX_PRESENT:
            self._present.add(sid)

    @staticmethod
    def _is_key_short(query: zenoh.Query) -> bool:
        length = len(str(query.key_expr))
        if length <= MAX_KEY_CHARS:
            return True
        with query:
            query.reply_err(f"the key has {length} characters; at most {MAX_KEY_CHARS} are allowed")
        return False

    def _serve_scene(self, query: zenoh.Query) -> None:
        if not self._is_key_short(query):
            return
        with query:
            key = str(query.key_expr)
            sha256 = key.rpartition("/")[2]
            path = self._packages.get(sha256) or self._files.get(sha256)
            if path is None or key != scene_key(self._run, sha256):
                query.reply_err(f"no scene {key}")
                return
            try:
                chunk = parse_chunk({name: query.parameters.get(name) or "" for name in ("off", "n")})
                with path.open("rb", buffering=0) as file:
                    file.seek(chunk.offset)
                    data = file.read(chunk.length)
            except (OSError, ValueError) as error:
                query.reply_err(str(error))
                return
            query.reply(key, data)

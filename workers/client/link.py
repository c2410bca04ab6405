"""Zenoh client session of a worker: sends requests, fetches scenes and serves the spool.

Design: docs/design/protocol.md.

Does not handle missing answers: a request without a reply returns `None` for every cause, and the caller decides.
"""

from __future__ import annotations

import json
import random
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import structlog
import zenoh
from pydantic import ValidationError

from schemas.base import Model
from schemas.errors import RunFinished, WorldError
from schemas.protocol.address_file import find_endpoints
from schemas.protocol.identity import Role, TlsFiles
from schemas.protocol.keys import (
    RANGE_FIELDS,
    BundleRange,
    Chunk,
    Verb,
    alive_key,
    any_hello_key,
    bundle_key,
    parse_bundle_ranges,
    scene_selector,
    verb_key,
)
from schemas.protocol.messages import MAX_MESSAGE_BYTES, Hello, HelloReply, Ping, Pong, Refusal
from schemas.protocol.reachability import why_unreachable
from schemas.support.closing import Closing
from schemas.support.log_limit import LogLimit, Repeated

R = TypeVar("R", bound=Model)
ReadChunk = Callable[[BundleRange], bytes]
"""Returns bytes of a spooled bundle; raises `KeyError` if the bundle does not exist."""

_CONNECT_TIMEOUT_MS, _OPEN_TIMEOUT_MS = 2000, 2000
_LEASE_MS = 5000
_MAX_PACKET_BYTES = 4 << 20
_ASK_TIMEOUT_S = 2.0

log = structlog.get_logger(__name__)
_LIMIT = LogLimit(1.0, 60.0)


class Link(Closing):
    """Zenoh session that can be reopened; a context manager.

    Args:
        endpoints: endpoints of one coordinator or of its gateways, or `@FILE`, which is read at each opening. One
            connection is enough; each opening tries them in random order, which distributes many workers over them.
        host: name of this machine, which is part of the key of every request.
        tls: TLS files of this machine, or `None` for plain TCP.
    """

    def __init__(self, endpoints: Sequence[str], host: str, tls: TlsFiles | None = None) -> None:
        self.endpoints = tuple(endpoints)
        self._host = host
        self._tls = tls
        self.last_error = ""
        """Error message of the last opening that failed."""
        self.is_run_finished = False
        """Whether the address file stated at the last opening that the run is finished."""
        self.is_foreign = False
        """Whether a reply to the last registration could not be read: its sender runs another version."""
        self._session: zenoh.Session | None = None
        self._declared: list[zenoh.Queryable[None] | zenoh.LivelinessToken] = []
        self._serving: tuple[str, str, ReadChunk] | None = None
        self._run = ""
        self._guard = threading.Lock()
        self._refused, self._unreadable = Repeated(log, "refused"), Repeated(log, "spool_unreadable")
        self._closings = 0
        self._answered = time.monotonic()

    @property
    def silence_s(self) -> float:
        """Time since the last reply, or since the session was opened, seconds."""
        return time.monotonic() - self._answered

    @property
    def via(self) -> str | None:
        """Zenoh id of the router that the session is connected to; a gateway with that id pulls bundles from here."""
        session = self._session
        try:
            routers = session.info.routers_zid() if session is not None else []
        except zenoh.ZError:  # another thread closed the session meanwhile
            return None
        return str(routers[0]) if routers else None

    def open(self) -> bool:
        """Closes the session, if any, and opens a new one; returns whether that succeeded within two seconds."""
        self.close()
        self.is_run_finished = False
        opening = self._closings
        try:
            endpoints = find_endpoints(self.endpoints)
            session = zenoh.open(_config(random.sample(endpoints, len(endpoints)), self._tls))
        except WorldError as error:
            self.last_error, self.is_run_finished = str(error), isinstance(error, RunFinished)
            return False
        except zenoh.ZError as error:
            short = str(error).split(" at /")[0]  # without the paths of zenoh's source files
            self.last_error = why_unreachable(endpoints, self._tls) or short
            log.debug("connect_failed", endpoints=endpoints, error=str(error), cause=self.last_error)
            return False
        with self._guard:
            is_wanted = opening == self._closings
            if is_wanted:
                self._session = session
                self._answered = time.monotonic()
        if not is_wanted:  # another thread closed the link meanwhile
            session.close()
            return False
        self._declare()
        return True

    def send_hello(self, hello: Hello) -> tuple[HelloReply | Refusal, ...]:
        """Registers this worker with all coordinators that answer, and returns the reply of each."""
        replies = [
            _parse(payload, HelloReply)
            for payload in self._get(any_hello_key(self._host), hello.model_dump_json(), _ASK_TIMEOUT_S)
        ]
        self.is_foreign = None in replies
        return tuple(reply for reply in replies if reply is not None)

    def ask_role(self) -> Role | None:
        """Returns the role of this host in the admission list of a coordinator; `None` if none answers."""
        for payload in self._get(any_hello_key(self._host, Verb.PING), Ping().model_dump_json(), _ASK_TIMEOUT_S):
            reply = _parse(payload, Pong)
            if isinstance(reply, Pong):
                return reply.role
        return None

    def join(self, run: str) -> None:
        """Selects the run that all further requests refer to."""
        self._run = run

    def ask(self, verb: Verb, message: Model, kind: type[R], timeout_s: float = _ASK_TIMEOUT_S) -> R | None:
        """Sends a request to the coordinator and returns the reply.

        Args:
            verb: what to request.
            message: body of the request.
            kind: model of the reply.
            timeout_s: time to wait for the reply, seconds.

        Returns:
            The reply; `None` if none arrived. The coordinator may have served the request nevertheless, so the caller
            repeats it with the same ids.
        """
        key = verb_key(self._run, self._host, verb)
        for payload in self._get(key, message.model_dump_json(), timeout_s):
            reply = _parse(payload, kind)
            if isinstance(reply, Refusal):
                self._refused.fail(reply.error, verb=str(verb))
            elif reply is not None:
                self._refused.succeed()
                return reply
        return None

    def fetch_scene(self, sha256: str, chunk: Chunk) -> bytes | None:
        """Returns the bytes of a chunk of a compiled scene, or `None` if no reply arrived."""
        for payload in self._get(scene_selector(self._run, sha256, chunk), None, _ASK_TIMEOUT_S):
            if len(payload) <= chunk.length:
                return payload.to_bytes()
        return None

    def serve(self, sid: str, read: ReadChunk) -> None:
        """Serves the spool and declares the liveliness token of `sid`, in this session and all later ones."""
        self._serving = (self._run, sid, read)
        self._declare()

    def close(self) -> None:
        """Closes the session; open requests end without a reply."""
        with self._guard:
            session, self._session = self._session, None
            self._declared = []
            self._closings += 1
        if session is not None and not session.is_closed():
            session.close()

    def _declare(self) -> None:
        session = self._session
        if session is None or self._serving is None:
            return
        run, sid, read = self._serving
        key = bundle_key(run, sid)
        try:
            # the queryable is declared first, because a peer that sees the token may send a query immediately
            queryable = session.declare_queryable(key, lambda query: _answer(query, key, read, self._unreadable))
            token = session.liveliness().declare_token(alive_key(run, sid))
        except zenoh.ZError:
            if not session.is_closed():  # no error if another thread closed the session meanwhile
                raise
            return
        self._declared = [queryable, token]

    def _get(self, selector: str, payload: str | None, timeout_s: float) -> Iterator[zenoh.ZBytes]:
        session = self._session
        if session is None:
            return
        try:
            replies = session.get(
                selector,
                zenoh.handlers.FifoChannel(16),
                payload=payload,
                timeout=timeout_s,
                consolidation=zenoh.ConsolidationMode.NONE,
            )
            for reply in replies:
                if reply.ok is not None and len(reply.ok.payload) <= MAX_MESSAGE_BYTES:
                    self._answered = time.monotonic()
                    yield reply.ok.payload
                elif reply.err is not None:
                    log.debug("answered_with_error", selector=selector, error=reply.err.payload.to_bytes()[:200])
        except zenoh.ZError as error:  # another thread closed the session meanwhile
            log.debug("ask_failed", selector=selector, error=str(error))


def _answer(query: zenoh.Query, key: str, read: ReadChunk, unreadable: Repeated) -> None:
    with query:
        try:
            ranges = parse_bundle_ranges({name: query.parameters.get(name) or "" for name in RANGE_FIELDS})
            query.reply(key, b"".join(map(read, ranges)))
            unreadable.succeed()
        except (ValueError, KeyError) as error:
            query.reply_err(f"no such bytes: {error}")
        except OSError as error:
            unreadable.fail(error)
            query.reply_err("the spool cannot be read")


def _parse(payload: zenoh.ZBytes, kind: type[R]) -> R | Refusal | None:
    data = payload.to_bytes()
    for model in (kind, Refusal):
        try:
            return model.model_validate_json(data)
        except ValidationError:
            continue
    _LIMIT.write(log.warning, "reply_invalid", expected=kind.__name__, size=len(data))
    return None


def _config(endpoints: Sequence[str], tls: TlsFiles | None) -> zenoh.Config:
    values = {
        "mode": '"client"',
        "listen/endpoints": "[]",
        "connect/endpoints": json.dumps(list(endpoints)),
        # an attempt to connect has a short timeout, because a signal cannot interrupt it; the caller retries
        "connect/timeout_ms": str(_CONNECT_TIMEOUT_MS),
        "connect/exit_on_failure": "true",
        # closing the session waits for a reconnect in progress, and a frozen router never replies; the default is 10 s
        "transport/unicast/open_timeout": str(_OPEN_TIMEOUT_MS),
        "connect/retry": json.dumps({"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 2}),
        "scouting/multicast/enabled": "false",
        "scouting/gossip/enabled": "false",
        "transport/shared_memory/enabled": "false",  # shared memory loses queries under load
        "transport/link/tx/lease": str(_LEASE_MS),
        "transport/link/rx/max_message_size": str(_MAX_PACKET_BYTES),
        "queries_default_timeout": "5000",
    }
    if tls is not None:
        values |= {
            "transport/link/protocols": '["tls"]',
            "transport/link/tls/root_ca_certificate": json.dumps(str(tls.ca)),
            "transport/link/tls/enable_mtls": "true",
            "transport/link/tls/verify_name_on_connect": "true",
            "transport/link/tls/close_link_on_expiration": "true",
            "transport/link/tls/connect_private_key": json.dumps(str(tls.key)),
            "transport/link/tls/connect_certificate": json.dumps(str(tls.certificate)),
        }
    config = zenoh.Config()
    for name, value in values.items():
        config.insert_json5(name, value)
    return config

"""Sends the requests of a gateway to its core through the zenoh session of the gateway's router.

The module also detects a core that does not reply and reopens the router. It does not interpret the requests.
"""

from __future__ import annotations

import threading
import time
from typing import TypeVar

import structlog

from coordinator.protocol.ask import read_reply
from coordinator.protocol.node import ZenohNode
from schemas.base import Model
from schemas.errors import TransientError, WorldError
from schemas.protocol.keys import Verb, verb_key
from schemas.support.log_limit import Repeated

_ANY_RUN = "*"
_TIMEOUT_S = 5.0
_PAUSE_S = 0.5
_REOPEN_S = 10.0
R = TypeVar("R", bound=Model)
log = structlog.get_logger(__name__)


class CoreLink:
    """Request client of a gateway.

    Args:
        node: zenoh session of the gateway.
        name: name of the gateway; with TLS the common name of its certificate.
    """

    def __init__(self, node: ZenohNode, name: str) -> None:
        self._node = node
        self._name = name
        self.run = _ANY_RUN
        """Name of the run in the request keys; the wildcard `*` until it is known."""
        self._heard = self._opened = time.monotonic()
        self._reconnecting = threading.Lock()
        self._away = Repeated(log, "core_unreachable")

    @property
    def silence_s(self) -> float:
        """Time since the last reply of the core, or since the start, seconds."""
        return time.monotonic() - self._heard

    def ask(self, verb: Verb, message: Model, kind: type[R]) -> R:
        """Sends a request and returns the reply.

        Raises:
            TransientError: no reply arrived; the core may have processed the request, so repeat it unchanged.
            WorldError: the core refuses the request, or several cores reply.
        """
        key = verb_key(self.run, self._name, verb)
        found = list(self._node.ask(key, message.model_dump_json(), _TIMEOUT_S))
        if not found:
            self._reconnect()
            raise TransientError(
                f"the coordinator does not answer request {verb!r} of gateway {self._name}; the request is repeated"
            )
        if len(found) > 1:
            raise WorldError(
                f"{len(found)} coordinators answer gateway {self._name}; give --connect endpoints of one run only"
            )
        self._heard = time.monotonic()
        self._away.succeed()
        return read_reply(found[0], kind, "the coordinator")

    def request_until_reply(self, verb: Verb, message: Model, kind: type[R], stop: threading.Event) -> R:
        """Repeats a request until the core replies.

        Raises:
            TransientError: `stop` was set before the core replied.
            WorldError: the core refuses the request.
        """
        while True:
            try:
                return self.ask(verb, message, kind)
            except TransientError:
                if stop.wait(_PAUSE_S):
                    raise

    def _reconnect(self) -> None:
        """Reopens the router after a long time without replies: a link may be half-open, or zenoh may not retry."""
        with self._reconnecting:
            if time.monotonic() - max(self._heard, self._opened) < _REOPEN_S:
                return
            self._away.fail(f"no answer for {self.silence_s:.0f} s", remedy="none needed; the gateway reconnects")
            try:
                self._node.reopen()
            except WorldError as error:
                raise TransientError(str(error)) from error
            self._opened = time.monotonic()

"""A gateway's questions to its core: asked through its own router, answered or unknown.

Also the one place that notices silence and opens the router anew; it decides nothing about what was asked.
"""

from __future__ import annotations

import threading
import time
from typing import TypeVar

import structlog
from pydantic import ValidationError

from coordinator.protocol.node import ZenohNode
from schemas.base import Model
from schemas.errors import TransientError, WorldError
from schemas.keys import Verb, verb_key
from schemas.support.log_limit import Repeated
from schemas.wire import Refusal

__all__ = ["CoreLink"]

_ANY_RUN = "*"
_TIMEOUT_S = 5.0
_PAUSE_S = 0.5
_REOPEN_S = 10.0
R = TypeVar("R", bound=Model)
log = structlog.get_logger(__name__)


class CoreLink:
    """Asks under one name.

    Args:
        node: the gateway's session.
        name: of the gateway; with TLS the name in its certificate.
    """

    def __init__(self, node: ZenohNode, name: str) -> None:
        self._node = node
        self._name = name
        self.run = _ANY_RUN
        """The run that is asked about; any, until it is known."""
        self._heard = self._opened = time.monotonic()
        self._healing = threading.Lock()
        self._away = Repeated(log, "core_away")

    @property
    def silence_s(self) -> float:
        """Seconds since the core has answered anything, or since the start."""
        return time.monotonic() - self._heard

    def ask(self, verb: Verb, message: Model, kind: type[R]) -> R:
        """Returns the answer.

        Raises:
            TransientError: none came; whether the core heard is unknown, so ask the same again.
            WorldError: the core refuses, or several cores answer.
        """
        key = verb_key(self.run, self._name, verb)
        found = list(self._node.ask(key, message.model_dump_json(), _TIMEOUT_S))
        if not found:
            self._heal()
            raise TransientError(
                f"the coordinator does not answer request {verb!r} of gateway {self._name}; the request is repeated"
            )
        if len(found) > 1:
            raise WorldError(
                f"{len(found)} coordinators answer gateway {self._name}; give --connect endpoints of one run only"
            )
        self._heard = time.monotonic()
        self._away.succeed()
        return _read(found[0], kind)

    def insist(self, verb: Verb, message: Model, kind: type[R], stop: threading.Event) -> R:
        """Asks until there is an answer.

        Raises:
            TransientError: told to stop before.
            WorldError: the core refuses.
        """
        while True:
            try:
                return self.ask(verb, message, kind)
            except TransientError:
                if stop.wait(_PAUSE_S):
                    raise

    def _heal(self) -> None:
        """Opens the router anew after a long silence: a half-open link, or one that zenoh has given up, heals so."""
        with self._healing:
            if time.monotonic() - max(self._heard, self._opened) < _REOPEN_S:
                return
            self._away.fail(f"no answer for {self.silence_s:.0f} s", remedy="none needed; the gateway reconnects")
            try:
                self._node.reopen()
            except WorldError as error:
                raise TransientError(str(error)) from error
            self._opened = time.monotonic()


def _read(payload: bytes, kind: type[R]) -> R:
    try:
        return kind.model_validate_json(payload)
    except ValidationError as error:
        try:
            refusal = Refusal.model_validate_json(payload)
        except ValidationError:
            raise WorldError(f"the coordinator uses another version of the protocol: {error}") from error
        raise WorldError(f"the coordinator refuses this gateway: {refusal.error}") from error

"""A gateway's questions to its core: asked through its own router, answered or unknown. Decides nothing."""

from __future__ import annotations

import threading
from typing import TypeVar

from pydantic import ValidationError

from coordinator.node import Node
from schemas.base import Model
from schemas.errors import TransientError, WorldError
from schemas.keys import Verb, verb_key
from schemas.wire import Refusal

__all__ = ["CoreLink"]

_ANY_RUN = "*"
_TIMEOUT_S = 5.0
_PAUSE_S = 0.5
R = TypeVar("R", bound=Model)


class CoreLink:
    """Asks under one name.

    Args:
        node: the gateway's session.
        name: of the gateway; with TLS the name in its certificate.
    """

    def __init__(self, node: Node, name: str) -> None:
        self._node = node
        self._name = name
        self.run = _ANY_RUN
        """The run that is asked about; any, until it is known."""

    def ask(self, verb: Verb, message: Model, kind: type[R]) -> R:
        """Returns the answer.

        Raises:
            TransientError: none came; whether the core heard is unknown, so ask the same again.
            WorldError: the core refuses, or several cores answer.
        """
        key = verb_key(self.run, self._name, verb)
        found = list(self._node.ask(key, message.model_dump_json(), _TIMEOUT_S))
        if not found:
            raise TransientError(f"the core does not answer {verb!r} to gateway {self._name}; it is asked again")
        if len(found) > 1:
            raise WorldError(f"{len(found)} cores answer gateway {self._name}: --connect to those of one run only")
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


def _read(payload: bytes, kind: type[R]) -> R:
    try:
        return kind.model_validate_json(payload)
    except ValidationError as error:
        try:
            refusal = Refusal.model_validate_json(payload)
        except ValidationError:
            raise WorldError(f"the core speaks another version of the protocol: {error}") from error
        raise WorldError(f"the core refuses this gateway: {refusal.error}") from error

"""One question to a running coordinator, from a client session that lives as long as the question. Writes nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import zenoh
from pydantic import ValidationError

from coordinator.protocol.zenoh_config import client_config
from coordinator.settings import CoordinatorSettings
from schemas.base import Model
from schemas.errors import TransientError, WorldError
from schemas.identity import TlsFiles
from schemas.keys import Verb, any_hello_key
from schemas.wire import Ack, AdminReply, AdminRequest, Ping, Progress, Refusal

__all__ = ["OPERATOR", "ask_admin", "ask_presence", "ask_progress"]

OPERATOR = "operator"
_TIMEOUT_S = 10.0
R = TypeVar("R", bound=Model)


def ask_progress(endpoints: Sequence[str], name: str = OPERATOR, tls: TlsFiles | None = None) -> Progress:
    """Returns where the run of a coordinator stands.

    Args:
        endpoints: of the coordinator.
        name: who asks; with TLS the name in the certificate.
        tls: to connect with.

    Raises:
        TransientError: nobody answers there.
    """
    return _ask(endpoints, Verb.PROGRESS, None, Progress, name, tls)


def ask_presence(endpoints: Sequence[str], name: str = OPERATOR, tls: TlsFiles | None = None) -> None:
    """Makes sure that a coordinator is there and admits this side; learns nothing of its run.

    Raises:
        TransientError: nobody answers there.
    """
    _ask(endpoints, Verb.PING, Ping(), Ack, name, tls)


def ask_admin(
    endpoints: Sequence[str], request: AdminRequest, name: str = OPERATOR, tls: TlsFiles | None = None
) -> AdminReply:
    """Has a coordinator carry out an operator's wish; safe to repeat.

    Raises:
        TransientError: nobody answers there; whether it was done is unknown.
        WorldError: it was refused.
    """
    return _ask(endpoints, Verb.ADMIN, request, AdminReply, name, tls)


def _ask(
    endpoints: Sequence[str], verb: Verb, message: Model | None, answer: type[R], name: str, tls: TlsFiles | None
) -> R:
    named = ", ".join(endpoints)
    payload = message.model_dump_json() if message is not None else ""
    try:
        with zenoh.open(client_config(endpoints, CoordinatorSettings().transport_lease_s, tls)) as session:
            replies = session.get(
                any_hello_key(name, verb),
                zenoh.handlers.FifoChannel(4),
                payload=payload,
                timeout=_TIMEOUT_S,
                consolidation=zenoh.ConsolidationMode.NONE,
            )
            for reply in replies:
                if reply.ok is not None:
                    return _read(reply.ok.payload.to_bytes(), answer, named)
    except zenoh.ZError as error:
        raise TransientError(f"no coordinator at {named}: {error}; start one, or check the endpoint") from error
    admitted = f", or it does not admit {name!r} (its hosts.txt)" if tls is not None else ""
    raise TransientError(f"the coordinator at {named} did not answer {verb!r}{admitted}; try again")


def _read(payload: bytes, answer: type[R], named: str) -> R:
    try:
        return answer.model_validate_json(payload)
    except ValidationError as error:
        try:
            refusal = Refusal.model_validate_json(payload)
        except ValidationError:
            raise WorldError(f"{named} uses another version of the protocol: {error}") from error
        raise WorldError(f"the coordinator at {named} refused: {refusal.error}") from error

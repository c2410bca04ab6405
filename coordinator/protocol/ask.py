"""Sends single requests to a running coordinator, each in a temporary client session. Writes no file."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import TypeVar

import zenoh
from pydantic import ValidationError

from coordinator.protocol.access import roles_with
from coordinator.protocol.zenoh_config import client_config
from coordinator.settings import CoordinatorSettings
from schemas.base import Model
from schemas.errors import FactoryError, TransientError, WorldError
from schemas.protocol.address_file import find_endpoints
from schemas.protocol.administration import AdminReply, AdminRequest
from schemas.protocol.identity import TlsFiles
from schemas.protocol.keys import Verb, any_hello_key
from schemas.protocol.messages import Ping, Pong, Refusal
from schemas.protocol.reachability import why_unreachable
from schemas.protocol.status import Progress
from schemas.support.product import product_version

OPERATOR = "operator"
"""Default name of a requester."""
_TIMEOUT_S, _PING_S = 10.0, 3.0
R = TypeVar("R", bound=Model)


def ask_progress(endpoints: Sequence[str], name: str = OPERATOR, tls: TlsFiles | None = None) -> Progress:
    """Returns the progress of a coordinator's run.

    Args:
        endpoints: endpoints of the coordinator.
        name: name of the requester; with TLS the common name of its certificate.
        tls: TLS files for the connection; `None` connects without TLS.

    Raises:
        TransientError: no coordinator replies at the endpoints.
    """
    return _ask(endpoints, Verb.PROGRESS, None, Progress, name, tls)


def ask_presence(endpoints: Sequence[str], name: str = OPERATOR, tls: TlsFiles | None = None) -> None:
    """Checks that a coordinator replies and admits this client. Returns no information about the run.

    Raises:
        TransientError: no coordinator replies at the endpoints.
    """
    _ask(endpoints, Verb.PING, Ping(), Pong, name, tls)


def ask_admin(
    endpoints: Sequence[str], request: AdminRequest, name: str = OPERATOR, tls: TlsFiles | None = None
) -> AdminReply:
    """Sends an admin request to a coordinator. The request is idempotent.

    Raises:
        TransientError: no coordinator replies; the request may have been executed.
        WorldError: the coordinator refuses the request.
    """
    return _ask(endpoints, Verb.ADMIN, request, AdminReply, name, tls)


def _ask(
    endpoints: Sequence[str], verb: Verb, message: Model | None, answer: type[R], name: str, tls: TlsFiles | None
) -> R:
    endpoints = find_endpoints(endpoints)
    named = ", ".join(endpoints)
    payload = message.model_dump_json() if message is not None else ""
    try:
        with _open(endpoints, tls) as session:
            for reply in query(session, any_hello_key(name, verb), payload, _TIMEOUT_S):
                return read_reply(reply, answer, f"the coordinator at {named}")
    except zenoh.ZError as error:
        cause = why_unreachable(endpoints, tls) or str(error).split(" at /")[0]
        raise TransientError(f"no coordinator at {named} ({cause}): start one, or check the endpoint") from error
    if tls is None:
        raise TransientError(f"the coordinator at {named} did not answer the request `{verb}`; try again")
    raise _silence(endpoints, verb, name, tls)


def _silence(endpoints: Sequence[str], verb: Verb, name: str, tls: TlsFiles) -> FactoryError:
    """Returns why a coordinator did not answer a request over TLS: the access rules drop what a role may not send."""
    named = ", ".join(endpoints)
    with contextlib.suppress(zenoh.ZError, WorldError), _open(endpoints, tls) as session:
        for reply in query(session, any_hello_key(name, Verb.PING), Ping().model_dump_json(), _PING_S):
            role, able = read_reply(reply, Pong, named).role, roles_with(verb)
            if role is not None and role not in able:
                return WorldError(
                    f"the coordinator at {named} does not serve the request `{verb}` for {name!r}: its role is {role}, "
                    f"and the request needs the role {' or '.join(able)}. Use the --tls folder of such a host, or "
                    f"create one where the authority is: `factory keys host DIR NAME --role {able[-1]}`"
                )
            return TransientError(f"the coordinator at {named} answers, but not the request `{verb}`; try again")
    return TransientError(
        f"the coordinator at {named} did not answer the request `{verb}`, or it does not admit {name!r} "
        "(its hosts.txt): add the host there, or try again"
    )


def _open(endpoints: Sequence[str], tls: TlsFiles | None) -> zenoh.Session:
    """Connects to the first endpoint that accepts a connection.

    Tries one endpoint after another: if zenoh tried them together, a name that this host cannot resolve would use up
    the time of the other endpoints.

    Raises:
        zenoh.ZError: no endpoint accepts a connection.
    """
    *others, last = endpoints
    for endpoint in others:
        with contextlib.suppress(zenoh.ZError):
            return zenoh.open(client_config([endpoint], CoordinatorSettings().transport_lease_s, tls))
    return zenoh.open(client_config([last], CoordinatorSettings().transport_lease_s, tls))


def query(session: zenoh.Session, selector: str, payload: str | None, timeout_s: float) -> Iterator[bytes]:
    """Sends a query and yields the replies; without a reply the outcome is unknown.

    Raises:
        zenoh.ZError: the session is closed.
    """
    for reply in session.get(
        selector,
        zenoh.handlers.FifoChannel(4),
        payload=payload,
        timeout=timeout_s,
        consolidation=zenoh.ConsolidationMode.NONE,
    ):
        if reply.ok is not None:
            yield reply.ok.payload.to_bytes()


def read_reply(payload: bytes, answer: type[R], who: str) -> R:
    """Parses a reply.

    Args:
        payload: the reply.
        answer: expected model.
        who: sender, for the error message.

    Raises:
        WorldError: the reply is a refusal, or not valid.
    """
    try:
        return answer.model_validate_json(payload)
    except ValidationError as error:
        try:
            refusal = Refusal.model_validate_json(payload)
        except ValidationError:
            raise WorldError(
                f"{who} sent a reply that minivla-factory {product_version()} cannot read, so it runs another version: "
                f"use the version that `factory --version` prints on its host ({error.error_count()} differences)"
            ) from error
        raise WorldError(f"{who} refused: {refusal.error}") from error

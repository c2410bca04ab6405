"""Carries out an operator's wish on a dataset directory: through the coordinator that runs there, else in its place.

Never opens a second writer: without the directory's lock it changes nothing.
"""

from __future__ import annotations

import contextlib
from datetime import datetime
from pathlib import Path

from coordinator.archive.staging import Staging
from coordinator.ledger import hosts, operator
from coordinator.ledger.engine import open_writer
from coordinator.ledger.opening import ledger_url_of, read_info
from coordinator.ledger.reading.look import damage_translated, look_into, require_sound
from coordinator.protocol.address_file import read_address
from coordinator.protocol.ask import OPERATOR, ask_admin
from schemas.errors import TransientError, UsageError
from schemas.identity import TlsFiles
from schemas.wire import AdminAction, AdminReply, AdminRequest

__all__ = ["administer"]


def administer(
    root: Path,
    request: AdminRequest,
    now: datetime,
    ledger_url: str | None = None,
    *,
    name: str = OPERATOR,
    tls: TlsFiles | None = None,
) -> AdminReply:
    """Carries out an operator's wish; repeating it changes nothing more.

    Args:
        root: dataset directory.
        request: the wish.
        now: of the wish.
        ledger_url: where the ledger is, when not in the directory.
        name: who asks; with TLS the name in the certificate.
        tls: to connect to a running coordinator with, when it wants that.

    Raises:
        WorldError: there is no ledger, or a coordinator holds the directory and cannot be asked.
        UsageError: the ledger is of a newer format, or there is nobody to drain.
    """
    url = ledger_url_of(root, ledger_url)
    with look_into(url) as connection:
        read_info(connection)  # says no before anything is created
    beacon = read_address(root)
    if beacon is not None:
        with contextlib.suppress(TransientError):  # a killed coordinator leaves its beacon behind: the lock tells
            return ask_admin([_from_here(endpoint) for endpoint in beacon.endpoints], request, name, tls)
    with contextlib.closing(Staging(root, str(root))):  # the lock of the one coordinator
        return _administer_offline(url, request, now)


def _from_here(endpoint: str) -> str:
    """Returns where an endpoint that listens on every address is reached from this machine."""
    return endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")


def _administer_offline(url: str, request: AdminRequest, now: datetime) -> AdminReply:
    if request.action is AdminAction.DRAIN:
        raise UsageError("no coordinator is running on the directory, so there is no worker to drain")
    require_sound(url)
    engine = open_writer(url)
    try:
        with damage_translated(url), engine.begin() as connection:
            if request.action is AdminAction.RELEASE:
                return hosts.release(connection, request.hosts)
            change = operator.retry if request.action is AdminAction.RETRY else operator.cancel
            return change(connection, request.indices, now)
    finally:
        engine.dispose()

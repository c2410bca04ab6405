"""Executes an admin request on a dataset directory: through its running coordinator, or on the ledger if none runs.

The module does not open a second writer: it changes nothing unless it holds the lock of the directory.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from coordinator.archive.staging import Staging, is_held
from coordinator.ledger.administration import execute
from coordinator.ledger.database.engine import open_writer
from coordinator.ledger.opening import ledger_url_of, read_info
from coordinator.ledger.reading.reader import open_ledger, require_sound, translate_damage
from coordinator.protocol.ask import OPERATOR, ask_admin
from schemas.errors import TransientError, UsageError
from schemas.protocol.address_file import read_address, remove_address
from schemas.protocol.administration import AdminAction, AdminReply, AdminRequest
from schemas.protocol.identity import TlsFiles

_PATIENCE_S, _PAUSE_S = 8.0, 0.5


def administer(
    root: Path,
    request: AdminRequest,
    now: datetime,
    ledger_url: str | None = None,
    *,
    name: str = OPERATOR,
    tls: TlsFiles | None = None,
    connect: Sequence[str] = (),
) -> AdminReply:
    """Executes an admin request. The request is idempotent.

    Args:
        root: dataset directory.
        request: the request.
        now: time of the request.
        ledger_url: URL of the ledger; by default the ledger in the directory.
        name: name of the requester; with TLS the common name of its certificate.
        tls: TLS files for the connection to a running coordinator; `None` connects without TLS.
        connect: endpoints of the running coordinator, which is then asked without reading the directory.

    Raises:
        TransientError: a coordinator holds the directory and does not answer.
        WorldError: the ledger does not exist, or the directory cannot be locked.
        UsageError: the ledger has another format, or a drain is requested and no coordinator runs.
    """
    if connect:
        return ask_admin(connect, request, name, tls)
    url = ledger_url_of(root, ledger_url)
    with open_ledger(url) as connection:
        read_info(connection)  # raises before any file is created
    answer = _ask_coordinator(root, request, name, tls)
    if answer is not None:
        return answer
    with contextlib.closing(Staging(root, str(root))):  # takes the lock of a coordinator
        reply = _administer_offline(url, request, now)
        if request.action is AdminAction.RETRY:
            remove_address(root)  # the address file may state that the run is finished
        return reply


def _ask_coordinator(root: Path, request: AdminRequest, name: str, tls: TlsFiles | None) -> AdminReply | None:
    """Sends a request to the coordinator of a directory; returns `None` if none runs.

    A request without an answer is sent again for some seconds, because a coordinator reads its admission list every
    two seconds and closes all connections when it has changed.

    Raises:
        TransientError: a coordinator holds the directory and does not answer.
    """
    end = time.monotonic() + _PATIENCE_S
    while True:
        address = read_address(root)
        if address is None or not address.endpoints:
            return None
        try:
            return ask_admin(address.nearest, request, name, tls)
        except TransientError:
            if not is_held(root):
                return None  # a killed coordinator leaves its address file
            if time.monotonic() > end:
                raise
        time.sleep(_PAUSE_S)


def _administer_offline(url: str, request: AdminRequest, now: datetime) -> AdminReply:
    if request.action is AdminAction.DRAIN:
        raise UsageError("no coordinator runs on the directory; only a running coordinator can drain workers")
    require_sound(url)
    engine = open_writer(url)
    try:
        with translate_damage(url), engine.begin() as connection:
            return execute(connection, request, now)
    finally:
        engine.dispose()

"""Starts the web page of a dataset: checks the address, chooses the token, and serves until the block ends."""

from __future__ import annotations

import contextlib
import secrets
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from starlette.routing import BaseRoute

from coordinator.admin import administer as administer_dataset
from coordinator.protocol.ask import OPERATOR
from coordinator.protocol.tls import read_credentials
from coordinator.status.address import parse_address
from factory.dataset.site import Site
from factory.html import compile_templates
from factory.web.access import Access
from factory.web.app import create_app
from factory.web.figures.store import StatisticsStore
from factory.web.server import WebServer
from factory.web.workspace import Workspace
from schemas.errors import FactoryError
from schemas.protocol.administration import AdminReply, AdminRequest


@contextmanager
def serve(
    site: Site,
    http: str,
    token: str | None,
    tls: Path | None = None,
    ledger: str | None = None,
    administer: Callable[[AdminRequest], AdminReply] | None = None,
    more_routes: Iterable[BaseRoute] = (),
    evaluations: Sequence[Path] = (),
) -> Iterator[str]:
    """Serves the web page of a dataset while the context is open; yields its URL, with the token if it was chosen here.

    Args:
        site: location of the dataset.
        http: HOST:PORT to serve on.
        token: token that every request requires; `None` chooses one, which only changes require on loopback.
        tls: TLS folder of this host; clients need a certificate of the same authority. `None` serves plain HTTP.
        ledger: URL of the ledger; `None` for the ledger of the dataset.
        administer: function that executes an admin request; `None` asks the running coordinator of the dataset, or
            changes the ledger if none runs.
        more_routes: further routes of the application.
        evaluations: directories of `factory eval -o`.

    Raises:
        UsageError: the address is malformed, or other machines can reach it without a token and without TLS.
        WorldError: the address is in use.
    """
    address = parse_address(http, token, is_encrypted=tls is not None)
    access = Access(token or secrets.token_urlsafe(24), reads_openly=token is None)
    files, name = read_credentials(tls) if tls else (None, OPERATOR)

    def ask(request: AdminRequest) -> AdminReply:
        return administer_dataset(site.state_dir, request, datetime.now(UTC), ledger, name=name, tls=files)

    workspace = Workspace(site, ledger)
    statistics = StatisticsStore(str(site))
    app = create_app(workspace, address, access, administer or ask, statistics, more_routes, evaluations)
    with statistics, WebServer(app, address, files) as server:
        threading.Thread(target=_prepare, args=(workspace,), name="prepare", daemon=True).start()
        yield server.url + ("" if token else f"/?token={access.token}")


def _prepare(workspace: Workspace) -> None:
    """Compiles templates and statements and reads the tables, so that the first requests do not; they raise errors."""
    compile_templates("web")
    for read in (workspace.farm, workspace.table):
        with contextlib.suppress(FactoryError):
            read()

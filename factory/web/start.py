"""Starts the web page of a dataset: checks the address, chooses the token, and serves until the block ends."""

from __future__ import annotations

import contextlib
import secrets
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from anyio import open_file  # noqa: F401 - anyio imports it on first use, which is the first request for a file
from starlette.routing import BaseRoute

from coordinator.admin import administer as administer_dataset
from coordinator.protocol.ask import OPERATOR
from coordinator.protocol.tls import read_credentials
from coordinator.status.address import parse_address
from coordinator.status.server import HttpServer
from factory.dataset.marks import Marks
from factory.dataset.site import Site
from factory.html import compile_templates
from factory.web.access import Access
from factory.web.app import create_app
from factory.web.context import WebContext
from factory.web.evaluations import Evaluations
from factory.web.figures.store import StatisticsStore
from factory.web.frames import FrameStore, first_frames
from factory.web.pages.farm import read_view
from factory.web.recent import Recent
from factory.web.thumbnails import ThumbnailStore
from factory.web.workspace import Workspace
from schemas.errors import FactoryError
from schemas.protocol.administration import AdminReply, AdminRequest

_FARM_AGE_S = 3.0
"""Maximum age of the shown state of a run, seconds."""
_READ_AHEAD = 1000
"""Number of episodes at the beginning of the dataset that are searched for different scenes to prepare."""


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
    *,
    renders_ahead: bool = False,
) -> Iterator[str]:
    """Serves the web page of a dataset while the context is open; yields its URL, with the token if it was generated.

    Args:
        site: location of the dataset.
        http: HOST:PORT to serve on.
        token: token that every request requires; `None` generates a token that only requests with changes require.
        tls: TLS folder of this host; clients need a certificate of the same authority. `None` serves plain HTTP.
        ledger: URL of the ledger; `None` for the ledger of the dataset.
        administer: function that executes an admin request; `None` asks the running coordinator of the dataset, or
            changes the ledger if none runs.
        more_routes: additional routes of the application.
        evaluations: directories of `factory eval -o`.
        renders_ahead: whether to render a frame of each of the first scenes of a states dataset immediately, so
            the first viewer does not wait for a rendering process and its scenes; false during a run.

    Raises:
        UsageError: the address is malformed, or other machines can reach it without a token and without TLS.
        WorldError: the address is in use.
    """
    address = parse_address(http, token, is_encrypted=tls is not None)
    access = Access(token or secrets.token_urlsafe(24), reads_openly=token is None)
    files, name = read_credentials(tls) if tls else (None, OPERATOR)

    def ask(request: AdminRequest) -> AdminReply:
        return administer_dataset(site.state_dir, request, datetime.now(UTC), ledger, name=name, tls=files)

    workspace, statistics = Workspace(site, ledger), StatisticsStore(str(site))
    context = make_context(workspace, administer or ask, statistics, evaluations)
    app = create_app(context, address, access, more_routes)
    with statistics, HttpServer(app, address, "the web page", files) as server:
        threading.Thread(target=_prepare, args=(context, renders_ahead), name="prepare", daemon=True).start()
        yield server.url + ("" if token else f"/?token={access.token}")


def make_context(
    workspace: Workspace,
    administer: Callable[[AdminRequest], AdminReply],
    statistics: StatisticsStore,
    evaluations: Sequence[Path] = (),
) -> WebContext:
    """Returns the shared state of an application.

    Args:
        workspace: the dataset and its run.
        administer: function that executes an admin request on the run.
        statistics: figures of the dataset.
        evaluations: directories of `factory eval -o`.
    """
    return WebContext(
        workspace=workspace,
        farm=Recent(lambda: read_view(workspace), _FARM_AGE_S),
        marks=Marks(workspace.site),
        frames=FrameStore(workspace),
        thumbnails=ThumbnailStore(workspace),
        administer=administer,
        evaluations=Evaluations(evaluations),
        statistics=statistics,
    )


def _prepare(context: WebContext, renders_ahead: bool) -> None:
    """Compiles templates and reads tables and ledger, so the first requests are fast. Requests report the errors."""
    with contextlib.suppress(FactoryError):
        dataset = context.workspace.dataset()
        # beside a run, rendering ahead would take CPU time from the simulations
        if renders_ahead and not context.workspace.is_written():
            scenes, names = (dataset.column(name)[:_READ_AHEAD].to_pylist() for name in ("scene", "episode_id"))
            context.frames.prepare(first_frames(scenes, names))
    compile_templates("web")
    with contextlib.suppress(FactoryError):
        context.workspace.farm()

"""Starts the web pages of a dataset or of a folder of datasets: address, token, and a server until the block ends."""

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
from starlette.types import ASGIApp

from coordinator.admin import administer as administer_dataset
from coordinator.protocol.ask import OPERATOR
from coordinator.protocol.tls import read_credentials
from coordinator.status.address import HttpAddress, parse_address
from coordinator.status.server import HttpServer
from factory.dataset.marks import Marks
from factory.dataset.site import Site, site_of
from factory.html import compile_templates
from factory.web.access import Access
from factory.web.app import create_app, create_folder_app
from factory.web.context import WebContext
from factory.web.evaluations import Evaluations
from factory.web.figures.store import StatisticsStore
from factory.web.folder import DatasetFolder
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
    host_names: Sequence[str] = (),
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
        host_names: names of the server besides its address.

    Raises:
        UsageError: the address is malformed, or other machines can reach it without a token and without TLS.
        WorldError: the address is in use.
    """
    address = parse_address(http, token, is_encrypted=tls is not None, names=host_names)
    access = Access(token or secrets.token_urlsafe(24), reads_openly=token is None)
    workspace, statistics = Workspace(site, ledger), StatisticsStore(str(site))
    ask = administer or _administrator(site, ledger, tls)
    context = make_context(workspace, ask, statistics, evaluations)
    app = create_app(context, address, access, more_routes)
    with statistics, _served(app, address, access, tls, is_secret=token is not None) as url:
        threading.Thread(target=_prepare, args=(context, renders_ahead), name="prepare", daemon=True).start()
        yield url


@contextmanager
def serve_folder(
    folder: Path, http: str, token: str | None, tls: Path | None = None, host_names: Sequence[str] = ()
) -> Iterator[str]:
    """Serves the web pages of all datasets in a folder while the context is open; yields the URL of their list.

    Datasets that appear in the folder are listed, too. Arguments and errors are those of `serve`.
    """
    address = parse_address(http, token, is_encrypted=tls is not None, names=host_names)
    access = Access(token or secrets.token_urlsafe(24), reads_openly=token is None)

    def open_context(directory: Path, base: str, thumbnails: ThumbnailStore) -> WebContext:
        site = site_of(str(directory))
        ask, statistics = _administrator(site, None, tls), StatisticsStore(str(site))
        return make_context(Workspace(site, base=base), ask, statistics, thumbnails=thumbnails)

    with DatasetFolder(folder, open_context) as datasets:
        app = create_folder_app(datasets, address, access)
        with _served(app, address, access, tls, is_secret=token is not None) as url:
            threading.Thread(target=compile_templates, args=("web",), name="prepare", daemon=True).start()
            yield url


def _administrator(site: Site, ledger: str | None, tls: Path | None) -> Callable[[AdminRequest], AdminReply]:
    """Returns the function that asks the running coordinator of a dataset, or changes the ledger if none runs."""
    files, name = read_credentials(tls) if tls else (None, OPERATOR)

    def ask(request: AdminRequest) -> AdminReply:
        return administer_dataset(site.state_dir, request, datetime.now(UTC), ledger, name=name, tls=files)

    return ask


@contextmanager
def _served(app: ASGIApp, address: HttpAddress, access: Access, tls: Path | None, *, is_secret: bool) -> Iterator[str]:
    """Serves an application; yields its URL, with the token unless it `is_secret`."""
    files = read_credentials(tls)[0] if tls else None
    with HttpServer(app, address, "the web page", files) as server:
        yield server.url + ("" if is_secret else f"/?token={access.token}")


def make_context(
    workspace: Workspace,
    administer: Callable[[AdminRequest], AdminReply],
    statistics: StatisticsStore,
    evaluations: Sequence[Path] = (),
    thumbnails: ThumbnailStore | None = None,
) -> WebContext:
    """Returns the shared state of an application.

    Args:
        workspace: the dataset and its run.
        administer: function that executes an admin request on the run.
        statistics: figures of the dataset.
        evaluations: directories of `factory eval -o`.
        thumbnails: cache of thumbnails, which several datasets may share; `None` makes one.
    """
    return WebContext(
        workspace=workspace,
        farm=Recent(lambda: read_view(workspace), _FARM_AGE_S),
        marks=Marks(workspace.site),
        frames=FrameStore(workspace),
        thumbnails=thumbnails or ThumbnailStore(),
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

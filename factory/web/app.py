"""Builds the web application: routes of all pages, static files, answers to errors, and the access rules.

Design: docs/design/program.md#pages-are-rendered-on-the-server.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from http import HTTPStatus
from pathlib import Path

import structlog
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Receive, Scope, Send

from coordinator.status.address import HttpAddress
from factory.html import render
from factory.html.palette import REASON_COLOURS
from factory.web.access import Access
from factory.web.context import FarmView, WebContext, context_of, page
from factory.web.folder import DATASETS_PATH, MOST_OPEN, DatasetFolder
from factory.web.forms import read_form
from factory.web.guard import RequestGuard, signed_in
from factory.web.pages import (
    datasets as folder_page,
)
from factory.web.pages import (
    episode,
    episodes,
    evaluation,
    farm,
    gallery,
    operations,
    pair,
    scene3d,
    scenes,
    statistics,
)
from factory.web.pages.find import NoEpisode
from factory.web.recent import Recent
from schemas.errors import FactoryError, UsageError

_PAGES = (gallery, episodes, episode, pair, scenes, scene3d, statistics, evaluation, operations)
_STATIC = Path(__file__).parent / "static"
log = structlog.get_logger(__name__)


def create_app(
    context: WebContext, address: HttpAddress, access: Access, more_routes: Iterable[BaseRoute] = ()
) -> ASGIApp:
    """Returns the application of a dataset.

    Args:
        context: state that all requests share.
        address: configured address of the server.
        access: token and reading rights.
        more_routes: additional routes, for example the status pages of a coordinator.
    """
    return RequestGuard(_app_of(context, [*all_routes(context.farm), *more_routes]), address, access)


def create_folder_app(folder: DatasetFolder, address: HttpAddress, access: Access) -> ASGIApp:
    """Returns the application of a folder of datasets: its list of datasets, and all pages of each dataset.

    Args:
        folder: the folder.
        address: configured address of the server.
        access: token and reading rights, the same for all datasets.
    """

    @functools.lru_cache(maxsize=MOST_OPEN)
    def app_of(context: WebContext) -> ASGIApp:
        return _app_of(context, page_routes(context.farm))

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        context = await run_in_threadpool(folder.context_of, scope["path_params"]["name"])
        await app_of(context)(scope, receive, send)

    pages = [*_server_routes(), *folder_page.routes(), Mount(f"{DATASETS_PATH}/{{name}}", answer)]
    return RequestGuard(_app_of(folder, pages), address, access)


def _app_of(context: WebContext | DatasetFolder, routes: Sequence[BaseRoute]) -> Starlette:
    app = Starlette(
        routes=routes,
        exception_handlers={HTTPException: _answer_http_error, FactoryError: _answer_failure, Exception: _answer_bug},
    )
    app.state.context = context
    return app


def all_routes(farm_view: Recent[FarmView]) -> list[BaseRoute]:
    """Returns the routes of a server with one dataset: all pages, their images and their static files.

    Args:
        farm_view: content of the farm page.
    """
    return [*_server_routes(), *page_routes(farm_view)]


def page_routes(farm_view: Recent[FarmView]) -> list[BaseRoute]:
    """Returns the routes of all pages of one dataset and of their images; `farm_view` as in `all_routes`."""
    return [*farm.routes(farm_view), *(route for module in _PAGES for route in module.routes())]


def _server_routes() -> list[BaseRoute]:
    """Returns the routes that are the same for all datasets of a server."""
    return [
        Route("/login", login, methods=["GET", "POST"]),
        Route("/static/page.css", style),
        Mount("/static", StaticFiles(directory=_STATIC)),
    ]


def style(_request: Request) -> Response:
    return Response(_stylesheet(), media_type="text/css", headers={"cache-control": "max-age=300"})


@functools.cache
def _stylesheet() -> str:
    return render("web/page.css", reasons=REASON_COLOURS)


async def login(request: Request) -> Response:
    """Answers with the form for the token, or sets the session cookie."""
    if request.method != "POST":
        return page(request, "login", "Log in", wrong=False)
    token = (await read_form(request, has_key=False)).get("token", "")
    access: Access = request.scope["access"]
    if not access.is_token(token.strip()):
        return page(request, "login", "Log in", 401, wrong=True)
    return signed_in(request.scope, access, "/")


def _answer_http_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    near = error.nearest if isinstance(error, NoEpisode) else ""
    links = [(f"{context_of(request).workspace.base}/episodes/{near}", near)] if near else []
    return _message(request, error.status_code, error.detail, links)


def _answer_failure(request: Request, error: Exception) -> Response:
    return _message(request, 400 if isinstance(error, UsageError) else 503, str(error))


def _answer_bug(request: Request, error: Exception) -> Response:
    log.error("page_failed", path=request.url.path[:80], error=repr(error))
    return _message(request, 500, "the page failed; see the log of the server")


def _message(request: Request, status: int, text: str, links: Sequence[tuple[str, str]] = ()) -> Response:
    if "text/html" not in request.headers.get("accept", "text/html"):
        return PlainTextResponse(f"{text}\n", status)
    title = HTTPStatus(status).phrase
    overview = request.app.state.context.frame.overview
    return page(request, "message", title, status, text=text, links=[*links, overview])

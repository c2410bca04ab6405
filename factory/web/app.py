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
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp

from coordinator.status.address import HttpAddress
from factory.html import render
from factory.html.palette import REASON_COLOURS
from factory.web.access import Access
from factory.web.context import FarmView, WebContext, page
from factory.web.forms import read_form
from factory.web.guard import RequestGuard, signed_in
from factory.web.pages import (
    episode,
    episodes,
    evaluation,
    farm,
    gallery,
    operations,
    scene3d,
    scenes,
    statistics,
)
from factory.web.pages.find import NoEpisode
from factory.web.recent import Recent
from schemas.errors import FactoryError, UsageError

_PAGES = (gallery, episodes, episode, scenes, scene3d, statistics, evaluation, operations)
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
    app = Starlette(
        routes=[*all_routes(context.farm), *more_routes],
        exception_handlers={HTTPException: _answer_http_error, FactoryError: _answer_failure, Exception: _answer_bug},
    )
    app.state.context = context
    return RequestGuard(app, address, access)


def all_routes(farm_view: Recent[FarmView]) -> list[BaseRoute]:
    """Returns the routes of all pages, their images and their static files.

    Args:
        farm_view: content of the farm page.
    """
    return [
        Route("/login", login, methods=["GET", "POST"]),
        Route("/static/page.css", style),
        Mount("/static", StaticFiles(directory=_STATIC)),
        *farm.routes(farm_view),
        *(route for module in _PAGES for route in module.routes()),
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
    return _message(request, error.status_code, error.detail, [(f"/episodes/{near}", near)] if near else [])


def _answer_failure(request: Request, error: Exception) -> Response:
    return _message(request, 400 if isinstance(error, UsageError) else 503, str(error))


def _answer_bug(request: Request, error: Exception) -> Response:
    log.error("page_failed", path=request.url.path[:80], error=repr(error))
    return _message(request, 500, "the page failed; see the log of the server")


def _message(request: Request, status: int, text: str, links: Sequence[tuple[str, str]] = ()) -> Response:
    if "text/html" not in request.headers.get("accept", "text/html"):
        return PlainTextResponse(f"{text}\n", status)
    title = HTTPStatus(status).phrase
    return page(request, "message", title, status, text=text, links=[*links, ("/episodes", "All episodes")])

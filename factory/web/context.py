"""State that all requests of one application share, and how a page is answered."""

from __future__ import annotations

from dataclasses import dataclass

from starlette.requests import Request
from starlette.responses import HTMLResponse, Response

from factory.html import render
from factory.web.workspace import Workspace

NAVIGATION = (("/", "Farm"), ("/episodes", "Episodes"), ("/scenes", "Scenes"), ("/statistics", "Statistics"))
"""Paths and titles of the pages."""


@dataclass(frozen=True)
class WebContext:
    """Parts of one application."""

    workspace: Workspace
    """The dataset and its run."""


def context_of(request: Request) -> WebContext:
    """Returns the state of the application that received a request."""
    found: WebContext = request.app.state.context
    return found


def page(request: Request, template: str, title: str, status: int = 200, **values: object) -> Response:
    """Returns a page of the application.

    Args:
        request: the request.
        template: name of the template without folder and suffix.
        title: title of the page.
        status: HTTP status.
        values: further values of the template.
    """
    scope = request.scope
    path = request.url.path
    here = next((at for at, _ in reversed(NAVIGATION) if path == at or path.startswith(f"{at.rstrip('/')}/")), "")
    text = render(
        f"web/{template}.html",
        title=title,
        run=str(context_of(request).workspace.site),
        navigation=NAVIGATION,
        here=here if path != "/" else "/",
        may_change=scope["may_change"],
        key=scope["access"].form_key if scope["may_change"] else "",
        **values,
    )
    return HTMLResponse(text, status)

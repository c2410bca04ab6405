"""Statistics page: the newest drawn figures of the report, and the progress of newer ones."""

from __future__ import annotations

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from factory.web.context import context_of, page, svg_image


def routes() -> list[Route]:
    return [Route("/statistics", show), Route("/statistics/{name}.svg", image)]


def show(request: Request) -> Response:
    """Answers with the newest figures, or with a page that reloads until the first ones are drawn."""
    context = context_of(request)
    state = context.statistics.of(context.workspace.dataset())
    return page(request, "statistics", "Statistics", state=state, drawn=state.drawn)


def image(request: Request) -> Response:
    """Answers with one drawing of the newest figures."""
    context = context_of(request)
    drawn = context.statistics.of(context.workspace.dataset()).drawn
    svg = drawn.images.get(request.path_params["name"]) if drawn else None
    if svg is None:
        raise HTTPException(404, "no drawing has this name: load the page of statistics again")
    return svg_image(svg)

"""Home page: the gallery of a dataset whose run is over, otherwise the farm page."""

from __future__ import annotations

import contextlib

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from factory.web.context import context_of
from factory.web.pages import farm, gallery
from factory.web.table import TableQuery
from schemas.errors import FactoryError


def routes() -> list[Route]:
    return [Route("/", show)]


def show(request: Request) -> Response:
    context = context_of(request)
    if context.farm.get().is_over and not context.workspace.is_written():
        with contextlib.suppress(FactoryError):  # without tables, the farm page shows what the ledger knows
            return gallery.draw(request, TableQuery())
    return farm.show(request)

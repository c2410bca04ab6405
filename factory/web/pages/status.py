"""Health, readiness and metrics of a coordinator, at the same paths as on a server without the web page."""

from __future__ import annotations

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from coordinator.status.health import StatusSource
from coordinator.status.pages import Pages


def routes(source: StatusSource) -> list[Route]:
    """Returns the routes `/healthz`, `/readyz` and `/metrics`.

    Raises:
        UsageError: the extra `metrics` is not installed.
    """
    pages = Pages(source, None)  # the access rules of the application have checked the token

    async def answer(request: Request) -> Response:
        path = request.url.path
        if path == "/healthz":  # needs no thread: all threads may wait for the ledger
            status, kind, body = pages.answer(path, "")
        else:
            status, kind, body = await run_in_threadpool(pages.answer, path, "")
        return Response(body, status, {"content-type": kind})

    return [Route(path, answer) for path in ("/healthz", "/readyz", "/metrics")]

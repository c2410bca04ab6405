"""Renders the status pages: health and readiness for all clients, metrics for clients with the token, if one is set.

The module opens no socket.
"""

from __future__ import annotations

import hmac
from collections.abc import Callable
from http import HTTPStatus

from coordinator.status.exposition import Exposition
from coordinator.status.health import StatusSource

__all__ = ["Page", "Pages", "plain_page"]

_INDEX = "minivla-factory: /healthz /readyz /metrics\n"
_PLAIN = "text/plain; charset=utf-8"

Page = tuple[HTTPStatus, str, bytes]
"""HTTP status, content type and body."""


class Pages:
    """Status pages of one process.

    Args:
        source: health and metrics of a coordinator or gateway.
        token: token that `/metrics` requires; `None` requires none.

    Raises:
        UsageError: the extra `metrics` is not installed.
    """

    def __init__(self, source: StatusSource, token: str | None) -> None:
        self._source = source
        self._token = token
        self._exposition = Exposition(source.snapshot)
        self._pages: dict[str, Callable[[], Page]] = {
            "/": lambda: (HTTPStatus.OK, _PLAIN, _INDEX.encode()),
            "/healthz": self._health,
            "/readyz": self._readiness,
            "/metrics": self._metrics,
        }

    def answer(self, path: str, authorization: str) -> Page:
        """Returns the page of a path. The call may block while the ledger is read."""
        page = self._pages.get(path)
        if page is None:
            return plain_page(HTTPStatus.NOT_FOUND, _INDEX)
        if path == "/metrics" and not self._is_authorised(authorization):
            return plain_page(HTTPStatus.UNAUTHORIZED, "a bearer token is required")
        return page()

    def _is_authorised(self, authorization: str) -> bool:
        wanted = f"Bearer {self._token}".encode()
        return self._token is None or hmac.compare_digest(authorization.encode("utf-8", "replace"), wanted)

    def _health(self) -> Page:
        if self._source.is_alive():
            return plain_page(HTTPStatus.OK, "ok")
        return plain_page(
            HTTPStatus.SERVICE_UNAVAILABLE, "the thread that everything goes through has ended; restart it"
        )

    def _readiness(self) -> Page:
        troubles = self._source.troubles()
        if troubles:
            return plain_page(HTTPStatus.SERVICE_UNAVAILABLE, "\n".join(troubles))
        return plain_page(HTTPStatus.OK, "ready")

    def _metrics(self) -> Page:
        return HTTPStatus.OK, self._exposition.content_type, self._exposition.page()


def plain_page(status: HTTPStatus, text: str) -> Page:
    """Returns a plain text page."""
    return status, _PLAIN, f"{text.rstrip()}\n".encode()

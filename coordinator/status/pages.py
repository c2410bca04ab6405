"""The status pages: health in one word to any prober, figures to the owner of the token, if there is one."""

from __future__ import annotations

import hmac
from collections.abc import Callable
from http import HTTPStatus

from coordinator.status.exposition import Exposition
from coordinator.status.vitals import Watched

__all__ = ["Page", "Pages", "say"]

_INDEX = "minivla-factory: /healthz /readyz /metrics\n"
_PLAIN = "text/plain; charset=utf-8"

Page = tuple[HTTPStatus, str, bytes]
"""Status, content type, body."""


class Pages:
    """The pages of one process.

    Args:
        vitals: of the coordinator, or of a gateway.
        token: that `/metrics` asks for; `None` asks for none.

    Raises:
        UsageError: the extra `metrics` is not installed.
    """

    def __init__(self, vitals: Watched, token: str | None) -> None:
        self._vitals = vitals
        self._token = token
        self._exposition = Exposition(vitals.snapshot)
        self._pages: dict[str, Callable[[], Page]] = {
            "/": lambda: (HTTPStatus.OK, _PLAIN, _INDEX.encode()),
            "/healthz": self._health,
            "/readyz": self._readiness,
            "/metrics": self._metrics,
        }

    def answer(self, path: str, authorization: str) -> Page:
        """Returns the page of a path; may wait for the ledger."""
        page = self._pages.get(path)
        if page is None:
            return say(HTTPStatus.NOT_FOUND, _INDEX)
        if path == "/metrics" and not self._is_let_in(authorization):
            return say(HTTPStatus.UNAUTHORIZED, "a bearer token is required")
        return page()

    def _is_let_in(self, authorization: str) -> bool:
        wanted = f"Bearer {self._token}".encode()
        return self._token is None or hmac.compare_digest(authorization.encode("utf-8", "replace"), wanted)

    def _health(self) -> Page:
        if self._vitals.is_alive():
            return say(HTTPStatus.OK, "ok")
        return say(HTTPStatus.SERVICE_UNAVAILABLE, "the thread that everything goes through has ended; restart it")

    def _readiness(self) -> Page:
        troubles = self._vitals.troubles()
        if troubles:
            return say(HTTPStatus.SERVICE_UNAVAILABLE, "\n".join(troubles))
        return say(HTTPStatus.OK, "ready")

    def _metrics(self) -> Page:
        return HTTPStatus.OK, self._exposition.content_type, self._exposition.page()


def say(status: HTTPStatus, text: str) -> Page:
    """Returns a page of plain text."""
    return status, _PLAIN, f"{text.rstrip()}\n".encode()

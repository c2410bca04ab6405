"""Refuses requests that do not belong to this server or exceed its limits, and sets the security headers of replies.

The middleware checks method, sizes, host, token and origin before any page is computed. Forms check their key
themselves (`factory.web.forms`).
"""

from __future__ import annotations

from collections.abc import MutableMapping
from typing import Any
from urllib.parse import parse_qsl, urlencode

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import cookie_parser
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from coordinator.status.address import HttpAddress, is_own_name
from factory.web.access import Access, is_same_origin

MOST_QUERY_BYTES = 4096
"""Largest query of a URL, bytes."""
MOST_BODY_BYTES = 64 << 10
"""Largest body of a request, bytes."""
COOKIE = "factory_session"
"""Prefix of the name of the session cookie; the port follows, because browsers share cookies between ports."""
_FREE_PATHS = ("/healthz", "/readyz", "/login")
"""Paths that need no token, in addition to those below `/static/`."""
_HEADERS = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "media-src 'self'; connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}


class RequestGuard:
    """ASGI middleware with the access rules of one server.

    Args:
        app: application that the rules protect.
        address: configured address.
        access: token and reading rights.
    """

    def __init__(self, app: ASGIApp, address: HttpAddress, access: Access) -> None:
        self._app, self._address, self._access = app, address, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuses a request, or passes it to the application."""
        if scope["type"] != "http":
            return await self._app(scope, receive, send)
        headers = Headers(scope=scope)
        self._identify(scope, headers)
        refusal = self._refusal(scope, headers)
        answer: ASGIApp = self._app if refusal is None else refusal

        async def send_safely(message: Message) -> None:
            if message["type"] == "http.response.start":
                _add_headers(MutableHeaders(scope=message))
            await send(message)

        return await answer(scope, receive, send_safely)

    def _identify(self, scope: Scope, headers: Headers) -> None:
        """Records in the scope whether the request may change anything, and whether a form key is required."""
        authorization = headers.get("authorization", "")
        cookie = cookie_parser(headers.get("cookie", "")).get(cookie_name(scope), "")
        scope["may_change"] = self._access.is_authorised(cookie, authorization)
        scope["is_bearer"] = self._access.is_bearer(authorization)
        scope["access"] = self._access

    def _refusal(self, scope: Scope, headers: Headers) -> Response | None:
        method, path = scope["method"], scope["path"]
        if method not in ("GET", "HEAD", "POST"):
            return _plain(405, f"method {method[:20]} is not supported", {"allow": "GET, HEAD, POST"})
        if len(scope["query_string"]) > MOST_QUERY_BYTES:
            return _plain(414, f"the query is longer than {MOST_QUERY_BYTES} bytes")
        host = headers.get("host", "")
        if not is_own_name(host, self._address):
            text = (
                f"{host[:80]!r} is not a name of this server: use the URL that it prints, or start it with --host-name"
            )
            return _plain(421, text)
        return self._refused_change(scope, headers) if method == "POST" else self._refused_read(scope, path)

    def _refused_change(self, scope: Scope, headers: Headers) -> Response | None:
        if not is_same_origin(headers):
            return _plain(403, "the request comes from another web site")
        length = headers.get("content-length", "")
        if not length.isascii() or not length.isdigit():
            return _plain(411, "the header Content-Length is required")
        if int(length[:12]) > MOST_BODY_BYTES:
            return _plain(413, f"the body is larger than {MOST_BODY_BYTES} bytes")
        if scope["path"] != "/login" and not scope["may_change"]:
            return _plain(401, "changes require the token of this server: open /login", {"www-authenticate": "Bearer"})
        return None

    def _refused_read(self, scope: Scope, path: str) -> Response | None:
        query = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        token = dict(query).get("token")
        if token is not None:
            if not self._access.is_token(token):
                return _plain(401, "the token is wrong; the server prints its URL with the token when it starts")
            rest = urlencode([(name, value) for name, value in query if name != "token"])
            return signed_in(scope, self._access, f"/{path.lstrip('/')}" + (f"?{rest}" if rest else ""))
        if self._access.reads_openly or scope["may_change"] or path in _FREE_PATHS or path.startswith("/static/"):
            return None
        if "text/html" in Headers(scope=scope).get("accept", ""):
            return RedirectResponse("/login", 303)
        return _plain(401, "a token is required", {"www-authenticate": "Bearer"})


def cookie_name(scope: MutableMapping[str, Any]) -> str:
    """Returns the name of the session cookie of the server that received a request."""
    return f"{COOKIE}_{(scope.get('server') or ('', 0))[1]}"


def signed_in(scope: Scope, access: Access, target: str) -> Response:
    """Returns a redirect that sets the session cookie."""
    reply = RedirectResponse(target, 303)
    is_secure = scope.get("scheme") == "https"
    reply.set_cookie(cookie_name(scope), access.session, httponly=True, samesite="strict", secure=is_secure)
    return reply


def _add_headers(headers: MutableHeaders) -> None:
    for name, value in _HEADERS.items():
        headers.setdefault(name, value)


def _plain(status: int, text: str, headers: dict[str, str] | None = None) -> Response:
    return PlainTextResponse(f"{text}\n", status, headers)

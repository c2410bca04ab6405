"""Serves the web page of a dataset in this process, and sends requests to it as a browser or an attacker would."""

from __future__ import annotations

import http.client
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from factory.dataset.site import site_of
from factory.web.start import serve, serve_folder


@dataclass(frozen=True)
class WebReply:
    """Answer of the server."""

    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def text(self) -> str:
        return self.body.decode()


@dataclass(frozen=True)
class WebClient:
    """Client of one server. `token` is the server's token."""

    host: str
    token: str

    @property
    def url(self) -> str:
        return f"http://{self.host}"

    def ask(self, path: str, method: str = "GET", body: str | None = None, **headers: str) -> WebReply:
        """Sends a request; `sec_fetch_site` is the header `Sec-Fetch-Site`."""
        connection = http.client.HTTPConnection(self.host, timeout=600)
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request(method, path, body, {"Accept": "text/html", **named})
        reply = connection.getresponse()
        found = WebReply(reply.status, {name.lower(): value for name, value in reply.getheaders()}, reply.read())
        connection.close()
        return found

    def cookie(self) -> str:
        """Logs in with the URL that the server prints; returns the session cookie."""
        reply = self.ask(f"/?token={self.token}")
        assert reply.status == 303
        return reply.headers["set-cookie"].partition(";")[0]

    def post(self, path: str, page: str, **fields: str) -> WebReply:
        """Logs in, reads the key of a form from its page, and sends the form to `path` with this key."""
        cookie = self.cookie()
        key = re.search(r'name="key" value="(\w+)"', self.ask(page, Cookie=cookie).text)
        assert key is not None
        return self.ask(path, "POST", urlencode({"key": key[1], **fields}), Cookie=cookie)


@contextmanager
def web_page(root: Path | str, **options: Any) -> Iterator[WebClient]:
    """Serves the web page of a dataset on a free port of loopback; `options` are those of `serve`."""
    with serve(site_of(str(root)), "127.0.0.1:0", None, **options) as url:
        yield _client(url)


@contextmanager
def web_folder(folder: Path, token: str | None = None) -> Iterator[WebClient]:
    """Serves the datasets of a folder on a free port of loopback."""
    with serve_folder(folder, "127.0.0.1:0", token) as url:
        yield _client(url) if token is None else WebClient(url.removeprefix("http://"), token)


def _client(url: str) -> WebClient:
    host, _, token = url.removeprefix("http://").partition("/?token=")
    return WebClient(host, token)

"""Decides who may read and who may change: token, session cookie and form key. Pure; imports no web framework."""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import urlsplit


@dataclass(frozen=True)
class Access:
    """Access rules of one server."""

    token: str
    """Secret of this server; requests with it may change flags, notes and jobs."""
    reads_openly: bool
    """Whether requests without the token may read: on loopback, or if clients need a certificate."""
    # every user of the machine reaches loopback, but `factory status` and the files of the dataset need no token either

    @property
    def session(self) -> str:
        """Value of the session cookie; the token cannot be computed from it."""
        return self._derived("session")

    @property
    def form_key(self) -> str:
        """Hidden value of every form, which another web site cannot read (CSRF protection)."""
        return self._derived("form")

    def is_token(self, text: str) -> bool:
        """Returns whether a text is the token, in constant time."""
        return _equal(text, self.token)

    def is_bearer(self, authorization: str) -> bool:
        """Returns whether an `Authorization` header contains the token."""
        return _equal(authorization, f"Bearer {self.token}")

    def is_authorised(self, cookie: str, authorization: str) -> bool:
        """Returns whether a request carries the session cookie or the token."""
        return _equal(cookie, self.session) or self.is_bearer(authorization)

    def is_form_key(self, text: str) -> bool:
        return _equal(text, self.form_key)

    def _derived(self, purpose: str) -> str:
        return hmac.new(self.token.encode(), purpose.encode(), hashlib.sha256).hexdigest()


def is_same_origin(headers: Mapping[str, str]) -> bool:
    """Returns whether a request with a change was sent by a page of this server or by a program other than a browser.

    Args:
        headers: headers of the request by lower-case name.
    """
    if headers.get("sec-fetch-site", "none") not in ("same-origin", "none"):
        return False
    origin = headers.get("origin")
    return origin is None or (bool(host := headers.get("host")) and urlsplit(origin).netloc == host)


def _equal(given: str, wanted: str) -> bool:
    return hmac.compare_digest(given.encode("utf-8", "replace"), wanted.encode())

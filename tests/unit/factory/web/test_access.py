"""Tokens, session cookies, form keys and the origin of a request."""

from __future__ import annotations

import pytest

from factory.web.access import Access, is_same_origin

ACCESS = Access("0123456789abcdef", reads_openly=True)


def test_a_request_with_the_cookie_or_the_token_is_authorised():
    assert ACCESS.is_authorised(ACCESS.session, "")
    assert ACCESS.is_authorised("", "Bearer 0123456789abcdef")


@pytest.mark.parametrize(
    ("cookie", "header"), [("", ""), ("0123456789abcdef", ""), ("", "0123456789abcdef"), ("é", "Bearer é")]
)
def test_other_requests_are_not_authorised(cookie, header):
    assert not ACCESS.is_authorised(cookie, header)


def test_cookie_form_key_and_token_are_different_secrets():
    other = Access("0123456789abcdeF", reads_openly=True)
    assert len({ACCESS.token, ACCESS.session, ACCESS.form_key, other.session, other.form_key}) == 5


@pytest.mark.parametrize(
    ("headers", "is_own"),
    [
        ({"host": "localhost:80"}, True),
        ({"host": "localhost:80", "origin": "http://localhost:80"}, True),
        ({"host": "localhost:80", "origin": "http://localhost:80", "sec-fetch-site": "same-origin"}, True),
        ({"host": "localhost:80", "origin": "http://localhost:81"}, False),
        ({"host": "localhost:80", "origin": "null"}, False),
        ({"host": "", "origin": "http://"}, False),
        ({"host": "localhost:80", "sec-fetch-site": "cross-site"}, False),
        ({"host": "localhost:80", "sec-fetch-site": "same-site"}, False),
    ],
)
def test_only_programs_and_pages_of_this_server_may_send_changes(headers, is_own):
    assert is_same_origin(headers) == is_own

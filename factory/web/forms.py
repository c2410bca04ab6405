"""Reads the form of a POST request, with limits and with the key that protects against forged requests."""

from __future__ import annotations

import asyncio
from urllib.parse import parse_qsl

from starlette.exceptions import HTTPException
from starlette.requests import Request

from factory.web.guard import MOST_BODY_BYTES

_BODY_S = 5.0
"""Timeout for receiving a form, seconds."""
_MOST_FIELDS = 200


async def read_form(request: Request, *, has_key: bool = True) -> dict[str, str]:
    """Returns the fields of a form.

    Args:
        request: POST request with a URL-encoded form.
        has_key: whether the form must contain the form key; a request with the token as bearer needs none.

    Raises:
        HTTPException: the form is too large, too slow, malformed, or has a wrong key.
    """
    try:
        async with asyncio.timeout(_BODY_S):
            text = (await _body(request)).decode("utf-8")
        fields = dict(parse_qsl(text, keep_blank_values=True, max_num_fields=_MOST_FIELDS))
    except TimeoutError as error:
        raise HTTPException(408, "the form was not received in time") from error
    except ValueError as error:
        raise HTTPException(400, "the form is malformed") from error
    if has_key and not request.scope["is_bearer"] and not request.scope["access"].is_form_key(fields.get("key", "")):
        raise HTTPException(403, "the key of the form is wrong: load the page again")
    return fields


async def _body(request: Request) -> bytes:
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > MOST_BODY_BYTES:
            raise HTTPException(413, f"the form is larger than {MOST_BODY_BYTES} bytes")
    return body

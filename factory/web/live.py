"""Sends fragments of a page to all open tabs as server-sent events. One poller serves every tab of the process."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable

from starlette.concurrency import run_in_threadpool
from starlette.types import Receive, Scope, Send

from coordinator.status.server import closing_of

_SEND_S = 10.0
"""Timeout of one event for one tab, seconds; a slower tab is disconnected and reconnects."""
_MOST_TABS = 300
_SHARE = 50
"""Minimum ratio of the pause after a call to the CPU time of the call: the poller uses at most 2 % of a core."""


class LiveFeed:
    """Text that is computed repeatedly while a tab listens, and sent when it has changed.

    Args:
        compute: function that returns the current fragment; called in a thread, by one thread at a time.
        pause_s: minimum time between two calls, seconds.
        forget: function that is called before the last call of `compute`, so the last fragment is current even if
            `compute` shares its result with others.
    """

    def __init__(
        self, compute: Callable[[], str], pause_s: float = 3.0, forget: Callable[[], None] = lambda: None
    ) -> None:
        self._compute, self._pause_s, self._forget = compute, pause_s, forget
        self._text, self._version = "", 0
        self._polled = asyncio.Event()
        self._has_ended = False
        self._tabs = 0
        self._poller: asyncio.Task[None] | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI application: sends events until the tab closes. When the server closes, it sends a last event."""
        if self._tabs >= _MOST_TABS:
            await send({"type": "http.response.start", "status": 503, "headers": [(b"retry-after", b"30")]})
            await send({"type": "http.response.body", "body": b"too many open tabs\n"})
            return
        self._tabs += 1
        if self._poller is None or self._poller.done():
            self._poller = asyncio.create_task(self._poll(closing_of(scope)))
        sending = asyncio.create_task(self._send_all(send))
        try:
            while (await receive())["type"] != "http.disconnect":
                pass
        finally:
            self._tabs -= 1
            sending.cancel()
            if not self._tabs and self._poller is not None:
                self._poller.cancel()
                self._poller = None

    async def _send_all(self, send: Send) -> None:
        headers = [(b"content-type", b"text/event-stream; charset=utf-8")]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        seen = 0
        while True:
            await self._polled.wait()  # the previous text may be older than the page of this tab
            if self._version != seen:
                seen = self._version
                async with asyncio.timeout(_SEND_S):
                    await send({"type": "http.response.body", "body": _event(self._text), "more_body": True})
            if self._has_ended:
                await send({"type": "http.response.body", "body": b""})
                return

    async def _poll(self, closing: asyncio.Event) -> None:
        while not self._has_ended:
            self._has_ended = closing.is_set()
            text, cost_s = await run_in_threadpool(self._timed)
            if text != self._text:
                self._text, self._version = text, self._version + 1
            self._polled.set()
            self._polled = asyncio.Event()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(closing.wait(), pause_after(cost_s, self._pause_s))

    def _timed(self) -> tuple[str, float]:
        """Returns the fragment and the CPU time of its computation, seconds."""
        begin_s = time.thread_time()
        if self._has_ended:
            self._forget()
        return self._compute(), time.thread_time() - begin_s


def pause_after(cost_s: float, least_s: float) -> float:
    """Returns the pause after a computation that took `cost_s` of CPU time, at least `least_s`; all in seconds."""
    return max(least_s, _SHARE * cost_s)


def _event(text: str) -> bytes:
    return b"".join(b"data: %s\n" % line.encode() for line in text.split("\n")) + b"\n"

"""Live updates: what tabs receive, and how often a costly page is read."""

from __future__ import annotations

import asyncio
from typing import Any

from factory.web.live import LiveFeed, pause_after
from factory.web.recent import Recent


def test_the_poller_uses_at_most_two_percent_of_a_core() -> None:
    assert pause_after(0.001, 3.0) == 3.0
    for cost_s in (0.1, 1.0, 20.0):
        assert cost_s / (cost_s + pause_after(cost_s, 3.0)) <= 0.02


def test_a_new_tab_receives_the_current_text_and_not_that_of_an_earlier_reading() -> None:
    texts = iter(["old", *["new"] * 1000])
    feed = LiveFeed(lambda: next(texts), pause_s=0.01)

    async def first_event() -> bytes:
        """Opens a tab, returns its first event and closes the tab."""
        received: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        closed = asyncio.Event()

        async def receive() -> dict[str, Any]:
            await closed.wait()
            return {"type": "http.disconnect"}

        tab = asyncio.create_task(feed({"type": "http", "minivla.closing": asyncio.Event()}, receive, received.put))  # type: ignore[arg-type]
        while "body" not in (message := await received.get()):
            pass
        closed.set()
        await tab
        body: bytes = message["body"]
        return body

    async def scenario() -> list[bytes]:
        return [await first_event(), await first_event()]

    assert asyncio.run(scenario()) == [b"data: old\n\n", b"data: new\n\n"]


def test_the_last_event_of_a_closing_server_has_the_current_text_and_not_the_cached_text() -> None:
    state = ["running"]
    shared = Recent(lambda: state[0], 1000.0)
    feed = LiveFeed(shared.get, pause_s=1000.0, forget=shared.forget)

    async def scenario() -> list[bytes]:
        received: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        closing, closed = asyncio.Event(), asyncio.Event()

        async def receive() -> dict[str, Any]:
            await closed.wait()
            return {"type": "http.disconnect"}

        tab = asyncio.create_task(feed({"type": "http", "minivla.closing": closing}, receive, received.put))  # type: ignore[arg-type]
        bodies: list[bytes] = []
        while not bodies or bodies[-1]:
            message = await received.get()
            if "body" in message:
                bodies.append(message["body"])
                state[0] = "finished"
                closing.set()
        closed.set()
        await tab
        return bodies

    assert asyncio.run(scenario()) == [b"data: running\n\n", b"data: finished\n\n", b""]

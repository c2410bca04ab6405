"""The wire between a worker and whom it reaches: a relay that can be cut, and that can lose what is answered."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Sequence
from types import TracebackType
from typing import Self

__all__ = ["Wires"]

_BLOCK = 1 << 16


class _Wire:
    """One relay; lives in the loop's thread."""

    def __init__(self, target: tuple[str, int]) -> None:
        self._target = target
        self._open: set[asyncio.StreamWriter] = set()
        self.is_cut = False
        self.is_mute = False

    async def listen(self) -> int:
        self._server = await asyncio.start_server(self._relay, "127.0.0.1", 0)
        port: int = self._server.sockets[0].getsockname()[1]
        return port

    async def end(self) -> None:
        """Listens no more and resets what is open."""
        self._server.close()
        self.drop_all()

    def drop_all(self) -> None:
        """Resets every connection, as a router that forgets its table does."""
        for writer in list(self._open):
            writer.transport.abort()

    async def _relay(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self.is_cut:
            writer.transport.abort()
            return
        try:
            there_reader, there_writer = await asyncio.open_connection(*self._target)
        except OSError:
            writer.transport.abort()
            return
        both = {writer, there_writer}
        self._open |= both
        try:
            up = self._pump(reader, there_writer, answers=False)
            down = self._pump(there_reader, writer, answers=True)
            done, left = await asyncio.wait(
                {asyncio.ensure_future(up), asyncio.ensure_future(down)}, return_when="FIRST_COMPLETED"
            )
            for task in left:
                task.cancel()
            for task in (*done, *left):
                with contextlib.suppress(asyncio.CancelledError, OSError):
                    await task
        finally:
            self._open -= both
            for side in both:
                side.transport.abort()

    async def _pump(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter, *, answers: bool) -> None:
        while data := await source.read(_BLOCK):
            if not (answers and self.is_mute):
                sink.write(data)
                await sink.drain()


class Wires:
    """A relay a worker, all in one thread; a context manager.

    Args:
        targets: for each worker where its wire leads, `tcp/127.0.0.1:PORT`.
    """

    def __init__(self, targets: Sequence[str]) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="wires")
        self._thread.start()
        self._wires = [_Wire(_address(target)) for target in targets]
        self.endpoints = [f"tcp/127.0.0.1:{self._call(wire.listen())}" for wire in self._wires]

    def cut(self, number: int, seconds: float) -> None:
        """Resets the connections of a worker and lets none through for a while."""

        async def act() -> None:
            wire = self._wires[number]
            wire.is_cut = True
            wire.drop_all()
            self._loop.call_later(seconds, self._heal, wire)

        self._call(act())

    def mute(self, number: int, seconds: float) -> None:
        """Loses whatever a worker is answered for a while, then resets its connections: bytes are missing in them."""

        async def act() -> None:
            wire = self._wires[number]
            wire.is_mute = True
            self._loop.call_later(seconds, self._heal, wire)

        self._call(act())

    def close(self) -> None:
        """Ends all relays."""

        async def act() -> None:
            for wire in self._wires:
                await wire.end()
            tasks = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

        self._call(act())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _heal(self, wire: _Wire) -> None:
        if wire.is_mute:
            wire.drop_all()
        wire.is_cut = wire.is_mute = False

    def _call(self, work):  # type: ignore[no-untyped-def]
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(10)


def _address(endpoint: str) -> tuple[str, int]:
    host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
    return host, int(port)

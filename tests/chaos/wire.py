"""Relays between workers and their endpoints that can cut connections and lose replies."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
import threading
from collections.abc import Sequence

from schemas.support.closing import Closing
from tests.chaos.fault_span import FaultSpan

_BLOCK = 1 << 16
_RESET = struct.pack("ii", 1, 0)
"""Value of SO_LINGER with which closing a socket sends RST instead of FIN."""
_KEEP_ALIVE_BYTES = 16
"""Data up to this size are taken to be keep-alives, which do not count as lost replies."""


class _Wire:
    """One relay; runs in the thread of the event loop."""

    def __init__(self, target: tuple[str, int]) -> None:
        self._target = target
        self._open: set[asyncio.StreamWriter] = set()
        self.is_cut = False
        self.is_mute = False
        self.span = FaultSpan()

    @property
    def is_open(self) -> bool:
        """Whether a client is connected."""
        return any(not writer.is_closing() for writer in self._open)

    async def listen(self) -> int:
        self._server = await asyncio.start_server(self._relay, "127.0.0.1", 0)
        port: int = self._server.sockets[0].getsockname()[1]
        return port

    async def end(self) -> None:
        """Stops listening and resets open connections."""
        self._server.close()
        self.drop_all()

    def drop_all(self) -> int:
        """Resets every connection, like a NAT router that has lost its table; returns the number of closed sockets."""
        writers = [writer for writer in self._open if not writer.is_closing()]
        for writer in writers:
            writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            writer.transport.abort()
        return len(writers)

    async def _relay(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self.is_cut:
            self.span.effects += 1
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
            if answers and self.is_mute:
                self.span.effects += len(data) > _KEEP_ALIVE_BYTES
                continue
            sink.write(data)
            await sink.drain()


class Wires(Closing):
    """A relay for each endpoint of each worker, all in one thread. Context manager.

    Args:
        targets: endpoints of each worker, each `tcp/127.0.0.1:PORT`.
    """

    def __init__(self, targets: Sequence[Sequence[str]]) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="wires")
        self._thread.start()
        self._wires = [[_Wire(_address(target)) for target in endpoints] for endpoints in targets]
        self.endpoints = [[f"tcp/127.0.0.1:{self._call(wire.listen())}" for wire in wires] for wires in self._wires]
        """Addresses of the relays of each worker."""

    def cut(self, number: int, seconds: float) -> FaultSpan | None:
        """Resets the connections of a worker and refuses new ones for `seconds`; `None` if it has no connection."""

        async def act() -> FaultSpan | None:
            span = self._begin(number, seconds)
            if span is None:
                return None
            for wire in self._wires[number]:
                wire.is_cut = True
                span.effects += wire.drop_all()
            return span

        return self._call(act())

    def mute(self, number: int, seconds: float) -> FaultSpan | None:
        """Drops the replies to a worker for `seconds`, then resets its connections, because their data are incomplete.

        Returns:
            Span of the fault; `None` if the worker has no connection or is already muted.
        """

        async def act() -> FaultSpan | None:
            span = self._begin(number, seconds)
            if span is None:
                return None
            for wire in self._wires[number]:
                wire.is_mute = True
            return span

        return self._call(act())

    def close(self) -> None:
        """Ends all relays."""

        async def act() -> None:
            for wire in (wire for wires in self._wires for wire in wires):
                await wire.end()
            tasks = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

        self._call(act())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def _begin(self, number: int, seconds: float) -> FaultSpan | None:
        wires, span = self._wires[number], FaultSpan()
        if any(wire.is_cut or wire.is_mute for wire in wires) or not any(wire.is_open for wire in wires):
            return None
        for wire in wires:
            wire.span = span
        self._loop.call_later(seconds, self._heal, wires)
        return span

    def _heal(self, wires: Sequence[_Wire]) -> None:
        for wire in wires:
            if wire.is_mute:
                wire.drop_all()
            wire.is_cut = wire.is_mute = False

    def _call(self, work):  # type: ignore[no-untyped-def]
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(10)


def _address(endpoint: str) -> tuple[str, int]:
    host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
    return host, int(port)

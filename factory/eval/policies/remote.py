"""A policy behind a websocket, spoken to as openpi's client does: metadata on connect, observation in, actions out.

One question at a time; what the server sends is bounded and never unpickled.
"""

from __future__ import annotations

import time
from contextlib import ExitStack, suppress
from typing import Any

from factory.eval.driving.policy import EpisodeInfo, PolicyFailure, PolicyFault, PolicyInput, ServerAway
from factory.eval.policies.outside import Outside
from factory.eval.policies.wire import MAX_ANSWER_BYTES, WireError, pack, unpack
from schemas.errors import UsageError
from schemas.support.extras import missing_package

__all__ = ["RemotePolicy"]

_OPEN_S, _CLOSE_S = 5.0, 0.5
_RETRY_S = 0.5


class RemotePolicy:
    """Asks a server for each action.

    The observation travels as `rgb`, `depth`, `prompt` (the instruction), `step` (0 begins an episode), `episode` and
    `seed`, and `pose` where it is given; the answer holds `actions` (v, w) or `tokens`, as (2,) or as a chunk (H, 2).
    """

    def __init__(self, address: str, outside: Outside) -> None:
        self._address = address
        self._outside = outside
        self._connection: Any = None
        self._has_answered = False
        """Over this connection; the first answer of one may take long."""
        self._held = ExitStack()
        self._connect(min(outside.reconnect_s, outside.load_timeout_s))

    def reset(self, instruction: str, info: EpisodeInfo) -> None:
        """Notes what goes with every observation; the server hears of it with step 0."""
        self._fixed = {"prompt": instruction, "episode": info.episode, "seed": info.seed}
        if self._connection is None:
            self._connect(self._outside.reconnect_s)

    def act(self, observation: PolicyInput) -> Any:
        """Returns the server's answer, for the caller to judge.

        Raises:
            PolicyFailure: the server is late, reports an error, answers rubbish or closes the connection.
        """
        message = {**self._fixed, **{key: value for key, value in observation.items() if key != "instruction"}}
        answer = self._ask(pack(message))
        if isinstance(answer, str):
            lines = answer.strip().splitlines() or ["no text"]
            raise PolicyFailure(PolicyFault.RAISED, f"the server reports an error: {lines[-1][:300]}")
        try:
            return unpack(answer)
        except WireError as error:
            raise PolicyFailure(PolicyFault.INVALID, f"the server's answer {error}") from error

    def close(self) -> None:
        """Closes the connection; closing twice is harmless."""
        self._connection = None
        with suppress(Exception):  # whatever state the other side left it in
            self._held.close()

    def _ask(self, data: bytes) -> Any:
        from websockets.exceptions import ConnectionClosed

        limit_s = self._outside.act_timeout_s if self._has_answered else self._outside.load_timeout_s
        try:
            self._connection.send(data)
            answer = self._connection.recv(timeout=limit_s)
        except TimeoutError as error:
            self.close()  # a late answer would be taken for the next one
            raise PolicyFailure(PolicyFault.HUNG, f"no answer from {self._address} within {limit_s:g} s") from error
        except (ConnectionClosed, OSError) as error:
            self.close()
            detail = f"{self._address} closed the connection: {error}"
            raise PolicyFailure(PolicyFault.LOST, detail) from error
        self._has_answered = True
        return answer

    def _connect(self, patience_s: float) -> None:
        """Connects and takes the server's metadata.

        Raises:
            ServerAway: nobody answers there for as long as that.
        """
        deadline = time.monotonic() + patience_s
        while True:
            try:
                self._connection = self._open()
                self._has_answered = False
                return
            except (OSError, TimeoutError, EOFError) as error:
                reason = f"{type(error).__name__}: {error}"
            if time.monotonic() >= deadline:
                raise ServerAway(f"no policy server at {self._address} for {patience_s:g} s ({reason})")
            time.sleep(_RETRY_S)

    def _open(self) -> Any:
        connect, closed, bad = _client()
        with ExitStack() as held:
            try:
                connection = held.enter_context(
                    connect(
                        self._address,
                        compression=None,
                        max_size=MAX_ANSWER_BYTES,
                        open_timeout=_OPEN_S,
                        close_timeout=_CLOSE_S,
                        ping_interval=None,
                    )
                )
                self.metadata = unpack(connection.recv(timeout=self._outside.load_timeout_s))
            except bad as error:
                raise UsageError(f"policy server {self._address}: {error}; write ws://HOST:PORT") from error
            except (WireError, TypeError) as error:
                what = f"{self._address} is not an openpi policy server"
                raise UsageError(f"{what}: its greeting {error}") from error
            except closed as error:
                raise OSError(str(error)) from error
            self._held = held.pop_all()
        return connection


def _client() -> tuple[Any, type[Exception], type[Exception]]:
    try:
        from websockets.exceptions import InvalidURI, WebSocketException
        from websockets.sync.client import connect
    except ImportError as error:
        raise missing_package("websockets", "a remote policy") from error
    return connect, WebSocketException, InvalidURI

"""Policy on a websocket server with the protocol of openpi's client: metadata on connect, observation in, actions out.

Sends one request at a time. The size of a reply is limited, and replies are never unpickled. Runs no model itself.
Arrays are encoded in msgpack with the keys of `openpi_client.msgpack_numpy`: a map of data, dtype and shape.
"""

from __future__ import annotations

import math
import time
import weakref
from contextlib import ExitStack, suppress
from typing import Any

import numpy as np

from factory.eval.driving.policy import EpisodeInfo, PolicyFailure, PolicyFault, PolicyInput, ServerUnreachable
from factory.eval.models.messages import PolicyLimits
from schemas.errors import UsageError
from schemas.support.extras import missing_package

MAX_ANSWER_BYTES = 16 << 20
_KINDS = "biuf"
"""Supported dtype kinds: bool, integers, unsigned integers and floats; no objects, records or complex numbers."""
_OPEN_S, _CLOSE_S = 5.0, 0.5
_RETRY_S = 0.5


class WireError(Exception):
    """Invalid message bytes, or a value that cannot be encoded."""


def pack(message: Any) -> bytes:
    """Encodes a message as msgpack.

    Raises:
        WireError: The message contains a value that cannot be encoded.
    """
    try:
        data: bytes = _msgpack().packb(message, default=_pack_numpy)
    except (TypeError, ValueError, OverflowError) as error:
        raise WireError(f"cannot be encoded: {error}") from error
    return data


def unpack(data: bytes) -> Any:
    """Decodes a msgpack message; arrays share the memory of `data` and are read-only.

    Raises:
        WireError: The bytes are not a valid message, or an array in it is inconsistent.
    """
    try:
        return _msgpack().unpackb(data, object_hook=_unpack_numpy, strict_map_key=False)
    except WireError:
        raise
    except Exception as error:  # the extension raises many exception types
        raise WireError(f"is not a valid msgpack message: {type(error).__name__}: {error}") from error


def _pack_numpy(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype.kind in _KINDS:
        return {b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}
    if isinstance(value, np.generic) and value.dtype.kind in _KINDS:
        return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}
    raise TypeError(f"{type(value).__name__} {getattr(value, 'dtype', '')}".strip())


def _unpack_numpy(message: dict[Any, Any]) -> Any:
    if b"__ndarray__" in message:
        dtype, shape, data = _dtype(message), tuple(message.get(b"shape", ())), message.get(b"data", b"")
        if not all(isinstance(side, int) and side >= 0 for side in shape) or not isinstance(data, bytes):
            raise WireError(f"contains an array of shape {shape!r}")
        if math.prod(shape) * dtype.itemsize != len(data):
            raise WireError(f"contains an array {dtype.str} {shape} in {len(data)} bytes")
        return np.frombuffer(data, dtype).reshape(shape)
    if b"__npgeneric__" in message:
        return _dtype(message).type(message.get(b"data"))
    return message


def _dtype(header: dict[Any, Any]) -> np.dtype[Any]:
    name = header.get(b"dtype")
    try:
        dtype = np.dtype(name) if isinstance(name, str) else None
    except TypeError:
        dtype = None
    if dtype is None or dtype.kind not in _KINDS:
        raise WireError(f"contains an array of dtype {name!r}")
    return dtype


def _msgpack() -> Any:
    try:
        import msgpack
    except ImportError as error:
        raise missing_package("msgpack", "a remote policy") from error
    return msgpack


_OPEN: weakref.WeakSet[RemotePolicy] = weakref.WeakSet()


def close_connections() -> None:
    """Closes the connections of this process, so that no server logs the end of an evaluation as an error."""
    for policy in list(_OPEN):
        policy.close()


class RemotePolicy:
    """Policy that requests each action from a server.

    A request contains `rgb`, `depth`, `state`, `prompt` (the instruction), `step` (0 starts an episode), `episode` and
    `seed`, with `--pose` also `pose`, and with a rig `sensors` (maps of arrays by sensor). The reply contains `actions`
    (v, w) or `tokens`, of shape (2,) or as a chunk (H, 2).
    """

    def __init__(self, address: str, limits: PolicyLimits) -> None:
        self._address = address
        self._limits = limits
        self._connection: Any = None
        self._has_answered = False
        """Whether this connection has received a reply; the first reply has a longer timeout."""
        self._held = ExitStack()
        _OPEN.add(self)
        self._connect(min(limits.reconnect_s, limits.load_timeout_s))

    @property
    def needs(self) -> tuple[str, ...]:
        """Inputs without which the policy is refused: the list `needs` of the server's greeting."""
        needs = self.metadata.get("needs", ()) if isinstance(self.metadata, dict) else ()
        return tuple(map(str, needs)) if isinstance(needs, list | tuple) else ()

    def reset(self, instruction: str, info: EpisodeInfo) -> None:
        """Stores the fields sent with every observation; step 0 starts a new episode at the server."""
        self._fixed = {"prompt": instruction, "episode": info.episode, "seed": info.seed}
        if self._connection is None:
            self._connect(self._limits.reconnect_s)

    def act(self, observation: PolicyInput) -> Any:
        """Returns the reply of the server, which the caller validates.

        Raises:
            PolicyFailure: The server timed out, reported an error, sent an invalid reply or closed the connection.
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
        """Closes the connection; can be called more than once."""
        self._connection = None
        with suppress(Exception):  # the connection may be in any state
            self._held.close()

    def _ask(self, data: bytes) -> Any:
        from websockets.exceptions import ConnectionClosed

        limit_s = self._limits.act_timeout_s if self._has_answered else self._limits.load_timeout_s
        try:
            self._connection.send(data)
            answer = self._connection.recv(timeout=limit_s)
        except TimeoutError as error:
            self.close()  # otherwise a late reply would be read as the next one
            raise PolicyFailure(PolicyFault.HUNG, f"no answer from {self._address} within {limit_s:g} s") from error
        except (ConnectionClosed, OSError) as error:
            self.close()
            detail = f"{self._address} closed the connection: {error}"
            raise PolicyFailure(PolicyFault.LOST, detail) from error
        self._has_answered = True
        return answer

    def _connect(self, patience_s: float) -> None:
        """Connects to the server and reads its metadata.

        Raises:
            ServerUnreachable: The server did not accept a connection within `patience_s`.
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
                raise ServerUnreachable(
                    f"no policy server responded at {self._address} for {patience_s:g} s ({reason})"
                )
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
                self.metadata = unpack(connection.recv(timeout=self._limits.load_timeout_s))
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

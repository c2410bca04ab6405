"""Arrays in msgpack as openpi's client packs them: a map of data, dtype and shape; never pickle. Bytes to values, pure.

The keys are those of `openpi_client.msgpack_numpy`, so that its servers and ours understand each other.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from schemas.support.extras import missing_package

__all__ = ["MAX_ANSWER_BYTES", "WireError", "pack", "unpack"]

MAX_ANSWER_BYTES = 16 << 20
_KINDS = "biuf"
"""Kinds of dtype that may travel: no objects, no records, no complex numbers."""


class WireError(Exception):
    """Bytes that are no message, or a value that cannot travel."""


def pack(message: Any) -> bytes:
    """Returns a message as msgpack.

    Raises:
        WireError: it holds something that cannot travel.
    """
    try:
        data: bytes = _msgpack().packb(message, default=_pack_numpy)
    except (TypeError, ValueError, OverflowError) as error:
        raise WireError(f"cannot be packed: {error}") from error
    return data


def unpack(data: bytes) -> Any:
    """Returns the message in msgpack bytes; arrays share the memory of `data` and are read-only.

    Raises:
        WireError: it is no message, or an array in it contradicts itself.
    """
    try:
        return _msgpack().unpackb(data, object_hook=_unpack_numpy, strict_map_key=False)
    except WireError:
        raise
    except Exception as error:  # the extension raises a dozen types of its own
        raise WireError(f"is not a valid msgpack message: {type(error).__name__}: {error}") from error


def _pack_numpy(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype.kind in _KINDS:
        return {b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}
    if isinstance(value, np.generic) and value.dtype.kind in _KINDS:
        return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}
    raise TypeError(f"{type(value).__name__} {getattr(value, 'dtype', '')}".strip())


def _unpack_numpy(found: dict[Any, Any]) -> Any:
    if b"__ndarray__" in found:
        dtype, shape, data = _dtype(found), tuple(found.get(b"shape", ())), found.get(b"data", b"")
        if not all(isinstance(side, int) and side >= 0 for side in shape) or not isinstance(data, bytes):
            raise WireError(f"contains an array of shape {shape!r}")
        if math.prod(shape) * dtype.itemsize != len(data):
            raise WireError(f"contains an array {dtype.str} {shape} in {len(data)} bytes")
        return np.frombuffer(data, dtype).reshape(shape)
    if b"__npgeneric__" in found:
        return _dtype(found).type(found.get(b"data"))
    return found


def _dtype(found: dict[Any, Any]) -> np.dtype[Any]:
    name = found.get(b"dtype")
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

"""Reads Protobuf's wire format without any schema: numbers of fields and raw values. Knows nothing of our writer."""

from __future__ import annotations

import struct
from typing import Any

__all__ = ["read_fields"]


def read_fields(data: bytes) -> dict[int, list[Any]]:
    """Returns field number -> values: whole numbers, doubles (8 bytes), fixed32 (4 bytes) or bytes."""
    found: dict[int, list[Any]] = {}
    position = 0
    while position < len(data):
        key, position = _varint(data, position)
        number, wire = key >> 3, key & 7
        value: Any
        if wire == 0:
            value, position = _varint(data, position)
        elif wire == 1:
            (value,) = struct.unpack_from("<d", data, position)
            position += 8
        elif wire == 2:
            size, position = _varint(data, position)
            value = data[position : position + size]
            position += size
        elif wire == 5:
            (value,) = struct.unpack_from("<I", data, position)
            position += 4
        else:
            raise ValueError(f"wire type {wire}")
        found.setdefault(number, []).append(value)
    return found


def _varint(data: bytes, position: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[position]
        position += 1
        value |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            return value, position

"""Decodes and encodes structures of Thrift's compact protocol, which describe the contents of a Parquet file.

Keeps every field in its order, so an unchanged structure is encoded to the same bytes. Does not interpret fields.

Design: docs/design/data.md#unchanged-row-groups-are-copied.
"""

from __future__ import annotations

from typing import Any, NamedTuple

_TRUE, _FALSE, _BYTE, _I16, _I64, _DOUBLE, _BINARY, _LIST, STRUCT = 1, 2, 3, 4, 6, 7, 8, 9, 12
_LONG_LIST = 15


class Field(NamedTuple):
    """Field of a structure."""

    id: int
    """Number of the field in its structure."""
    kind: int
    """Type of the value in the compact protocol."""
    value: Any
    """Integer, bytes, `Items` or, for a structure, a list of fields."""


class Items(NamedTuple):
    """Value of a field that is a list."""

    kind: int
    """Type of the items."""
    values: list[Any]
    """Items."""


def decode(data: bytes) -> list[Field]:
    """Returns the fields of a structure.

    Raises:
        ValueError: the data contains a type that Parquet files do not use.
        IndexError: the data is truncated.
    """
    return _Decoder(data).struct()


class _Decoder:
    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def struct(self) -> list[Field]:
        fields: list[Field] = []
        number = 0
        while head := self._byte():
            number = number + (head >> 4) if head >> 4 else self._zigzag()
            fields.append(Field(number, head & 15, self._value(head & 15)))
        return fields

    def _value(self, kind: int) -> Any:
        if kind in (_TRUE, _FALSE):
            return kind == _TRUE
        if kind == _BYTE:
            return self._byte()
        if _I16 <= kind <= _I64:
            return self._zigzag()
        if kind in (_DOUBLE, _BINARY):
            return self._bytes(8 if kind == _DOUBLE else self._varint())
        if kind == _LIST:
            head = self._byte()
            count = self._varint() if head >> 4 == _LONG_LIST else head >> 4
            return Items(head & 15, [self._item(head & 15) for _ in range(count)])
        if kind == STRUCT:
            return self.struct()
        raise ValueError(f"Thrift type {kind}")

    def _item(self, kind: int) -> Any:
        return self._byte() if kind in (_TRUE, _FALSE) else self._value(kind)

    def _byte(self) -> int:
        self._at += 1
        return self._data[self._at - 1]

    def _bytes(self, count: int) -> bytes:
        self._at += count
        return self._data[self._at - count : self._at]

    def _varint(self) -> int:
        value = shift = 0
        while True:
            byte = self._byte()
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value
            shift += 7

    def _zigzag(self) -> int:
        value = self._varint()
        return value >> 1 ^ -(value & 1)


def encode(fields: list[Field]) -> bytes:
    """Returns the bytes of a structure; nested structures may be given as encoded bytes."""
    out, last = bytearray(), 0
    for number, kind, value in fields:
        if 0 < number - last <= 15:
            out.append((number - last) << 4 | kind)
        else:
            out.append(kind)
            _put_zigzag(out, number)
        last = number
        if kind not in (_TRUE, _FALSE):
            _put_value(out, kind, value)
    out.append(0)
    return bytes(out)


def _put_value(out: bytearray, kind: int, value: Any) -> None:
    if _I16 <= kind <= _I64:
        _put_zigzag(out, value)
    elif kind == STRUCT:
        out += value if isinstance(value, bytes) else encode(value)
    elif kind == _LIST:
        count = len(value.values)
        out.append(min(count, _LONG_LIST) << 4 | value.kind)
        if count >= _LONG_LIST:
            _put_varint(out, count)
        for item in value.values:
            _put_value(out, value.kind, item)
    elif isinstance(value, int):
        out.append(value)
    else:
        if kind == _BINARY:
            _put_varint(out, len(value))
        out += value


def _put_zigzag(out: bytearray, value: int) -> None:
    _put_varint(out, value << 1 if value >= 0 else ~value << 1 | 1)


def _put_varint(out: bytearray, value: int) -> None:
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)

"""Protobuf's wire format for the messages of `mcap_schemas`, and the descriptors that readers need. Pure; writes only.

Equal values give equal bytes: fields in the order of their numbers, defaults left out, as Google's own encoder does.
Google's library is not used: it and the classes generated for Foxglove's schemas would be two more dependencies.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from factory.export.mcap_schemas import ENUMS, MESSAGES

__all__ = ["descriptor_set", "encode"]

_WELL_KNOWN = "google.protobuf."
_VARINT, _FIXED64, _LENGTH, _FIXED32 = 0, 1, 2, 5
_MESSAGE, _ENUM = 11, 14
_SCALARS = {  # name: (number of the type in a descriptor, wire type)
    "double": (1, _FIXED64),
    "int64": (3, _VARINT),
    "int32": (5, _VARINT),
    "fixed32": (7, _FIXED32),
    "bool": (8, _VARINT),
    "string": (9, _LENGTH),
    "bytes": (12, _LENGTH),
}
_PACKED = {"double": "d", "fixed32": "I"}
_OPTIONAL, _REPEATED = 1, 3


class _Field(NamedTuple):
    name: str
    kind: str
    """A scalar, or the full name of a message or an enum."""
    number: int
    is_repeated: bool


def encode(message: str, values: Mapping[str, Any]) -> bytes:
    """Returns the bytes of a message.

    Args:
        message: its full name, a key of `MESSAGES`.
        values: field -> value; messages as mappings, repeated fields as sequences. Fields may be left out.

    Raises:
        KeyError: the message or a field does not exist.
    """
    fields = _fields_of(message)
    stray = values.keys() - {field.name for field in fields}
    if stray:
        raise KeyError(f"{message} has no field {', '.join(sorted(stray))}")
    return b"".join(part for field in fields if field.name in values for part in _parts(field, values[field.name]))


@functools.cache
def descriptor_set(message: str) -> bytes:
    """Returns the FileDescriptorSet with which a reader decodes a message: its package and what that rests on."""
    names = sorted(_closure(message))
    packages = sorted({_package(name) for name in names}, key=lambda package: (package != "google.protobuf", package))
    files: list[dict[str, Any]] = []
    for package in packages:
        inside = [name for name in names if _package(name) == package]
        if package == "google.protobuf":  # readers know these files by name
            files += [_file(f"google/protobuf/{_leaf(name).lower()}.proto", package, (), [name]) for name in inside]
        else:
            files.append(_file(f"{package}.proto", package, [file["name"] for file in files], inside))
    return encode(f"{_WELL_KNOWN}FileDescriptorSet", {"file": files})


@functools.cache
def _fields_of(message: str) -> tuple[_Field, ...]:
    fields = []
    for word in MESSAGES[message].split():
        name, _, rest = word.partition(":")
        kind, _, number = rest.partition("=")
        fields.append(_Field(name, kind.lstrip("*"), int(number), kind.startswith("*")))
    return tuple(sorted(fields, key=lambda field: field.number))


def _parts(field: _Field, value: Any) -> Iterator[bytes]:
    if not field.is_repeated:
        body = _body(field, value)
        if field.kind in MESSAGES or not _is_default(field, body):
            yield _tagged(field, body)
    elif field.kind in _PACKED:
        packed = struct.pack(f"<{len(value)}{_PACKED[field.kind]}", *value)
        if packed:
            yield _key(field.number, _LENGTH) + _varint(len(packed)) + packed
    else:
        for item in value:
            yield _tagged(field, _body(field, item))


def _body(field: _Field, value: Any) -> bytes:
    if field.kind in MESSAGES:
        return encode(field.kind, value)
    if field.kind == "string":
        return str(value).encode()
    if field.kind == "bytes":
        return bytes(value)
    if field.kind in _PACKED:
        return struct.pack(f"<{_PACKED[field.kind]}", value)
    return _varint(int(value) & 0xFFFF_FFFF_FFFF_FFFF)


def _is_default(field: _Field, body: bytes) -> bool:
    return not any(body) if field.kind not in ("string", "bytes") else not body


def _tagged(field: _Field, body: bytes) -> bytes:
    wire = _wire_of(field.kind)
    size = _varint(len(body)) if wire == _LENGTH else b""
    return _key(field.number, wire) + size + body


def _wire_of(kind: str) -> int:
    if kind in MESSAGES:
        return _LENGTH
    return _VARINT if kind in ENUMS else _SCALARS[kind][1]


def _key(number: int, wire: int) -> bytes:
    return _varint(number << 3 | wire)


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _closure(message: str) -> set[str]:
    found: set[str] = set()
    waiting = [message]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += [field.kind for field in _fields_of(name) if field.kind in MESSAGES]
    return found


def _package(name: str) -> str:
    return name.rpartition(".")[0]


def _leaf(name: str) -> str:
    return name.rpartition(".")[2]


def _file(name: str, package: str, rests_on: Iterable[str], messages: Iterable[str]) -> dict[str, Any]:
    described = [_describe(message) for message in messages]
    return {
        "name": name,
        "package": package,
        "dependency": list(rests_on),
        "message_type": described,
        "syntax": "proto3",
    }


def _describe(message: str) -> dict[str, Any]:
    enums = sorted(name for name in ENUMS if _package(name) == message)
    return {
        "name": _leaf(message),
        "field": [_describe_field(field) for field in _fields_of(message)],
        "enum_type": [
            {"name": _leaf(name), "value": [{"name": value, "number": i} for i, value in enumerate(ENUMS[name])]}
            for name in enums
        ],
    }


def _describe_field(field: _Field) -> dict[str, Any]:
    described = {
        "name": field.name,
        "number": field.number,
        "label": _REPEATED if field.is_repeated else _OPTIONAL,
    }
    if field.kind in _SCALARS:
        return {**described, "type": _SCALARS[field.kind][0]}
    return {**described, "type": _MESSAGE if field.kind in MESSAGES else _ENUM, "type_name": f".{field.kind}"}

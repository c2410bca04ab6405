"""Encodes ROS 2 messages as CDR and returns their definitions. The only module that imports `rosbags`."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

_DTYPES = {"octet": "uint8", "char": "uint8", "byte": "uint8"}
_BASE, _NAME = 1, 2
"""Values of `rosbags.interfaces.Nodetype` for a base type and a message type; 3 is an array, 4 a sequence."""

_VISION = {
    "vision_msgs/msg/VisionClass": "uint16 class_id\nstring class_name\n",
    "vision_msgs/msg/LabelInfo": "std_msgs/Header header\nvision_msgs/VisionClass[] class_map\nfloat32 threshold\n",
}
"""Message type -> fields, as in vision_msgs 4 (Humble and later), which `rosbags` does not have."""


def encode(kind: str, values: Mapping[str, Any]) -> bytes:
    """Returns the bytes of a message; equal values give equal bytes.

    Args:
        kind: message type, e.g. `nav_msgs/msg/Odometry`.
        values: field -> value; messages as mappings, arrays as sequences. Omitted fields are zero or empty.

    Raises:
        KeyError: the message type or a field is unknown.
    """
    # rosbags serialises the message only: its writer of files cannot write attachments
    store = _store()
    return bytes(store.serialize_cdr(_message(store, kind, values), kind))


@functools.cache
def definition_of(kind: str) -> bytes:
    """Returns the definition of a message type and of its nested types, in the format of `ros2msg` schemas."""
    text, _ = _store().generate_msgdef(kind, ros_version=2)
    return str(text).encode()


@functools.cache
def _store() -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)  # Jazzy has the same definitions of the types used here
    for kind, fields in _VISION.items():
        store.register(get_types_from_msg(fields, kind))
    return store


def _message(store: Any, kind: str, values: Mapping[str, Any]) -> Any:
    fields = store.fielddefs[kind][1]
    stray = values.keys() - {name for name, _ in fields}
    if stray:
        raise KeyError(f"{kind} has no field {', '.join(sorted(stray))}")
    return store.types[kind](**{name: _value(store, field, values.get(name)) for name, field in fields})


def _value(store: Any, field: tuple[int, Any], value: Any) -> Any:
    node, details = field
    if node == _NAME:
        return _message(store, details, value or {})
    if node == _BASE:
        empty: str | int = "" if details[0] == "string" else 0
        return empty if value is None else value
    (of_item, item), length = details
    if of_item == _NAME:
        return [_message(store, item, one) for one in value or ()]
    return _numbers(item[0], value, length)


def _numbers(kind: str, value: Sequence[float] | bytes | None, length: int) -> Any:
    """Returns an array of numbers; zeros by default."""
    dtype = np.dtype(_DTYPES.get(kind, kind))
    if isinstance(value, bytes):
        return np.frombuffer(value, dtype)
    return np.zeros(length, dtype) if value is None else np.asarray(value, dtype)

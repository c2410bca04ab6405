"""Encodes messages of Foxglove, `minivla.Action` and `minivla.Imu` as Protobuf, and returns their descriptors.

The only module that imports `protobuf` and the generated classes of Foxglove. Does not decode messages.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Mapping
from typing import Any

ACTION = "minivla.Action"
"""Message type that is not part of Foxglove's schemas."""
IMU = "minivla.Imu"
"""Message type of an IMU, which Foxglove's schemas do not have."""
_TIME, _VECTOR = ".google.protobuf.Timestamp", ".foxglove.Vector3"
_FIELDS = {
    ACTION: (
        ("timestamp", _TIME),
        ("v_mps", "TYPE_DOUBLE"),
        ("w_rps", "TYPE_DOUBLE"),
        ("v_token", "TYPE_INT32"),
        ("w_token", "TYPE_INT32"),
    ),
    IMU: (
        ("timestamp", _TIME),
        ("frame_id", "TYPE_STRING"),
        ("angular_velocity", _VECTOR),
        ("linear_acceleration", _VECTOR),
    ),
}
"""Message type -> fields, numbered from 1, with the type of their values: a scalar or a message."""


def encode(message: str, values: Mapping[str, Any]) -> bytes:
    """Returns the bytes of a message; equal values give equal bytes.

    Args:
        message: full name of the message type, e.g. `foxglove.Odometry`.
        values: field -> value; messages as mappings, repeated fields as sequences. Fields can be omitted.

    Raises:
        ValueError: the message does not have a field.
        ModuleNotFoundError: the message type is unknown.
    """
    # not JSON, which needs base64 for images, and not foxglove-sdk, whose wheel takes 19 MB
    data: bytes = _class_of(message)(**values).SerializeToString(deterministic=True)
    return data


@functools.cache
def descriptor_set(message: str) -> bytes:
    """Returns the FileDescriptorSet of a message type: its file and all imported files."""
    from mcap_protobuf.schema import build_file_descriptor_set

    data: bytes = build_file_descriptor_set(_class_of(message)).SerializeToString(deterministic=True)
    return data


@functools.cache
def _class_of(message: str) -> Any:
    if message in _FIELDS:
        return _class_of_fields(message)
    package, _, name = message.rpartition(".")
    return getattr(importlib.import_module(f"{package}_schemas_protobuf.{name}_pb2"), name)


def _class_of_fields(message: str) -> Any:
    from foxglove_schemas_protobuf import Vector3_pb2
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

    package, _, name = message.rpartition(".")
    kinds = {kind for _, kind in _FIELDS[message]}
    imports = [file.DESCRIPTOR for kind, file in ((_TIME, timestamp_pb2), (_VECTOR, Vector3_pb2)) if kind in kinds]
    file = descriptor_pb2.FileDescriptorProto(
        name="minivla.proto",
        package=package,
        syntax="proto3",
        dependency=[imported.name for imported in imports],
        message_type=[{"name": name, "field": [_field(*field) for field in enumerate(_FIELDS[message], 1)]}],
    )
    pool = descriptor_pool.DescriptorPool()
    for data in (*(imported.serialized_pb for imported in imports), file.SerializeToString()):
        pool.AddSerializedFile(data)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(message))


def _field(number: int, field: tuple[str, str]) -> dict[str, Any]:
    name, kind = field
    values = {"name": name, "number": number, "label": "LABEL_OPTIONAL"}
    return values | ({"type": "TYPE_MESSAGE", "type_name": kind} if kind.startswith(".") else {"type": kind})

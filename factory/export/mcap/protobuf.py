"""Encodes messages of Foxglove and `minivla.Action` as Protobuf, and returns the descriptors that readers need.

The only module that imports `protobuf` and the generated classes of Foxglove. Does not decode messages.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Mapping
from typing import Any

ACTION = "minivla.Action"
"""Message type that is not part of Foxglove's schemas."""
_FIELDS = (
    ("timestamp", "TYPE_MESSAGE"),
    ("v_mps", "TYPE_DOUBLE"),
    ("w_rps", "TYPE_DOUBLE"),
    ("v_token", "TYPE_INT32"),
    ("w_token", "TYPE_INT32"),
)
"""Fields of `minivla.Action`, numbered from 1."""


def encode(message: str, values: Mapping[str, Any]) -> bytes:
    """Returns the bytes of a message; equal values give equal bytes.

    Args:
        message: full name of the message type, e.g. `foxglove.Odometry`.
        values: field -> value; messages as mappings, repeated fields as sequences. Fields can be omitted.

    Raises:
        ValueError: the message does not have a field.
        ModuleNotFoundError: the message type is unknown.
    """
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
    if message == ACTION:
        return _action_class()
    package, _, name = message.rpartition(".")
    return getattr(importlib.import_module(f"{package}_schemas_protobuf.{name}_pb2"), name)


def _action_class() -> Any:
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

    fields = [
        {"name": name, "number": number, "label": "LABEL_OPTIONAL", "type": kind}
        for number, (name, kind) in enumerate(_FIELDS, 1)
    ]
    fields[0]["type_name"] = ".google.protobuf.Timestamp"
    file = descriptor_pb2.FileDescriptorProto(
        name="minivla.proto",
        package="minivla",
        syntax="proto3",
        dependency=[timestamp_pb2.DESCRIPTOR.name],
        message_type=[{"name": "Action", "field": fields}],
    )
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.AddSerializedFile(file.SerializeToString())
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(ACTION))

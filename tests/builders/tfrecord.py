"""Reads TFRecord files with Google's Protobuf and a checksum computed bit by bit; uses no code of this project."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from PIL import Image

_FIELDS = {
    "BytesList": [("value", 1, "TYPE_BYTES", "LABEL_REPEATED", "")],
    "FloatList": [("value", 1, "TYPE_FLOAT", "LABEL_REPEATED", "")],
    "Int64List": [("value", 1, "TYPE_INT64", "LABEL_REPEATED", "")],
    "Feature": [
        ("bytes_list", 1, "TYPE_MESSAGE", "LABEL_OPTIONAL", "BytesList"),
        ("float_list", 2, "TYPE_MESSAGE", "LABEL_OPTIONAL", "FloatList"),
        ("int64_list", 3, "TYPE_MESSAGE", "LABEL_OPTIONAL", "Int64List"),
    ],
    "Entry": [
        ("key", 1, "TYPE_STRING", "LABEL_OPTIONAL", ""),
        ("value", 2, "TYPE_MESSAGE", "LABEL_OPTIONAL", "Feature"),
    ],
    "Features": [("feature", 1, "TYPE_MESSAGE", "LABEL_REPEATED", "Entry")],
    "Example": [("features", 1, "TYPE_MESSAGE", "LABEL_OPTIONAL", "Features")],
}
"""Messages of tensorflow/core/example; a map is encoded as its entries."""


@cache
def example_class() -> Any:
    """Returns the class of `tf.train.Example`."""
    file = descriptor_pb2.FileDescriptorProto(name="example.proto", package="tensorflow", syntax="proto3")
    for name, fields in _FIELDS.items():
        message = file.message_type.add(name=name)
        for field, number, kind, label, inner in fields:
            extra = {"type_name": f".tensorflow.{inner}"} if inner else {}
            message.field.add(name=field, number=number, type=kind, label=label, **extra)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("tensorflow.Example"))


def crc32c(data: bytes) -> int:
    """Returns the CRC-32C by its definition: polynomial 0x1EDC6F41, reflected."""
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = byte >> 1 ^ (0x82F63B78 if byte & 1 else 0)
        table.append(byte)
    crc = 0xFFFFFFFF
    for byte in data:
        crc = crc >> 8 ^ table[(crc ^ byte) & 0xFF]
    return crc ^ 0xFFFFFFFF


def records_in(path: Path, check: bool = True) -> Iterator[bytes]:
    """Yields the records of a TFRecord file, and checks their checksums."""
    with path.open("rb") as file:
        while head := file.read(12):
            length, length_crc = struct.unpack("<QI", head)
            data, (data_crc,) = file.read(length), struct.unpack("<I", file.read(4))
            for content, found in ((head[:8], length_crc), (data if check else None, data_crc)):
                if content is not None:
                    crc = crc32c(content)
                    assert ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF == found
            yield data


def examples_in(path: Path) -> Iterator[dict[str, list[Any]]]:
    """Yields the values of each example by name."""
    for data in records_in(path, check=False):
        example = example_class().FromString(data)
        yield {
            entry.key: [*entry.value.bytes_list.value, *entry.value.float_list.value, *entry.value.int64_list.value]
            for entry in example.features.feature
        }


def image_of(data: bytes) -> np.ndarray[Any, Any]:
    """Returns a PNG image as an array."""
    return np.asarray(Image.open(io.BytesIO(data)))


def depth_of(data: bytes) -> np.ndarray[Any, Any]:
    """Returns a square zlib-compressed depth image as an array."""
    values = np.frombuffer(zlib.decompress(data), np.float32)
    side = round(len(values) ** 0.5)
    return values.reshape(side, side)

"""Writes and reads TFRecord files of `tf.train.Example` messages, without TensorFlow. Knows no format of datasets.

An example is written from the files of its long features, because it contains all images of an episode, and a Protobuf
message object would hold them in memory. Long features are never read.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from schemas.errors import UsageError
from schemas.support.closing import Closing

MAX_EXAMPLE_BYTES = (1 << 31) - 1
"""Largest size of a Protobuf message, and so of an example, that readers accept."""
_FIRST, _SECOND, _THIRD = 0x0A, 0x12, 0x1A
"""Tags of the fields 1 to 3 of a Protobuf message, whose values have a length."""
_BYTES_LIST, _FLOAT_LIST, _INT64_LIST = _FIRST, _SECOND, _THIRD
_MASK_DELTA = 0xA282EAD8
_LENGTH, _CHECKSUM = struct.Struct("<Q"), struct.Struct("<I")
_MAX_NAME_BYTES = 1 << 10
_COPY_BYTES = 1 << 20


def encode_floats(values: NDArray[np.floating] | Sequence[float]) -> bytes:
    """Returns values as a feature of float32; arrays are flattened."""
    return _field(_FLOAT_LIST, _field(_FIRST, np.asarray(values, "<f4").tobytes()))


def encode_ints(values: NDArray[np.integer | np.bool_] | Sequence[int]) -> bytes:
    """Returns values as a feature of int64, as which TensorFlow stores all integers and truth values; flattened."""
    packed = b"".join(map(_varint, np.asarray(values).ravel().astype(np.uint64).tolist()))
    return _field(_INT64_LIST, _field(_FIRST, packed))


def encode_texts(values: Iterable[str]) -> bytes:
    """Returns texts as a feature of bytes, in UTF-8."""
    return _field(_BYTES_LIST, b"".join(_field(_FIRST, text.encode()) for text in values))


class BytesFeature(Closing):
    """Feature of bytes whose values are collected in a file, because they do not fit into memory.

    Raises:
        OSError: the disk is full or not available.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path.open("wb")

    def add(self, value: bytes) -> None:
        """Appends a value."""
        self._file.write(_head(_FIRST, len(value)))
        self._file.write(value)

    def close(self) -> None:
        """Closes the file; the feature can be written then."""
        self._file.close()


def write_example(path: Path, features: Mapping[str, bytes], long: Mapping[str, Path]) -> int:
    """Writes a TFRecord file with one example, in bounded memory; equal features give equal bytes.

    Args:
        path: file to write. Files of this function can be concatenated.
        features: name -> encoded feature. They precede the long ones, so they are found without reading those.
        long: name -> file of a `BytesFeature`; the files are deleted.

    Returns:
        The size of the file, bytes.

    Raises:
        UsageError: the example is larger than readers accept.
        OSError: the disk is full or not available.
    """
    heads = {name: _bytes_heads(name, file.stat().st_size) for name, file in sorted(long.items())}
    short = b"".join(_entry(name, value) for name, value in sorted(features.items()))
    size = len(short) + sum(len(head) + long[name].stat().st_size for name, head in heads.items())
    front = _head(_FIRST, size)
    if len(front) + size > MAX_EXAMPLE_BYTES:
        raise UsageError(
            f"the episode takes {size} bytes as one TFRecord, and readers accept {MAX_EXAMPLE_BYTES}: give a lower "
            "--fps or smaller images (--image-px), or omit it with --exclude"
        )
    with path.open("wb") as out:
        length = _LENGTH.pack(len(front) + size)
        out.write(length + _CHECKSUM.pack(masked_crc(length)))
        crc = _written(out, front + short)
        for name, head in heads.items():
            crc = _written(out, head, crc)
            with long[name].open("rb") as values:
                while data := values.read(_COPY_BYTES):
                    crc = _written(out, data, crc)
            long[name].unlink()
        out.write(_CHECKSUM.pack(_masked(crc)))
        return out.tell()


def masked_crc(data: bytes) -> int:
    """Returns the masked CRC-32C of TFRecord."""
    from google_crc32c import value

    return _masked(value(data))


def read_examples(path: Path, names: Collection[str], limit_bytes: int) -> Iterator[dict[str, bytes]]:
    """Yields from each example of a TFRecord file the first value of features of bytes; all others are skipped.

    Args:
        path: the file, also one that TensorFlow has written.
        names: wanted features. Those that an example lacks, and empty ones, are omitted.
        limit_bytes: largest size of a wanted feature, bytes.

    Raises:
        ValueError: the file is not a TFRecord file of examples, or damaged, or a wanted feature is too large.
    """
    with path.open("rb") as file:
        total = os.fstat(file.fileno()).st_size
        while head := file.read(_LENGTH.size):
            check = file.read(_CHECKSUM.size)
            if len(head) < _LENGTH.size or check != _CHECKSUM.pack(masked_crc(head)):
                raise ValueError(f"{path} is not a TFRecord file, or damaged")
            end = file.tell() + _LENGTH.unpack(head)[0]
            if end + _CHECKSUM.size > total:
                raise ValueError(f"{path} ends within a record")
            yield dict(_short_features(_Message(file, path, end), names, limit_bytes))
            file.seek(end + _CHECKSUM.size)


class _Message:
    """Reads the fields of a Protobuf message in a file. All have a length, as in an example."""

    def __init__(self, file: BinaryIO, path: Path, end: int) -> None:
        self.file, self.path, self.end = file, path, end

    def fields(self) -> Iterator[tuple[int, _Message]]:
        """Yields tag and content of each field; the content need not be read."""
        while (at := self.file.tell()) < self.end:
            tag, size = self.file.read(1)[0], self._number()
            content = _Message(self.file, self.path, self.file.tell() + size)
            if content.end > self.end or tag not in (_FIRST, _SECOND, _THIRD):
                raise ValueError(f"{self.path} has a record that is not a tf.train.Example, at byte {at}")
            yield tag, content
            self.file.seek(content.end)

    def read(self, limit_bytes: int) -> bytes:
        """Returns the content."""
        size = self.end - self.file.tell()
        if size > limit_bytes:
            raise ValueError(f"{self.path} has a feature of {size} bytes, more than {limit_bytes}")
        return self.file.read(size)

    def _number(self) -> int:
        value = 0
        for shift in range(0, 64, 7):
            byte = self.file.read(1)
            if not byte:
                break
            value |= (byte[0] & 0x7F) << shift
            if byte[0] < 0x80:
                return value
        raise ValueError(f"{self.path} has a record that is not a tf.train.Example")


def _short_features(example: _Message, names: Collection[str], limit_bytes: int) -> Iterator[tuple[str, bytes]]:
    for _, features in example.fields():
        for _, entry in features.fields():
            name = ""
            for tag, content in entry.fields():
                if tag == _FIRST:
                    name = content.read(_MAX_NAME_BYTES).decode()
                elif name in names:
                    for kind, values in content.fields():
                        first = next(values.fields(), None) if kind == _BYTES_LIST else None
                        if first is not None:
                            yield name, first[1].read(limit_bytes)


def _written(out: BinaryIO, data: bytes, crc: int = 0) -> int:
    """Writes data, and returns the checksum of all data so far."""
    from google_crc32c import extend

    out.write(data)
    found: int = extend(crc, data)
    return found


def _masked(crc: int) -> int:
    return ((crc >> 15 | crc << 17) + _MASK_DELTA) & 0xFFFFFFFF


def _entry(name: str, feature: bytes) -> bytes:
    return _field(_FIRST, _field(_FIRST, name.encode()) + _field(_SECOND, feature))


def _bytes_heads(name: str, size: int) -> bytes:
    """Returns what precedes the values of a feature of bytes in the message of an example."""
    inner = _head(_BYTES_LIST, size)
    value = _head(_SECOND, len(inner) + size)
    key = _field(_FIRST, name.encode())
    return _head(_FIRST, len(key) + len(value) + len(inner) + size) + key + value + inner


def _field(tag: int, data: bytes) -> bytes:
    return _head(tag, len(data)) + data


def _head(tag: int, size: int) -> bytes:
    return bytes((tag,)) + _varint(size)


def _varint(value: int) -> bytes:
    if value < 0x80:
        return bytes((value,))
    return bytes((value & 0x7F | 0x80,)) + _varint(value >> 7)

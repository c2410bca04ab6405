"""Reads the JSON document, buffers, accessors and images of a glTF or GLB file (glTF 2.0, sections 3.6 and 4.4).

Checks every size before it allocates. Does not read nodes, meshes or materials.
"""

from __future__ import annotations

import base64
import json
import struct
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from factory.scenes.formats.files import SceneFiles, place_of

_JSON, _BIN = 0x4E4F534A, 0x004E4942
_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_DATA_URI = "data:"


@dataclass
class Document:
    """An opened glTF file."""

    files: SceneFiles
    json: dict[str, Any]
    binary: bytes
    _buffers: dict[int, bytes] = field(default_factory=dict)

    def items(self, key: str) -> list[dict[str, Any]]:
        """Returns a top-level list, empty if absent."""
        return list(self.json.get(key) or [])

    def item(self, key: str, index: int) -> dict[str, Any]:
        """Returns an item of a top-level list.

        Raises:
            LookupError: the index is out of range.
        """
        found = self.items(key)
        if not 0 <= index < len(found):
            raise LookupError(f"{key}[{index}] is used, but there are {len(found)} {key}")
        return dict(found[index])

    def view(self, index: int) -> tuple[memoryview, int]:
        """Returns the bytes of a buffer view, and its stride, bytes; 0 if packed."""
        view = self.item("bufferViews", index)
        if "EXT_meshopt_compression" in (view.get("extensions") or {}):
            raise ValueError("meshopt compression is not supported; export the file without compression")
        start, size = int(view.get("byteOffset", 0)), int(view["byteLength"])
        data = self._buffer(int(view["buffer"]))
        if not 0 <= start <= start + size <= len(data):
            raise ValueError(f"buffer view {index} ends at byte {start + size} of {len(data)}; the file is truncated")
        return memoryview(data)[start : start + size], int(view.get("byteStride", 0))

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            uri = self.item("buffers", index).get("uri")
            self._buffers[index] = self.binary if uri is None else self._load(str(uri))
        return self._buffers[index]

    def _load(self, uri: str) -> bytes:
        if not uri.startswith(_DATA_URI):
            return self.files.read(place_of(self.files.root.parent, uri))
        head, _, text = uri.partition(",")
        return base64.b64decode(text) if head.endswith(";base64") else unquote_to_bytes(text)

    def accessor(self, index: int) -> NDArray[Any]:
        """Returns the values (N, width) of an accessor; normalised integers as floats.

        Raises:
            ValueError: its buffer view is too short.
        """
        accessor = self.item("accessors", index)
        kind, width, count = str(_TYPES[accessor["componentType"]]), _WIDTHS[accessor["type"]], int(accessor["count"])
        if "bufferView" in accessor:
            values = self._strided(accessor, kind, width, count)
        else:
            self.files.scene.require_room(f"accessor {index}", count // 3)
            values = np.zeros((count, width), kind)
        if accessor.get("sparse"):
            values = self._sparse(accessor["sparse"], values)
        return _normalised(values) if accessor.get("normalized") else values

    def _strided(self, source: dict[str, Any], kind: str, width: int, count: int) -> NDArray[Any]:
        data, stride = self.view(int(source["bufferView"]))
        item, start = np.dtype(kind).itemsize * width, int(source.get("byteOffset", 0))
        stride = stride or item
        if start < 0 or count < 0 or stride < item or (count and start + stride * (count - 1) + item > len(data)):
            raise ValueError(f"{count} values of {stride} bytes from byte {start} in a view of {len(data)} bytes")
        return np.ndarray((count, width), kind, data, start, (stride, np.dtype(kind).itemsize)).copy()

    def _sparse(self, sparse: dict[str, Any], values: NDArray[Any]) -> NDArray[Any]:
        count, places, new = int(sparse["count"]), sparse["indices"], sparse["values"]
        rows = self._strided(places, _TYPES[places["componentType"]], 1, count).reshape(-1)
        values[rows] = self._strided(new, values.dtype.str, values.shape[1], count)
        return values

    def image(self, index: int) -> str:
        """Returns the path of an image; an image inside the file is added to the images of the import."""
        image = self.item("images", index)
        uri = image.get("uri")
        if uri is not None and not str(uri).startswith(_DATA_URI):
            return str(place_of(self.files.root.parent, str(uri)))
        name = f"{self.files.root.name}[image {index}]"
        data = bytes(self.view(int(image["bufferView"]))[0]) if uri is None else self._load(str(uri))
        self.files.images[name] = data
        return name


def read_document(data: bytes, files: SceneFiles) -> Document:
    """Parses a .gltf or .glb file.

    Raises:
        ValueError: it is not glTF 2.0, or it is truncated.
    """
    text, binary = _chunks(data) if data.startswith(b"glTF") else (data, b"")
    document = json.loads(text)
    version = str(document["asset"]["version"])
    if not version.startswith("2."):
        raise ValueError(f"glTF {version} is not supported, only glTF 2.0; export it again")
    return Document(files, document, binary)


def _chunks(data: bytes) -> tuple[bytes, bytes]:
    """Returns the JSON and the binary chunk of a GLB file."""
    if len(data) < 12:
        raise ValueError("the file is truncated: 12 bytes of header are missing")
    _, version, length = struct.unpack_from("<4sII", data)
    if version != 2:
        raise ValueError(f"GLB version {version} is not supported, only 2; export it again")
    if length > len(data):
        raise ValueError(f"the file is truncated: {len(data)} of {length} bytes")
    found: dict[int, bytes] = {}
    place = 12
    while place + 8 <= length:
        size, kind = struct.unpack_from("<II", data, place)
        if place + 8 + size > length:
            raise ValueError(f"the file is truncated: a chunk ends at byte {place + 8 + size} of {length}")
        found.setdefault(kind, data[place + 8 : place + 8 + size])
        place += 8 + size
    return found[_JSON], found.get(_BIN, b"")


def _normalised(values: NDArray[Any]) -> NDArray[Any]:
    if values.dtype.kind == "f":
        return values
    top = float(np.iinfo(values.dtype).max)
    return np.maximum(values / top, -1.0)

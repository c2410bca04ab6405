"""Encodes and decodes the PNG images of frames: 8-bit RGB with filter Sub, or 16-bit grey without filter; one chunk.

Not a general PNG reader. It decodes the output of `encode_png`, and of earlier versions that filtered ids too, and
rejects all other images, so an image cannot state a size that the caller does not expect. Any viewer opens the
files.
"""

from __future__ import annotations

import struct
from typing import Any, cast

import numpy as np
from isal import isal_zlib
from isal.igzip_lib import IsalError
from numpy.typing import NDArray

from schemas.errors import InvalidBundle

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_NONE, _SUB = 0, 1
_ISAL_ERROR = cast(type[Exception], IsalError)  # isal's type stub declares it as an instance, not as a class
_BAND_ROWS = 64
"""Number of rows that are decoded together. A band of 640 pixels per row and its two copies take 370 kB."""
_LEVEL = 2
# Sizes of office frames with filter None / Sub / Up / Paeth: 429 / 383 / 412 / 388 kB at isal level 2, which takes as
# long as levels 0 and 1. Ids: 14 / 11 / 12 kB with None / Sub / Up, but None decodes in a third of the time.


def encode_png(image: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """Returns a PNG of an (H, W, 3) uint8 image or an (H, W) uint16 image; equal images give equal bytes."""
    height, width = image.shape[:2]
    is_grey = image.dtype == np.uint16
    lines = _lines_of_grey(image) if is_grey else _lines_of_colour(image)
    data = isal_zlib.compress(lines, _LEVEL)
    return b"".join((_front(height, width, is_grey), *_chunk(b"IDAT", data), _TAIL))


def _lines_of_grey(image: NDArray[Any]) -> NDArray[np.uint8]:
    height, width = image.shape
    lines = np.empty((height, 1 + 2 * width), np.uint8)
    lines[:, 0] = _NONE
    lines[:, 1:] = image.astype(">u2").view(np.uint8).reshape(height, -1)
    return lines


def _lines_of_colour(image: NDArray[Any]) -> NDArray[np.uint8]:
    height, width, channels = image.shape
    rows = image.reshape(height, channels * width)
    lines = np.empty((height, 1 + channels * width), np.uint8)
    lines[:, 0] = _SUB
    lines[:, 1 : channels + 1] = rows[:, :channels]
    np.subtract(rows[:, channels:], rows[:, :-channels], out=lines[:, channels + 1 :])
    return lines


def decode_png(name: str, data: bytes, shape: tuple[int, ...]) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Decodes an image whose rows all have filter None or all have filter Sub.

    Args:
        name: name of the image in error messages.
        data: content of the file.
        shape: the accepted shape: (H, W, 3) for 8-bit RGB or (H, W) for 16-bit grey.

    Raises:
        InvalidBundle: the image has a different size, type, filter or chunk, a wrong CRC, or damaged data.
    """
    # not Pillow, whose limit against decompression bombs is a setting of the whole process
    height, width = shape[:2]
    is_grey = len(shape) == 2
    body = _single_idat(name, data, _front(height, width, is_grey))
    depth = 2 if is_grey else 3  # bytes per pixel
    lines = _inflate(name, body, height * (1 + depth * width)).reshape(height, 1 + depth * width)
    rows = lines[:, 1:]
    if bool((lines[:, 0] == _SUB).all()):
        rows = _unfilter_sub(rows, depth)
    elif bool(lines[:, 0].any()):
        raise InvalidBundle("image refused", [f"{name}: the row filters are neither all None nor all Sub"])
    pixels = np.ascontiguousarray(rows).reshape(height, width, depth)
    return pixels.view(">u2")[..., 0].astype(np.uint16) if is_grey else pixels


def _unfilter_sub(rows: NDArray[np.uint8], depth: int) -> NDArray[np.uint8]:
    """Returns the unfiltered bytes of rows with filter Sub.

    A byte is the sum, modulo 256, of the filtered bytes of its channel from the first pixel of the row to its own.

    Adds rows to copies of themselves that are shifted by 1, 2, 4, ... pixels. These additions are vectorised, and a
    band of rows stays in the cache, so they take half the time of `np.cumsum`.

    Args:
        rows: filtered bytes, (height, depth * width).
        depth: bytes per pixel.
    """
    height, size = rows.shape
    sums = np.empty((height, size), np.uint8)
    spare = np.empty((2, _BAND_ROWS, size), np.uint8)
    shifts = [depth << power for power in range((size // depth - 1).bit_length())]
    for top in range(0, height, _BAND_ROWS):
        band = rows[top : top + _BAND_ROWS]
        for number, shift in enumerate(shifts):
            added = spare[number % 2, : len(band)]
            added[:, :shift] = band[:, :shift]
            np.add(band[:, shift:], band[:, :-shift], out=added[:, shift:])
            band = added
        sums[top : top + _BAND_ROWS] = band
    return sums


def _front(height: int, width: int, is_grey: bool) -> bytes:
    depth, colour = (16, 0) if is_grey else (8, 2)
    return b"".join((_SIGNATURE, *_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0))))


def _chunk(kind: bytes, data: bytes) -> tuple[bytes, bytes, bytes, bytes]:
    crc = isal_zlib.crc32(data, isal_zlib.crc32(kind))
    return struct.pack(">I", len(data)), kind, data, struct.pack(">I", crc)


_TAIL = b"".join(_chunk(b"IEND", b""))


def _single_idat(name: str, data: bytes, front: bytes) -> memoryview:
    if not data.startswith(front) or not data.endswith(_TAIL) or len(data) < len(front) + len(_TAIL) + 12:
        raise InvalidBundle("image refused", [f"{name}: not a PNG of the size and kind of this dataset"])
    start = len(front)
    (length,) = struct.unpack(">I", data[start : start + 4])
    end = start + 8 + length
    if data[start + 4 : start + 8] != b"IDAT" or end + 4 + len(_TAIL) != len(data):
        raise InvalidBundle("image refused", [f"{name}: not exactly one IDAT chunk"])
    (crc,) = struct.unpack(">I", data[end : end + 4])
    view = memoryview(data)
    if crc != isal_zlib.crc32(view[start + 4 : end]):
        raise InvalidBundle("image refused", [f"{name}: wrong CRC"])
    return view[start + 8 : end]


def _inflate(name: str, body: memoryview, expected: int) -> NDArray[np.uint8]:
    try:
        inflater = isal_zlib.decompressobj()
        raw = inflater.decompress(body, expected + 1)
    except _ISAL_ERROR as error:
        raise InvalidBundle("image refused", [f"{name}: damaged data ({error})"]) from error
    if len(raw) != expected or not inflater.eof or inflater.unused_data:
        raise InvalidBundle("image refused", [f"{name}: {len(raw)} bytes of pixels, expected exactly {expected}"])
    return np.frombuffer(raw, np.uint8)

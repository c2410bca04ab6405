"""PNG: lossless, readable by other software, and strict: other image forms are refused."""

from __future__ import annotations

import io
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from schemas.encoding.png import decode_png, encode_png
from schemas.errors import InvalidBundle

SIDES = st.tuples(st.integers(1, 12), st.integers(1, 12))
COLOUR = SIDES.flatmap(lambda side: hnp.arrays(np.uint8, (*side, 3)))
GREY = SIDES.flatmap(lambda side: hnp.arrays(np.uint16, side))
IMAGE = np.arange(5 * 4 * 3, dtype=np.uint8).reshape(5, 4, 3)
OUR_FILTER = zlib.decompress(encode_png(IMAGE)[41:-16])[:1]
ROW = OUR_FILTER + b"\x00" * 12


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(rows: bytes, size: tuple[int, int] = (4, 5), extra: bytes = b"") -> bytes:
    head = struct.pack(">IIBBBBB", *size, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", head) + extra + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def refused(data: bytes) -> str:
    with pytest.raises(InvalidBundle) as error:
        decode_png("image", data, IMAGE.shape)
    return str(error.value)


@given(st.one_of(COLOUR, GREY))
def test_image_comes_back_bit_for_bit(image: np.ndarray) -> None:
    found = decode_png("image", encode_png(image), image.shape)
    assert found.dtype == image.dtype
    assert np.array_equal(found, image)


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (63, 640), (64, 3), (65, 129), (200, 33), (640, 640)])
def test_rows_of_any_width_and_number_are_unfiltered(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(0).integers(0, 256, (*shape, 3), dtype=np.uint8)
    assert np.array_equal(decode_png("image", encode_png(image), image.shape), image)


@given(st.one_of(COLOUR, GREY))
def test_other_software_reads_the_same_image(image: np.ndarray) -> None:
    with Image.open(io.BytesIO(encode_png(image))) as opened:
        assert np.array_equal(np.asarray(opened), image)


def test_equal_images_give_equal_bytes() -> None:
    assert encode_png(IMAGE) == encode_png(IMAGE.copy())


def test_image_of_another_size_or_kind_is_refused() -> None:
    assert "not a PNG of the size and kind" in refused(encode_png(IMAGE[:4]))
    assert "not a PNG of the size and kind" in refused(encode_png(IMAGE[:, :, 0].astype(np.uint16)))


def test_more_pixels_than_stated_are_refused() -> None:
    assert "expected exactly 65" in refused(png(ROW * 100_000))


def test_fewer_pixels_than_stated_are_refused() -> None:
    assert "52 bytes of pixels, expected exactly 65" in refused(png(ROW * 4))


def test_other_row_filter_is_refused() -> None:
    for other in (b"\x00", b"\x02"):
        assert "the row filters are neither" in refused(png(ROW * 4 + other + b"\x00" * 12))


def test_id_images_of_old_datasets_with_the_png_filter_sub_are_decoded() -> None:
    ids = np.array([[1, 2, 300], [65535, 0, 7]], np.uint16)
    wide = np.pad(ids, ((0, 0), (1, 0))).astype(">u2").view(np.uint8).reshape(2, 4, 2)
    rows = b"".join(b"\x01" + row.tobytes() for row in np.diff(wide, axis=1).astype(np.uint8))
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", 3, 2, 16, 0, 0, 0, 0))
    data = b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    assert np.array_equal(decode_png("ids", data, ids.shape), ids)


def test_foreign_chunk_is_refused() -> None:
    assert "not exactly one IDAT chunk" in refused(png(ROW * 5, extra=chunk(b"tEXt", b"hello")))


def test_bytes_after_the_compressed_data_are_refused() -> None:
    head = struct.pack(">IIBBBBB", 4, 5, 8, 2, 0, 0, 0)
    idat = zlib.compress(ROW * 5) + b"rest"
    data = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", idat) + chunk(b"IEND", b"")
    assert "65 bytes of pixels" in refused(data)


@settings(max_examples=200)
@given(st.integers(0, len(encode_png(IMAGE)) * 8 - 1))
def test_every_flipped_bit_is_refused(position: int) -> None:
    data = bytearray(encode_png(IMAGE))
    data[position // 8] ^= 1 << position % 8
    refused(bytes(data))


@given(st.integers(0, len(encode_png(IMAGE)) - 1))
def test_every_truncation_is_refused(length: int) -> None:
    refused(encode_png(IMAGE)[:length])


@given(st.binary(max_size=200))
def test_random_bytes_raise_only_the_documented_error(data: bytes) -> None:
    refused(data)

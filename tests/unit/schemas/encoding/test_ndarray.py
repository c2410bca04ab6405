"""Arrays as bytes: exact round trips, and headers and frames with false sizes."""

from __future__ import annotations

import io
import pickle
import tracemalloc

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from schemas.encoding.ndarray import decode_npy, decode_npy_zst, encode_npy, encode_npy_zst
from schemas.errors import InvalidBundle

DTYPES = st.sampled_from([np.float32, np.int16, np.uint8, np.uint16, np.int64])
ARRAYS = DTYPES.flatmap(lambda dtype: hnp.arrays(dtype, hnp.array_shapes(min_dims=1, max_dims=3, min_side=0)))
SMALL = np.arange(12, dtype=np.float32).reshape(4, 3)


def header(text: str) -> bytes:
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()


def refused(data: bytes, shape: tuple[int | None, ...] = (4, 3)) -> str:
    with pytest.raises(InvalidBundle) as error:
        decode_npy("thing", data, np.float32, shape)
    return str(error.value)


@given(ARRAYS)
def test_array_comes_back_bit_for_bit(array: np.ndarray) -> None:
    for data, decode in (
        (encode_npy(array), lambda data: decode_npy("x", data, array.dtype, array.shape)),
        (encode_npy_zst(array), lambda data: decode_npy_zst("x", data, array.dtype, array.shape, 1 << 20)),
    ):
        found = decode(data)
        assert found.dtype == array.dtype
        assert found.shape == array.shape
        assert found.tobytes() == array.tobytes()


@given(ARRAYS)
def test_equal_arrays_give_equal_bytes(array: np.ndarray) -> None:
    assert encode_npy_zst(array) == encode_npy_zst(array.copy())


def test_numpy_reads_what_we_write() -> None:
    assert np.array_equal(np.load(io.BytesIO(encode_npy(SMALL)), allow_pickle=False), SMALL)


def test_a_header_in_another_notation_is_equivalent() -> None:
    """A header as this project writes it is recognised by its bytes; any other header is parsed."""
    text = "{'shape':(4,3), 'fortran_order':False, 'descr':'<f4'}"
    data = header(f"{text}\n") + SMALL.tobytes()
    assert not encode_npy(SMALL).startswith(header(f"{text}\n"))
    assert np.array_equal(decode_npy("x", data, np.float32, (4, 3)), SMALL)


def test_fortran_ordered_array_is_written_in_c_order() -> None:
    assert encode_npy(np.asfortranarray(SMALL)) == encode_npy(SMALL)


def test_open_extent_accepts_any_length() -> None:
    assert len(decode_npy("x", encode_npy(SMALL), np.float32, (None, 3))) == 4


def test_other_shape_is_refused() -> None:
    assert "shape (4, 3), expected (5, 3)" in refused(encode_npy(SMALL), (5, 3))
    assert "shape (4, 3), expected (4, 3, 1)" in refused(encode_npy(SMALL), (4, 3, 1))


def test_other_dtype_or_order_is_refused() -> None:
    assert "dtype float64 in C order, expected float32" in refused(encode_npy(SMALL.astype(np.float64)))
    buffer = io.BytesIO()
    np.save(buffer, np.asfortranarray(SMALL))
    assert "in Fortran order" in refused(buffer.getvalue())


def test_header_that_claims_terabytes_allocates_nothing() -> None:
    data = header("{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000000,), }")
    tracemalloc.start()
    try:
        text = refused(data, (None,))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert "0 bytes of data, expected 4000000000000" in text
    assert peak < 1 << 20


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x93NUMPY",
        b"\x93NUMPY\x02\x00" + b"\x00" * 100,
        b"\x93NUMPY\x01\x00\xff\xff",
        header("not a dict"),
        header("{'descr': '<f4'}"),
        header("{'descr': '|O', 'fortran_order': False, 'shape': (4, 3), }"),
        header("{'descr': '<f4', 'fortran_order': False, 'shape': (-4, 3), }"),
        header("(" * 500 + ")" * 500),
        header("{'descr': '<f4', 'fortran_order': False, 'shape': (4, 3), }" + " " * 5000),
        pickle.dumps([1, 2, 3]),
        encode_npy(SMALL)[:-1],
        encode_npy(SMALL) + b"x",
    ],
)
def test_malformed_file_is_refused(data: bytes) -> None:
    assert "thing" in refused(data)


def test_bomb_is_refused_before_it_is_unpacked() -> None:
    bomb = zstandard.ZstdCompressor(level=19).compress(b"\x00" * (64 << 20))
    assert len(bomb) < 10_000
    with pytest.raises(InvalidBundle, match=r"the zstd frame states 67108864 bytes, limit 1048576"):
        decode_npy_zst("thing", bomb, np.float32, (None,), 1 << 20)


def test_frame_of_unknown_size_is_refused() -> None:
    unknown = zstandard.ZstdCompressor(write_content_size=False).compress(encode_npy(SMALL))
    with pytest.raises(InvalidBundle, match="the zstd frame states"):
        decode_npy_zst("thing", unknown, np.float32, (4, 3), 1 << 20)


def test_a_frame_with_an_understated_size_is_refused() -> None:
    compressor = zstandard.ZstdCompressor(write_content_size=True)
    honest = bytearray(compressor.compress(b"\x00" * 100_000))
    lying = compressor.compress(b"\x00" * 90_000)[:8]  # magic number, descriptor and the understated size
    honest[: len(lying)] = lying
    with pytest.raises(InvalidBundle, match=r"damaged zstd frame|bytes of data|npy"):
        decode_npy_zst("thing", bytes(honest), np.float32, (None,), 1 << 20)


@pytest.mark.parametrize("damage", ["cut", "longer", "flipped"])
def test_damaged_frame_is_refused(damage: str) -> None:
    data = bytearray(encode_npy_zst(np.random.default_rng(0).random((40, 30)).astype(np.float32)))
    if damage == "cut":
        del data[-20:]
    elif damage == "longer":
        data += b"rest"
    else:
        data[len(data) // 2] ^= 0x10
    with pytest.raises(InvalidBundle, match="damaged zstd frame"):
        decode_npy_zst("thing", bytes(data), np.float32, (40, 30), 1 << 20)


@settings(max_examples=300)
@given(st.data())
def test_every_flipped_bit_in_a_compressed_array_is_detected(data: st.DataObject) -> None:
    good = encode_npy_zst(SMALL)
    position = data.draw(st.integers(0, len(good) * 8 - 1))
    bad = bytearray(good)
    bad[position // 8] ^= 1 << position % 8
    try:
        found = decode_npy_zst("thing", bytes(bad), np.float32, SMALL.shape, 1 << 20)
    except InvalidBundle:
        return
    assert np.array_equal(found, SMALL)  # the decoder does not read the flipped bit


@pytest.mark.parametrize("header", [b"{'descr': '<f4', 'shape': (3,", b"(" * 5000, b"'''", b"{[" * 900, b"9" * 6000])
def test_an_unparsable_header_is_refused(header: bytes) -> None:
    data = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    with pytest.raises(InvalidBundle):
        decode_npy("poses", data, np.dtype(np.float32), (3, 7))

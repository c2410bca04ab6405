"""The container: deterministic bytes, random access, and refusal of inconsistent zip files."""

from __future__ import annotations

import io
import struct
import zipfile

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.encoding.container import ContainerLimits, ContainerReader, ContainerWriter
from schemas.errors import InvalidBundle

LIMITS = ContainerLimits(members=8, member_bytes=1000)
MEMBERS = st.dictionaries(st.text("abc/._0", min_size=1, max_size=12), st.binary(max_size=200), max_size=8)


def pack(members: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with ContainerWriter(buffer) as out:
        for name, data in members.items():
            out.add(name, data)
    return buffer.getvalue()


def zipped(name: str = "a", data: bytes = b"x" * 100, method: int = zipfile.ZIP_STORED) -> bytearray:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as out:
        out.writestr(name, data)
    return bytearray(buffer.getvalue())


def refused(data: bytes) -> str:
    with pytest.raises(InvalidBundle) as error:
        ContainerReader(io.BytesIO(data), LIMITS)
    return str(error.value)


@given(MEMBERS)
def test_members_come_back_in_order(members: dict[str, bytes]) -> None:
    reader = ContainerReader(io.BytesIO(pack(members)), LIMITS)
    assert {name: reader.read(name) for name in reader.names} == members
    assert list(reader.names) == list(members)
    assert [reader.size(name) for name in reader.names] == [len(data) for data in members.values()]


@given(MEMBERS)
def test_equal_members_give_equal_bytes(members: dict[str, bytes]) -> None:
    assert pack(members) == pack(members)


def test_file_opens_with_any_zip_tool() -> None:
    with zipfile.ZipFile(io.BytesIO(pack({"a/b.txt": b"text"}))) as found:
        assert found.testzip() is None
        assert found.read("a/b.txt") == b"text"
        assert found.infolist()[0].date_time == (1980, 1, 1, 0, 0, 0)


def test_compressed_member_is_refused() -> None:
    assert "'a' is compressed by the zip" in refused(zipped(method=zipfile.ZIP_DEFLATED))


def test_member_above_the_limit_is_refused() -> None:
    assert "'a' has 1001 bytes, more than 1000" in refused(pack({"a": b"x" * 1001}))


def test_too_many_members_are_refused() -> None:
    assert "more than 8 members" in refused(pack({str(n): b"" for n in range(9)}))


def test_a_long_central_directory_is_refused_before_it_is_read() -> None:
    data = bytearray(pack({f"{n:0200d}": b"" for n in range(8)}))
    struct.pack_into("<2H", data, len(data) - 14, 1, 1)  # number of entries on this disk and in total
    assert "a directory of 1968 bytes for 1 members" in refused(data)


def test_zip64_records_and_archive_comments_are_refused() -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as out:
        for n in range(1 << 16):  # one entry more than a 16-bit count can express
            out.writestr(str(n), b"")
    assert "it has no valid end record" in refused(buffer.getvalue())
    with zipfile.ZipFile(buffer := io.BytesIO(), "w") as out:
        out.comment = b"hello"
    assert "it has no valid end record" in refused(buffer.getvalue())


def test_a_duplicate_member_is_refused() -> None:
    data = pack({"a": b"1", "b": b"2"})
    assert "'a' is listed twice" in refused(data.replace(b"b", b"a"))


def test_writing_a_name_twice_is_refused() -> None:
    with ContainerWriter(io.BytesIO()) as out:
        out.add("a", b"1")
        with pytest.raises(ValueError, match="'a' is already in the container"):
            out.add("a", b"2")


@given(st.dictionaries(st.text("ab/\u00e9\u4e2d", min_size=1, max_size=12), st.binary(max_size=50), max_size=8))
def test_bytes_are_those_of_the_standard_library(members: dict[str, bytes]) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as out:
        for name, data in members.items():
            info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            info.create_system, info.external_attr = 3, 0o100644 << 16
            out.writestr(info, data)
    packed = pack(members)
    assert packed == buffer.getvalue()
    reader = ContainerReader(io.BytesIO(packed), LIMITS)
    assert {name: reader.read(name) for name in reader.names} == members


def test_members_with_extra_fields_and_comments_are_read() -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as out:
        for name in ("first", "z\u00fcrich"):
            info = zipfile.ZipInfo(name)
            info.extra, info.comment = struct.pack("<HH4s", 0x7075, 4, b"more"), b"a note"
            out.writestr(info, name.encode())
    reader = ContainerReader(buffer, LIMITS)
    assert reader.names == ("first", "z\u00fcrich")
    assert [reader.read(name) for name in reader.names] == [b"first", "z\u00fcrich".encode()]


def test_forged_size_of_a_stored_member_is_refused() -> None:
    data = zipped()
    directory = data.index(b"PK\x01\x02")
    data[directory + 20 : directory + 28] = struct.pack("<II", 900, 900)  # compressed and uncompressed size
    assert "members claim 900 bytes in a file of" in refused(bytes(data))


def test_overlapping_members_are_refused() -> None:
    """Two directory entries share one body, as in zip bombs with overlapping members."""
    data = pack({str(n): b"x" * 900 for n in range(2)})
    start, end = data.index(b"PK\x01\x02"), data.index(b"PK\x05\x06")
    entries = bytearray(data[start:end])
    second = entries.index(b"PK\x01\x02", 4)
    entries[second + 42 : second + 46] = struct.pack("<I", 0)
    body = data[: data.index(b"PK\x03\x04", 4)]
    tail = bytearray(data[end:])
    tail[16:20] = struct.pack("<I", len(body))
    assert "members claim 1800 bytes" in refused(body + bytes(entries) + bytes(tail))


def test_encrypted_member_is_refused() -> None:
    data = zipped()
    data[data.index(b"PK\x01\x02") + 8] |= 1
    assert "'a' is encrypted" in refused(bytes(data))


def test_flipped_bit_in_a_member_is_found_on_reading() -> None:
    data = bytearray(pack({"a": b"x" * 100}))
    data[60] ^= 1
    with pytest.raises(InvalidBundle, match=r"a: Bad CRC-32"):
        ContainerReader(io.BytesIO(data), LIMITS).read("a")


def test_missing_member_is_named() -> None:
    with pytest.raises(InvalidBundle, match="b is not in the container"):
        ContainerReader(io.BytesIO(pack({"a": b""})), LIMITS).read("b")


def test_every_truncation_is_refused() -> None:
    data = pack({"a": b"x" * 50, "b": b"y" * 50})
    for length in range(len(data)):
        with pytest.raises(InvalidBundle):
            ContainerReader(io.BytesIO(data[:length]), LIMITS).read("a")


@settings(max_examples=300)
@given(st.binary(max_size=300))
def test_random_bytes_raise_only_the_documented_error(data: bytes) -> None:
    with pytest.raises(InvalidBundle):
        ContainerReader(io.BytesIO(data), LIMITS)


@settings(max_examples=300)
@given(st.data())
def test_any_damage_is_either_harmless_or_an_invalid_bundle(data: st.DataObject) -> None:
    good = bytearray(pack({"a": b"x" * 50, "b": b"y" * 50}))
    for _ in range(data.draw(st.integers(1, 4))):
        good[data.draw(st.integers(0, len(good) - 1))] = data.draw(st.integers(0, 255))
    try:
        reader = ContainerReader(io.BytesIO(good), LIMITS)
        found = {name: reader.read(name) for name in reader.names}
    except InvalidBundle:
        return
    assert set(found.values()) <= {b"x" * 50, b"y" * 50, b""}

"""TFRecord files, read with Google's Protobuf and a second checksum."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import factory.export.tfrecord as module
from factory.export.tfrecord import (
    BytesFeature,
    encode_floats,
    encode_ints,
    encode_texts,
    masked_crc,
    read_examples,
    write_example,
)
from schemas.errors import UsageError
from tests.builders.tfrecord import crc32c, examples_in, records_in

LIMIT = 1000
INTS = st.lists(st.integers(-(2**63), 2**63 - 1), max_size=20)
FLOATS = st.lists(st.floats(width=32, allow_nan=False), max_size=20)
TEXTS = st.lists(st.text(max_size=200), max_size=5)
CHUNKS = st.lists(st.binary(max_size=300), max_size=5)


def written(folder: Path, values: list[bytes], features: dict[str, bytes], name: str = "a") -> Path:
    with BytesFeature(folder / "image.part") as image:
        for value in values:
            image.add(value)
    path = folder / f"{name}.tfrecord"
    assert write_example(path, features, {"steps/image": image.path}) == path.stat().st_size
    assert not image.path.exists()
    return path


@given(st.binary(max_size=100))
def test_the_checksum_is_that_of_the_definition(data: bytes) -> None:
    crc = crc32c(data)
    assert masked_crc(data) == ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF


def test_the_checksum_of_the_standard() -> None:
    assert crc32c(b"123456789") == 0xE3069283  # RFC 3720


@settings(max_examples=50)
@given(INTS, FLOATS, TEXTS, CHUNKS)
def test_protobuf_reads_every_value(
    tmp_path_factory: pytest.TempPathFactory, ints: list[int], floats: list[float], texts: list[str], long: list[bytes]
) -> None:
    features = {
        "i": encode_ints(np.array(ints, np.int64)),
        "x" * 200: encode_floats(np.array(floats, np.float32)),
        "t": encode_texts(texts),
    }
    path = written(tmp_path_factory.mktemp("record"), long, features)
    (found,) = list(examples_in(path))
    expected = [text.encode() for text in texts]
    assert found == {"i": ints, "x" * 200: floats, "t": expected, "steps/image": long}
    assert len(list(records_in(path))) == 1


def test_concatenated_files_are_one_file_and_wanted_features_are_found(tmp_path: Path) -> None:
    names = ("ep_000001", "ep_000002")
    parts = [written(tmp_path, [b"x" * 5000], {"id": encode_texts([name])}, name) for name in names]
    whole = tmp_path / "whole"
    whole.write_bytes(b"".join(part.read_bytes() for part in parts))
    found = list(read_examples(whole, {"id", "other"}, LIMIT))
    assert found == [{"id": name.encode()} for name in names]
    with pytest.raises(ValueError, match="has a feature of 5000 bytes, more than 1000"):
        list(read_examples(whole, {"steps/image"}, LIMIT))


def test_damaged_and_foreign_files_are_refused(tmp_path: Path) -> None:
    data = written(tmp_path, [b"x" * 50], {"id": encode_texts(["one"])}).read_bytes()
    file = tmp_path / "damaged"
    for content, said in (
        (b"nothing" * 9, "is not a TFRecord file, or damaged"),
        (data[:5], "is not a TFRecord file, or damaged"),
        (data[:-5], "ends within a record"),
        (data[:12] + b"\x08" + data[13:], "has a record that is not a tf.train.Example"),
        (data[:13] + b"\xff" * 10 + data[23:], "has a record that is not a tf.train.Example"),
    ):
        file.write_bytes(content)
        with pytest.raises(ValueError, match=said):
            list(read_examples(file, {"id"}, LIMIT))


@given(st.data())
@settings(max_examples=100)
def test_no_damage_raises_another_error(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    folder = tmp_path_factory.mktemp("damage")
    path = written(folder, [b"x" * 50], {"id": encode_texts(["one"])})
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        content[data.draw(st.integers(12, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    try:
        found = list(read_examples(path, {"id"}, LIMIT))
    except ValueError:
        return
    assert len(found) == 1


def test_an_example_that_readers_cannot_read_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_EXAMPLE_BYTES", 100)
    with pytest.raises(UsageError, match=r"takes \d+ bytes as one TFRecord.*lower --fps or smaller images"):
        written(tmp_path, [b"x" * 200], {})

"""Decodes an export with the MCAP readers and compares it with the paper's tree and Foxglove's published schemas.

Does not import this project. Exits with code 1 at the first failed check.

    python tests/readers/mcap_reader.py PAPER EXPORT

PAPER: the dataset as `factory export --to paper`. EXPORT: the same episodes as `factory export --to mcap`.
"""

import importlib
import io
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from paper_tree import Paper
from PIL import Image
from result import named, print_row

PUBLISHED = "foxglove."
EACH_STEP = ("/camera/rgb", "/camera/depth", "/camera/ids", "/tf", "/odom", "/action", "/camera/calibration")
ONCE = ("/instruction", "/map", "/target", "/path/driven")


def main() -> None:
    paper, export = Paper(Path(sys.argv[1])), Path(sys.argv[2])
    files = sorted((export / "episodes").glob("*.mcap"))
    assert [file.stem for file in files] == sorted(path.name for path in paper.episodes.iterdir())
    schemas = check_schemas(files[0])
    print_row(export, named("foxglove-schemas-protobuf"), f"{schemas} schemas equal to the published ones")
    messages = sum((check_file(paper, file) for file in files), Counter[str]())
    result = f"{messages.total()} messages, {messages['/camera/rgb']} frames equal to the paper's tree"
    print_row(export, named("mcap", "mcap-protobuf-support"), f"{len(files)} files, {result}")


def check_schemas(path: Path) -> int:
    """Compares the descriptors in a file with the published classes, field by field; returns the number of schemas."""
    with path.open("rb") as file:
        schemas = list(make_reader(file).get_summary().schemas.values())
    published = [schema for schema in schemas if schema.name.startswith(PUBLISHED)]
    assert published
    for schema in published:
        pool = descriptor_pool.DescriptorPool()
        for one in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
            pool.Add(one)
        leaf = schema.name.removeprefix(PUBLISHED)
        module = importlib.import_module(f"foxglove_schemas_protobuf.{leaf}_pb2")
        ours, theirs = pool.FindMessageTypeByName(schema.name), getattr(module, leaf).DESCRIPTOR
        check_message(ours, theirs, set())
    return len(published)


def check_message(ours: Any, theirs: Any, done: set[str]) -> None:
    """Compares two descriptors and their nested messages."""
    assert fields(ours) == fields(theirs), f"{ours.full_name}: {fields(ours)}, published {fields(theirs)}"
    done.add(ours.full_name)
    for field in ours.fields:
        if field.message_type is not None and field.message_type.full_name not in done:
            check_message(field.message_type, theirs.fields_by_name[field.name].message_type, done)


def fields(message: Any) -> list[tuple[Any, ...]]:
    return [
        (
            field.name,
            field.number,
            field.type,
            field.is_repeated,
            field.message_type.full_name if field.message_type else None,
            [(value.name, value.number) for value in field.enum_type.values] if field.enum_type else None,
        )
        for field in sorted(message.fields, key=lambda field: field.number)
    ]


def check_file(paper: Paper, path: Path) -> Counter[str]:
    """Compares every decoded message of a file with the episode; returns the number of messages by topic."""
    name, seen = path.stem, Counter[str]()
    hz = paper.meta(name)["job"]["task"]["control_hz"]
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            seen[channel.topic] += 1
            check_decoded(paper, name, schema.name, channel.topic, decoded, round(message.log_time * hz / 1e9))
    steps = len(paper.array(name, "poses"))
    expected = {**dict.fromkeys(EACH_STEP, steps), **dict.fromkeys(ONCE, 1)}
    assert {topic: seen[topic] for topic in expected} == expected, f"{path}: {dict(seen)}, expected {expected}"
    return seen


def check_decoded(paper: Paper, name: str, schema: str, topic: str, decoded: Any, t: int) -> None:
    """Compares the fields of a message that the paper's tree also contains."""
    if topic == "/camera/rgb":
        assert schema == "foxglove.CompressedImage"
        np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(decoded.data))), paper.rgb(name, t))
    elif topic == "/camera/depth":
        assert (decoded.encoding, decoded.step) == ("32FC1", 2560)
        np.testing.assert_array_equal(pixels(decoded, "<f4"), paper.depth(name, t))
    elif topic == "/camera/ids":
        assert (decoded.encoding, decoded.step) == ("16UC1", 1280)
        np.testing.assert_array_equal(pixels(decoded, "<u2"), paper.ids(name, t))
    elif topic == "/odom":
        place, turn = decoded.pose.position, decoded.pose.orientation
        row = (place.x, place.y, place.z, turn.w, turn.x, turn.y, turn.z)
        np.testing.assert_array_equal(row, paper.array(name, "poses")[t])
    elif topic == "/action":
        values = np.array((decoded.v_mps, decoded.w_rps), np.float32)
        np.testing.assert_array_equal(values, paper.array(name, "actions_continuous")[t])
        assert [decoded.v_token, decoded.w_token] == paper.array(name, "actions_tokens")[t].tolist()
    elif topic == "/instruction":
        assert decoded.message == paper.meta(name)["job"]["instruction"]


def pixels(image: Any, kind: str) -> np.ndarray:
    return np.frombuffer(image.data, kind).reshape(image.height, image.width)


if __name__ == "__main__":
    main()

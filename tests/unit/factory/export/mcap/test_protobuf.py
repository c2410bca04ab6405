"""Messages and descriptors of an MCAP export: their bytes, and decoding with the descriptors only."""

from __future__ import annotations

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from factory.export.mcap.messages import TOPICS
from factory.export.mcap.protobuf import descriptor_set, encode

GOLDEN = [
    (
        "foxglove.PosesInFrame",
        {
            "timestamp": {"seconds": 3, "nanos": -5},
            "frame_id": "wörld",
            "poses": [{"position": {"x": 1.5, "y": -0.0, "z": 0.0}, "orientation": {"w": 1.0}}, {}],
        },
        "0a0d080310fbffffffffffffffff01120677c3b6726c641a1f0a1209000000000000f83f110000000000000080"
        "120921000000000000f03f1a00",
    ),
    (
        "foxglove.Log",
        {"timestamp": {"seconds": 0, "nanos": 0}, "level": 2, "message": "go", "line": 7},
        "0a0010021a02676f3507000000",
    ),
    (
        "foxglove.CameraCalibration",
        {"timestamp": {}, "width": 640, "K": [1.0, 0.0, -2.5], "D": []},
        "0a0015800200003218000000000000f03f000000000000000000000000000004c0",
    ),
    (
        "foxglove.LinePrimitive",
        {"type": 2, "scale_invariant": True, "indices": [0, 1, 4294967295], "points": [{"x": 1e300}]},
        "080220012a09099c7500883ce4377e420c0000000001000000ffffffff",
    ),
    (
        "foxglove.RawImage",
        {"data": b"\x00\x01" * 100, "encoding": "16UC1", "height": 10, "step": 20},
        "1d0a000000220531365543312d1400000032c801" + "0001" * 100,
    ),
]


@pytest.mark.parametrize(("message", "values", "expected"), GOLDEN)
def test_messages_have_the_bytes_of_the_first_release(message, values, expected):
    assert encode(message, values).hex() == expected


@pytest.mark.parametrize("message", sorted(set(TOPICS.values())))
def test_a_reader_finds_every_type_of_a_message_in_its_descriptors(message):
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(descriptor_set(message)).file:
        pool.Add(file)  # raises an error if an imported file is missing or comes later
    assert pool.FindMessageTypeByName(message).full_name == message


def test_an_action_is_decoded_with_its_descriptors_alone():
    values = {"timestamp": {"seconds": 1, "nanos": 2}, "v_mps": 0.5, "w_rps": -1.0, "v_token": 6, "w_token": 3}
    files = descriptor_pb2.FileDescriptorSet.FromString(descriptor_set("minivla.Action")).file
    action = message_factory.GetMessages(files)["minivla.Action"].FromString(encode("minivla.Action", values))
    assert {name: getattr(action, name) for name in list(values)[1:]} == dict(list(values.items())[1:])
    assert (action.timestamp.seconds, action.timestamp.nanos) == (1, 2)


def test_a_field_or_a_message_that_does_not_exist_is_an_error():
    with pytest.raises(ValueError, match="colour"):
        encode("foxglove.CubePrimitive", {"colour": {}})
    with pytest.raises(ModuleNotFoundError):
        encode("foxglove.Cube", {})


def test_the_order_of_the_values_does_not_matter():
    values = {"v_mps": 0.5, "w_rps": -1.0, "timestamp": {"nanos": 1}, "w_token": 1}
    assert encode("minivla.Action", values) == encode("minivla.Action", dict(reversed(values.items())))

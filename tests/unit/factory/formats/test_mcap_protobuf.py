"""Our Protobuf writer against bytes that Google's library (protobuf 7.36) wrote for the same values."""

from __future__ import annotations

import hashlib

import pytest

from factory.export.mcap_protobuf import descriptor_set, encode

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
def test_messages_are_the_bytes_of_googles_encoder(message, values, expected):
    assert encode(message, values).hex() == expected


@pytest.mark.parametrize(
    ("message", "sha256"),
    [
        ("foxglove.SceneUpdate", "9760016b0b196ea4751830b0303f1749899360f392b275e3c985a51308020829"),
        ("foxglove.Grid", "f129524fbd8e35ceac92c766bee331a466c2261a12992d422372912764ce8e49"),
        ("minivla.Action", "6f6c9c929bb1514d706da715e59b73ed96eba079844e59b558c59ad8a988388c"),
    ],
)
def test_descriptors_are_those_that_google_parsed_and_wrote_again(message, sha256):
    assert hashlib.sha256(descriptor_set(message)).hexdigest() == sha256


def test_a_field_that_does_not_exist_is_an_error():
    with pytest.raises(KeyError, match="colour"):
        encode("foxglove.CubePrimitive", {"colour": {}})
    with pytest.raises(KeyError):
        encode("foxglove.Cube", {})


def test_the_order_of_the_values_does_not_matter():
    values = {"v_mps": 0.5, "w_rps": -1.0, "timestamp": {"nanos": 1}, "w_token": 1}
    assert encode("minivla.Action", values) == encode("minivla.Action", dict(reversed(values.items())))

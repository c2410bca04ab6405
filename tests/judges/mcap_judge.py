"""Judges an MCAP export with other people's readers; exits 1 and says what differs.

Run in an environment with `mcap-protobuf-support`, `foxglove-schemas-protobuf`, `rerun-sdk` and this project:

    python tests/judges/mcap_judge.py DATASET EXPORT
"""

from __future__ import annotations

import importlib
import io
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image

from factory.dataset import Dataset
from factory.episode import Episode
from factory.export.mcap_protobuf import descriptor_set
from factory.export.mcap_schemas import MESSAGES


def main(dataset: Path, export: Path) -> None:
    judge_schemas()
    files = sorted((export / "episodes").glob("*.mcap"))
    data = Dataset(dataset)
    assert [file.stem for file in files] == data.metadata["episode_id"].to_pylist()
    frames = 0
    for file in files:
        frames += judge_file(file, data[file.stem])
    judge_rerun(files[0])
    print(f"mcap: {len(files)} files, {frames} frames equal to the dataset; schemas as published; Rerun converts them")  # noqa: T201


def judge_schemas() -> None:
    """Compares every message of ours with the published class, field by field."""
    for name in (name for name in MESSAGES if name.startswith("foxglove.")):
        pool = descriptor_pool.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(descriptor_set(name)).file:
            pool.Add(file)
        leaf = name.removeprefix("foxglove.")
        module = importlib.import_module(f"foxglove_schemas_protobuf.{leaf}_pb2")
        ours, theirs = pool.FindMessageTypeByName(name), getattr(module, leaf).DESCRIPTOR
        assert fields(ours) == fields(theirs), f"{name}: {fields(ours)}, published {fields(theirs)}"


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


def judge_file(path: Path, episode: Episode) -> int:
    """Compares every decoded message of a file with the episode."""
    hz = episode.meta.job.task.control_hz
    seen: dict[str, int] = {}
    with path.open("rb") as file, episode:
        for schema, channel, message, decoded in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            t = round(message.log_time * hz / 1e9)
            seen[channel.topic] = seen.get(channel.topic, 0) + 1
            compare(schema.name, channel.topic, decoded, episode, t)
    steps = len(episode)
    for topic in ("/camera/rgb", "/camera/depth", "/camera/ids", "/tf", "/odom", "/action", "/camera/calibration"):
        assert seen[topic] == steps, f"{path}: {topic} has {seen[topic]} messages, expected {steps}"
    for topic in ("/instruction", "/map", "/target", "/path/driven"):
        assert seen[topic] == 1, f"{path}: {topic} {seen.get(topic)}"
    return steps


def compare(schema: str, topic: str, decoded: Any, episode: Episode, t: int) -> None:
    if topic == "/camera/rgb":
        assert schema == "foxglove.CompressedImage"
        np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(decoded.data))), episode.rgb(t))
    elif topic == "/camera/depth":
        assert (decoded.encoding, decoded.step) == ("32FC1", 2560)
        image = np.frombuffer(decoded.data, "<f4").reshape(decoded.height, decoded.width)
        np.testing.assert_array_equal(image, episode.depth(t))
    elif topic == "/camera/ids":
        image = np.frombuffer(decoded.data, "<u2").reshape(decoded.height, decoded.width)
        np.testing.assert_array_equal(image, episode.ids(t))
    elif topic == "/odom":
        place, turn = decoded.pose.position, decoded.pose.orientation
        row = (place.x, place.y, place.z, turn.w, turn.x, turn.y, turn.z)
        np.testing.assert_array_equal(np.array(row, np.float32), episode.poses[t])
    elif topic == "/action":
        np.testing.assert_array_equal(np.array((decoded.v_mps, decoded.w_rps), np.float32), episode.actions[t])
        assert (decoded.v_token, decoded.w_token) == tuple(episode.tokens[t])
    elif topic == "/instruction":
        assert decoded.message == episode.instruction


def judge_rerun(path: Path) -> None:
    """Lets Rerun load a file with its own reader."""
    with tempfile.TemporaryDirectory() as place:
        target = Path(place) / "x.rrd"
        command = [str(Path(sys.executable).with_name("rerun")), "mcap", "convert", str(path), "-o", str(target)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, done.stderr
        shown = [str(Path(sys.executable).with_name("rerun")), "rrd", "print", "-v", str(target)]
        text = subprocess.run(shown, capture_output=True, text=True, timeout=300, check=False).stdout
        for entity in ("/camera/rgb", "/camera/depth", "/tf", "/odom"):
            assert entity in text, f"Rerun does not show {entity} of {path}"


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))

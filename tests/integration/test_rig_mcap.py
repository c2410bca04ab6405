"""MCAP exports with the sensors of a rig, read back by `mcap` and `rosbags`."""

from __future__ import annotations

import io
import json
from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tomli_w
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from factory.cli.export import command
from factory.dataset.episode import Episode
from factory.dataset.reader import Dataset
from schemas.terms import Recording
from tests.builders.driven import CONTROL_HZ
from tests.builders.rig import (
    AROUND,
    EYE,
    FORMATS,
    FRONT,
    ID,
    RIG,
    STRIDE,
    assert_depth_agrees,
    export_rig,
    seen,
)

pytestmark = pytest.mark.gl


@pytest.fixture(scope="module")
def root(recordings: dict[Recording, Path]) -> Path:
    return recordings[Recording.STATES]


@pytest.fixture(scope="module")
def episode(root: Path) -> Episode:
    return Dataset(root, rig=RIG)[ID]


@pytest.fixture(scope="module")
def ros2(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An MCAP file for ROS 2, exported by the command line with a rig from a file."""
    place = tmp_path_factory.mktemp("ros2")
    (place / "all.toml").write_text(tomli_w.dumps(RIG.model_dump(mode="json", exclude_none=True)))
    words = ["--to", "mcap", "--ros2", "--episode", "1", "--rig", str(place / "all.toml"), "--workers", "1"]
    done = CliRunner().invoke(command, [str(root), "-o", str(place / "out"), *words], standalone_mode=False)
    assert (done.exception, done.return_value) == (None, 0)
    return place / f"out/episodes/{ID}"


@pytest.fixture(scope="module")
def foxglove(root: Path, tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """The content of an MCAP file for Foxglove: (step, message) pairs by topic, schemas by topic, and attachments."""
    found: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    schemas = {}
    out = export_rig(root, tmp_path_factory.mktemp("mcap") / "out", "mcap", **FORMATS["mcap"])
    with (out / f"episodes/{ID}.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            found[channel.topic].append((round(message.log_time * CONTROL_HZ / 1e9), decoded))
            schemas[channel.topic] = schema.name
        attached = {one.name: json.loads(one.data) for one in reader.iter_attachments()}
    return SimpleNamespace(topics=found, schemas=schemas, attached=attached)


SENSOR_TOPICS = {
    **{f"/front/{output}": "RawImage" for output in ("depth", "ids", "normals", "flow")},
    **{f"/eye/{output}": "RawImage" for output in ("depth", "ids")},
    **{f"/{name}/rgb": "CompressedImage" for name in ("front", "eye", "around")},
    **{f"/{name}/calibration": "CameraCalibration" for name in ("front", "eye")},
    "/scan/scan": "LaserScan",
    "/cloud/points": "PointCloud",
    "/wheels/odom": "Odometry",
}


def test_mcap_has_every_sensor_at_its_rate(foxglove: SimpleNamespace, episode: Episode) -> None:
    expected = {topic: f"foxglove.{kind}" for topic, kind in SENSOR_TOPICS.items()} | {"/imu/imu": "minivla.Imu"}
    assert {
        topic: kind for topic, kind in foxglove.schemas.items() if topic.count("/") == 2 and "path" not in topic
    } == (expected)
    for sensor in RIG.sensors:
        stride = sensor.stride(CONTROL_HZ)
        if sensor in (FRONT, EYE, AROUND):
            stride = np.lcm(stride, STRIDE)  # `fps` reduces the rate of images only
        steps = list(range(0, len(episode), stride))
        for topic in (topic for topic in expected if topic.startswith(f"/{sensor.name}/")):
            assert [t for t, _ in foxglove.topics[topic]] == steps
    assert foxglove.attached["rig.json"]["sensors"][0]["name"] == "front"


def test_mcap_images_and_scans_are_the_measurements(foxglove: SimpleNamespace, episode: Episode) -> None:
    for camera in (FRONT, EYE):
        t, message = foxglove.topics[f"/{camera.name}/rgb"][2]
        truth = seen(episode, camera.name, t)
        assert np.array_equal(np.asarray(Image.open(io.BytesIO(message.data))), truth.rgb)
        depth = foxglove.topics[f"/{camera.name}/depth"][2][1]
        assert (depth.encoding, depth.frame_id) == ("32FC1", f"{camera.name}_optical_frame")
        assert np.array_equal(np.frombuffer(depth.data, "<f4").reshape(depth.height, depth.width), truth.depth)
    normals = foxglove.topics["/front/normals"][2][1]
    assert (normals.encoding, normals.step) == ("32FC3", 96 * 12)
    for t, message in foxglove.topics["/scan/scan"]:
        ranges = seen(episode, "scan", t).ranges[0]
        assert np.array_equal(np.where(np.isinf(message.ranges), 0, message.ranges).astype(np.float32), ranges)
        assert np.isinf(message.ranges).any()
    angles = np.linspace(message.start_angle, message.end_angle, len(message.ranges))
    np.testing.assert_allclose(angles, np.radians(np.arange(90) * 4 - 180), atol=1e-9)
    t, inertia = foxglove.topics["/imu/imu"][9]
    force = episode.motion()["imu"].specific_force[t // 2].tolist()
    assert [inertia.linear_acceleration.x, inertia.linear_acceleration.y, inertia.linear_acceleration.z] == force
    t, wheels = foxglove.topics["/wheels/odom"][-1]
    assert wheels.pose.position.x == episode.motion()["wheels"].poses[t, 0]
    ticks = {pair.key: int(pair.value) for pair in wheels.metadata}
    assert [ticks["left_ticks"], ticks["right_ticks"]] == episode.motion()["wheels"].ticks[t].tolist()


def moved(transform: Any, names: tuple[str, str]) -> tuple[np.ndarray, Rotation]:
    place, turn = (getattr(transform, name) for name in names)
    return np.array((place.x, place.y, place.z)), Rotation.from_quat((turn.x, turn.y, turn.z, turn.w))


def in_frame(points: np.ndarray, frames: dict[str, Any], source: str, target: str) -> np.ndarray:
    """Transforms points from a frame to base_link and then to another frame, by the transforms of the file."""

    def chain(frame: str) -> list[Any]:
        return [] if frame == "base_link" else [frames[frame], *chain(frames[frame][0])]

    for _, place, turn in chain(source):
        points = turn.apply(points) + place
    for _, place, turn in reversed(chain(target)):
        points = turn.inv().apply(points - place)
    return points


def assert_cloud_agrees(cloud: np.ndarray, frames: dict[str, Any], name: str, info: Any, depth: np.ndarray) -> None:
    """Projects points by the transforms and the calibration of a file and compares them with its depth image."""
    optical = in_frame(cloud, frames, "cloud_link", f"{name}_optical_frame")
    model, matrix, distortion = info
    camera = {"camera_matrix": matrix, "distortion": distortion, "pose": [0, 0, 0, 0.5, 0.5, -0.5, 0.5]}
    is_fisheye = model in ("kannala_brandt", "equidistant")
    camera["distortion_model"] = "cv2.fisheye" if is_fisheye else "brown_conrady"
    assert_depth_agrees(camera, optical, depth, is_radial=is_fisheye)


def test_the_cloud_of_a_foxglove_file_agrees_with_its_depth(foxglove: SimpleNamespace) -> None:
    frames = {
        one.child_frame_id: (one.parent_frame_id, *moved(one, ("translation", "rotation")))
        for one in foxglove.topics["/tf"][0][1].transforms
    }
    assert frames["base_link"][0] == frames["wheels_start"][0] == "world"
    message = foxglove.topics["/cloud/points"][0][1]
    kinds = {7: "<f4", 3: "<u2"}
    names = [field.name for field in message.fields]
    layout = {"names": names, "formats": [kinds[field.type] for field in message.fields]}
    points = np.frombuffer(message.data, layout | {"offsets": [field.offset for field in message.fields]})
    assert set(points["ring"]) <= {0, 1, 2, 3}
    xyz = np.stack([points[axis] for axis in "xyz"], axis=1)
    for name, model in (("front", "plumb_bob"), ("eye", "kannala_brandt")):
        info, depth = (foxglove.topics[f"/{name}/{topic}"][0][1] for topic in ("calibration", "depth"))
        assert info.distortion_model == model
        image = np.frombuffer(depth.data, "<f4").reshape(depth.height, depth.width)
        assert_cloud_agrees(xyz, frames, name, (model, info.K, info.D), image)


def test_rosbags_reads_every_sensor(ros2: Path, episode: Episode) -> None:
    found: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    with AnyReader([ros2]) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        for connection, stamp, raw in reader.messages():
            found[connection.topic].append((stamp, reader.deserialize(raw, connection.msgtype)))
    start = found["/odom"][0][0]
    assert kinds["/scan/scan"] == "sensor_msgs/msg/LaserScan"
    assert kinds["/imu/imu"] == "sensor_msgs/msg/Imu"
    assert {one.class_id for one in found["/ids/label_info"][0][1].class_map} == {one.id for one in episode.instances}
    assert not any(topic.startswith("/camera/") for topic in kinds)
    assert [round((stamp - start) * CONTROL_HZ / 1e9) for stamp, _ in found["/eye/depth/image_raw"]] == list(
        range(0, len(episode), 2)
    )
    frames = {
        one.child_frame_id: (one.header.frame_id, *moved(one.transform, ("translation", "rotation")))
        for one in found["/tf_static"][0][1].transforms
    }
    assert frames["wheels_start"][0] == "odom"
    cloud = found["/cloud/points"][0][1]
    layout = {"names": [field.name for field in cloud.fields], "offsets": [field.offset for field in cloud.fields]}
    points = cloud.data.view(np.dtype(layout | {"formats": [{7: "<f4", 4: "<u2"}[f.datatype] for f in cloud.fields]}))
    assert (cloud.width, cloud.point_step) == (len(points), 16)
    xyz = np.stack([points[axis] for axis in "xyz"], axis=1)
    for name, model in (("front", "plumb_bob"), ("eye", "equidistant")):
        info, image = (found[f"/{name}/depth/{topic}"][0][1] for topic in ("camera_info", "image_raw"))
        assert (info.distortion_model, info.header.frame_id) == (model, f"{name}_optical_frame")
        depth = image.data.view("<f4").reshape(image.height, image.width)
        assert_cloud_agrees(xyz, frames, name, (model, info.k, info.d), np.where(np.isinf(depth), 0, depth))
    stamp, scan = found["/scan/scan"][1]
    assert round((stamp - start) * CONTROL_HZ / 1e9) == 5
    assert scan.ranges[~np.isinf(scan.ranges)].tolist() == [r for r in seen(episode, "scan", 5).ranges[0] if r > 0]
    assert scan.angle_min + 89 * scan.angle_increment == pytest.approx(scan.angle_max, abs=1e-5)
    assert found["/imu/imu"][0][1].orientation_covariance[0] == -1
    assert found["/wheels/ticks"][-1][1].data.tolist() == episode.motion()["wheels"].ticks[-1].tolist()

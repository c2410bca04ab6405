"""The MCAP export for ROS 2, read back by `rosbags`: types, frames, times and values."""

from __future__ import annotations

import hashlib
import io
import json
import subprocess
import sys
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation

from factory.cli.export import command
from factory.dataset.reader import Dataset
from factory.export.execution.export_run import ExportOrder, run_export
from factory.export.mcap.ros2_cdr import encode
from factory.export.mcap.ros2_messages import LATCHED, ROS2_TOPICS
from factory.export.options import START_TIME_S, McapOptions
from factory.export.registry import find_exporter
from schemas.config import CameraConfig
from schemas.errors import UsageError
from schemas.scene import decode_scene
from schemas.support.extras import install_command
from tests.builders.dataset import make_dataset, office_package

STEPS, HZ = 12, 60
IMAGES = {topic for topic in ROS2_TOPICS if topic.startswith("/camera/")}
MOTION = {"/tf", "/odom", "/cmd_vel", "/action_tokens"}
Bag = dict[str, list[tuple[int, Any]]]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("ros2") / "data"
    make_dataset(root, 2)
    return root


def export(dataset: Path, out: Path, **options: object) -> Path:
    chosen = find_exporter("mcap").options(ros2=True, **options)
    assert run_export(ExportOrder(dataset, out, "mcap", chosen)).complete
    return out


@pytest.fixture(scope="module")
def out(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(dataset, tmp_path_factory.mktemp("out") / "ros2", fps=30)


def read(path: Path) -> tuple[Bag, dict[str, Any]]:
    """Returns (time, message) pairs by topic, and the connection of each topic."""
    found: Bag = defaultdict(list)
    with AnyReader([path]) as reader:
        for connection, stamp, raw in reader.messages():
            found[connection.topic].append((stamp, reader.deserialize(raw, connection.msgtype)))
        return found, {connection.topic: connection for connection in reader.connections}


@pytest.fixture(scope="module")
def bag(out: Path) -> Bag:
    return read(out / "episodes/ep_000001")[0]


def nanoseconds(header: Any) -> int:
    return header.stamp.sec * 10**9 + header.stamp.nanosec


def test_rosbags_decodes_every_message_with_the_published_types(out: Path, bag: Bag) -> None:
    _, connections = read(out / "episodes/ep_000001/ep_000001.mcap")
    assert {topic: found.msgtype for topic, found in connections.items()} == {
        topic: kind for topic, kind in ROS2_TOPICS.items() if topic in bag
    }
    assert ROS2_TOPICS.keys() - bag.keys() <= {"/path/planned"}  # the expert of these episodes plans no path
    counts = Counter({topic: len(messages) for topic, messages in bag.items()})
    assert {counts[topic] for topic in IMAGES} == {STEPS // 2}
    assert {counts[topic] for topic in MOTION} == {STEPS}
    assert {counts[topic] for topic in LATCHED & bag.keys()} == {1}
    kept = {topic for topic, found in connections.items() if found.ext.offered_qos_profiles}
    assert kept == LATCHED & bag.keys()
    profiles = [connections[topic].ext.offered_qos_profiles[0] for topic in kept]
    assert {(one.durability.name, one.reliability.name, one.depth) for one in profiles} == {
        ("TRANSIENT_LOCAL", "RELIABLE", 1)
    }


def test_the_folder_of_an_episode_is_a_bag_with_the_topics_and_counts_of_its_file(out: Path) -> None:
    folder = out / "episodes/ep_000001"
    with Reader(folder) as bag, Reader(folder / "ep_000001.mcap") as file:
        assert (bag.start_time, bag.end_time, bag.message_count) == (file.start_time, file.end_time, file.message_count)
        assert bag.duration == 1 + (STEPS - 1) * 10**9 // HZ
        assert facts_of(bag.connections) == facts_of(file.connections)
        assert len(list(bag.messages())) == bag.message_count


def facts_of(connections: list[Any]) -> set[tuple[str, str, int, str]]:
    return {(one.topic, one.msgtype, one.msgcount, str(one.ext)) for one in connections}


def test_the_metadata_has_the_structure_that_rosbags_writes(out: Path, tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(tmp_path / "bag", version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/a", "std_msgs/msg/String", typestore=store)
        writer.write(connection, 1, store.serialize_cdr(store.types["std_msgs/msg/String"]("a"), "std_msgs/msg/String"))
    ours, theirs = (
        YAML(typ="safe").load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
        for folder in (out / "episodes/ep_000001", tmp_path / "bag")
    )
    assert theirs.keys() - ours.keys() == {"custom_data", "ros_distro"}, "fields since versions 6 and 8"
    assert (ours.pop("version"), ours.keys() <= theirs.keys()) == (5, True)
    topics = [made["topics_with_message_count"][0] for made in (ours, theirs)]
    assert topics[1]["topic_metadata"].keys() - topics[0]["topic_metadata"].keys() == {"type_description_hash"}
    assert (ours["files"][0].keys(), topics[0].keys()) == (theirs["files"][0].keys(), topics[1].keys())
    for key in ("storage_identifier", "compression_format", "compression_mode"):
        assert ours[key] == theirs[key]


def test_the_labels_name_every_id_of_the_images(bag: Bag, dataset: Path) -> None:
    episode = Dataset(dataset)[0]
    (_, info), (_, text) = bag["/ids/label_info"][0], bag["/ids/instances"][0]
    labels = {one.class_id: one.class_name for one in info.class_map}
    described = {one["id"]: one for one in json.loads(text.data)}
    assert labels.keys() == described.keys() == {each.id for each in episode.instances}
    assert set(np.unique(episode.ids(0))) - {0} <= labels.keys()
    for each in episode.instances:
        assert described[each.id]["prim_path"] == each.prim_path
        assert labels[each.id] == (each.category or each.prim_path.split("/")[-1])
    target = decode_scene(io.BytesIO(office_package())).info.target("chair_001")
    assert labels[target.instance_id] == "chair"


def test_times_are_evenly_spaced_from_the_start_time_and_equal_in_header_and_record(bag: Bag) -> None:
    start = START_TIME_S * 10**9
    for topic in MOTION:
        assert [stamp for stamp, _ in bag[topic]] == [start + t * 10**9 // HZ for t in range(STEPS)]
    for topic in {"/odom", *IMAGES}:
        assert [nanoseconds(message.header) for _, message in bag[topic]] == [stamp for stamp, _ in bag[topic]]
    assert {stamp for topic in LATCHED & bag.keys() for stamp, _ in bag[topic]} == {start}


def test_episodes_follow_each_other_without_overlap(out: Path, dataset: Path, tmp_path: Path) -> None:
    spans = [read(out / f"episodes/ep_00000{n}")[0]["/odom"] for n in (1, 2)]
    assert spans[1][0][0] - spans[0][0][0] == 60 * 10**9
    assert spans[0][-1][0] < spans[1][0][0]
    later = export(dataset, tmp_path / "later", fps=1, start_time=1_800_000_000)
    assert read(later / "episodes/ep_000001")[0]["/odom"][0][0] == 1_800_000_000 * 10**9


def test_coordinate_frames_follow_rep_105_up_to_the_optical_frame(bag: Bag, dataset: Path) -> None:
    static = {one.child_frame_id: one for one in bag["/tf_static"][0][1].transforms}
    chain = [(one.header.frame_id, one.child_frame_id) for one in static.values()]
    assert chain == [
        ("map", "odom"),
        ("base_link", "front_camera_link"),
        ("front_camera_link", "front_camera_optical_frame"),
    ]
    episode, camera = Dataset(dataset)[0], CameraConfig()
    for t, (_, message) in enumerate(bag["/tf"]):
        (moving,) = message.transforms
        assert (moving.header.frame_id, moving.child_frame_id) == ("odom", "base_link")
        x, y, _z, qw, *rest = (float(value) for value in episode.poses[t])
        assert (moving.transform.translation.x, moving.transform.translation.y) == (x, y)
        body = Rotation.from_quat([*rest, qw])
        ahead = body.apply([1.0, 0.0, 0.0])
        optical = body * rotation(static["front_camera_link"]) * rotation(static["front_camera_optical_frame"])
        np.testing.assert_allclose(optical.apply([0, 0, 1]), ahead, atol=1e-9)  # z looks forward
        np.testing.assert_allclose(optical.apply([0, 1, 0]), [0, 0, -1], atol=1e-6)  # y points down
    mount = static["front_camera_link"].transform.translation
    assert (mount.x, mount.y, mount.z) == (camera.x_m, camera.y_m, camera.z_m)
    assert {message.header.frame_id for topic in IMAGES for _, message in bag[topic]} == {"front_camera_optical_frame"}
    assert {message.header.frame_id for _, message in bag["/odom"]} == {"odom"}
    assert {message.child_frame_id for _, message in bag["/odom"]} == {"base_link"}


def rotation(transform: Any) -> Rotation:
    q = transform.transform.rotation
    return Rotation.from_quat([q.x, q.y, q.z, q.w])


def test_odometry_and_commands_are_those_of_the_episode(bag: Bag, dataset: Path) -> None:
    episode = Dataset(dataset)[0]
    for t in range(STEPS):
        pose = bag["/odom"][t][1].pose.pose
        found = [pose.position.x, pose.position.y, pose.position.z, pose.orientation.w, pose.orientation.z]
        np.testing.assert_array_equal(found, episode.poses[t, [0, 1, 2, 3, 6]])
        command_ = bag["/cmd_vel"][t][1]
        np.testing.assert_array_equal(np.float32([command_.linear.x, command_.angular.z]), episode.actions[t])
        assert bag["/action_tokens"][t][1].data.tolist() == episode.tokens[t].tolist()
    speeds = [message.twist.twist.linear.x for _, message in bag["/odom"]]
    steps = np.linalg.norm(np.diff(episode.poses[:, :2], axis=0), axis=1) * HZ
    np.testing.assert_allclose(speeds, [0.0, *steps], atol=1e-5)


def test_images_are_those_of_the_episode(bag: Bag, dataset: Path) -> None:
    episode = Dataset(dataset)[0]
    for number in range(STEPS // 2):
        t = 2 * number
        colour = bag["/camera/rgb/image_raw/compressed"][number][1]
        assert colour.format == "rgb8; png compressed bgr8"
        np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(colour.data.tobytes()))), episode.rgb(t))
        depth = pixels(bag["/camera/depth/image_raw"][number][1], "32FC1", "<f4")
        np.testing.assert_array_equal(np.where(np.isinf(depth), 0, depth), episode.depth(t))
        assert (np.isinf(depth) == (episode.depth(t) == 0)).all()
        ids = pixels(bag["/camera/ids/image_raw"][number][1], "mono16", "<u2")
        np.testing.assert_array_equal(ids, episode.ids(t))


def pixels(message: Any, encoding: str, dtype: str) -> np.ndarray:
    assert (message.encoding, message.is_bigendian, message.height, message.width) == (encoding, 0, 640, 640)
    assert message.step == 640 * np.dtype(dtype).itemsize
    return message.data.view(dtype).reshape(640, 640)


def test_the_calibration_matches_the_camera_projection(bag: Bag) -> None:
    for topic in ("/camera/rgb/camera_info", "/camera/depth/camera_info"):
        info = bag[topic][0][1]
        assert (info.width, info.height, info.distortion_model) == (640, 640, "plumb_bob")
        assert info.k.reshape(3, 3).tolist() == [
            [pytest.approx(320), 0, 319.5],
            [0, pytest.approx(320), 319.5],
            [0, 0, 1],
        ]
        np.testing.assert_array_equal(info.p.reshape(3, 4)[:, :3], info.k.reshape(3, 3))
        assert not info.d.any()


def test_map_and_target_are_those_of_the_scene_and_the_instruction_is_that_of_the_episode(
    bag: Bag, dataset: Path
) -> None:
    scene, episode = decode_scene(io.BytesIO(office_package())), Dataset(dataset)[0]
    grid = bag["/map"][0][1]
    assert (grid.header.frame_id, grid.info.resolution) == ("map", pytest.approx(scene.info.grid_resolution_m))
    cells = grid.data.reshape(grid.info.height, grid.info.width)
    np.testing.assert_array_equal(cells == 100, scene.occupancy > 0)
    assert set(np.unique(cells)) <= {0, 100}
    assert (grid.info.origin.position.x, grid.info.origin.position.y) == scene.info.grid_origin_m
    box, text = bag["/target"][0][1].markers
    target = scene.info.target("chair_001")
    assert (box.pose.position.x, box.pose.position.y, box.pose.position.z) == target.centroid_m
    assert (text.text, box.header.frame_id) == ("chair_001", "map")
    assert bag["/instruction"][0][1].data == episode.instruction
    assert len(bag["/path/driven"][0][1].poses) == STEPS


def test_equal_episodes_give_equal_files(out: Path, dataset: Path, tmp_path: Path) -> None:
    again = export(dataset, tmp_path / "again", fps=30)
    folders = [made / "episodes/ep_000001" for made in (out, again)]
    digests = [{p.name: hashlib.sha256(p.read_bytes()).digest() for p in folder.iterdir()} for folder in folders]
    assert digests[0] == digests[1]
    assert digests[0].keys() == {"ep_000001.mcap", "metadata.yaml"}


def test_a_message_with_an_unknown_field_is_refused() -> None:
    with pytest.raises(KeyError, match="geometry_msgs/msg/Twist has no field speed"):
        encode("geometry_msgs/msg/Twist", {"speed": 1.0})


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--to", "gnm", "--ros2"), "--ros2 not valid for format gnm"),
        (("--to", "mcap", "--start-time", "1800000000"), "--start-time requires --ros2"),
        (("--to", "mcap", "--ros2", "--start-time", "2147483600"), "give at most 2147483527"),
        (("--to", "mcap", "--ros2", "--start-time", "0"), "--start-time: Input should be greater than or equal to 1"),
    ],
)
def test_invalid_ros2_options_are_refused_before_anything_is_written(
    dataset: Path, tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    arguments = [str(dataset), "-o", str(tmp_path / "out"), *words]
    done = CliRunner().invoke(command, arguments, standalone_mode=False)
    assert isinstance(done.exception, UsageError)
    assert said in str(done.exception)
    assert not (tmp_path / "out").exists()


def test_a_missing_package_is_named_with_its_extra(dataset: Path, tmp_path: Path) -> None:
    code = "import sys; sys.modules['rosbags'] = None; from factory.cli.main import main; main()"
    words = ["export", str(dataset), "--to", "mcap", "--ros2", "-o", str(tmp_path / "out")]
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert install_command("ros2") in done.stderr
    assert not (tmp_path / "out").exists()


def test_stored_options_omit_ros2_unless_it_is_set() -> None:
    assert McapOptions(fps=30).model_dump(mode="json") == {"fps": 30}
    assert McapOptions().model_dump(mode="json") == {"fps": None}
    assert McapOptions.model_validate_json(McapOptions(ros2=True).model_dump_json()).ros2

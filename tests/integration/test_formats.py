"""Exports a small dataset in every format and reads the exports with the usual reader of each format."""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import math
import pickle
import subprocess
import sys
import tarfile
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image

from coordinator.archive.opening import open_archive
from coordinator.tables.write import write_tables
from factory.dataset.reader import Dataset
from factory.export.execution.export_run import ExportOrder, run_export
from factory.export.registry import find_exporter
from factory.export.vlnce.episode import from_habitat
from schemas.scene import decode_scene
from schemas.support.geometry import yaw_of
from schemas.terms import Split
from tests.builders.dataset import NOW, archive_episode, episode_of, office_package
from tests.builders.discrete_agent import execute
from tests.builders.plan import small_plan

SPLITS = (Split.TRAIN_ID, Split.TEST_ID, Split.TRAIN_ID)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of three episodes with twelve frames each, in two splits."""
    place = tmp_path_factory.mktemp("formats")
    root, package = place / "dataset", office_package()
    sha256 = hashlib.sha256(package).hexdigest()
    source = place / "office.scene"
    source.write_bytes(package)
    plan = small_plan(len(SPLITS))
    with open_archive(root) as archive:
        archive.add_scene(source, "office", sha256)
        rows = [
            archive_episode(archive, episode_of(plan, index, sha256, len(package)).with_job(split=split))
            for index, split in enumerate(SPLITS, 1)
        ]
        write_tables(archive, plan, {"office": sha256}, rows, [], NOW)
    return root


def export(dataset: Path, out: Path, name: str, **options: object) -> Path:
    chosen = find_exporter(name).options(**options)
    report = run_export(ExportOrder(dataset, out, name, chosen))
    assert report.complete
    return out


@pytest.fixture(scope="module")
def shards(dataset, tmp_path_factory):
    return export(dataset, tmp_path_factory.mktemp("webdataset") / "out", "webdataset", fps=20)


@pytest.fixture(scope="module")
def gnm(dataset, tmp_path_factory):
    return export(dataset, tmp_path_factory.mktemp("gnm") / "out", "gnm")


@pytest.fixture(scope="module")
def vlnce(dataset, tmp_path_factory):
    return export(dataset, tmp_path_factory.mktemp("vlnce") / "out", "vlnce")


@pytest.fixture(scope="module")
def mcap(dataset, tmp_path_factory):
    return export(dataset, tmp_path_factory.mktemp("mcap") / "out", "mcap", fps=30)


WEBDATASET_READER = """
import json, sys
import numpy, webdataset
found = []
for sample in webdataset.WebDataset(sys.argv[1], shardshuffle=False).decode("rgb8"):
    found.append({"key": sample["__key__"], "rgb": int(sample["rgb.png"].astype(int).sum()),
        "depth": float(sample["depth.npy.gz"].sum()), "dtype": str(sample["depth.npy.gz"].dtype),
        "shape": sample["depth.npy.gz"].shape,
        "ids": int(sample["seg.npy.gz"].astype(int).sum()), "action": sample["action.json"], "json": sample["json"]})
print(json.dumps(found))
"""

DATASETS_READER = """
import json, sys
import datasets
found = []
config, split = sys.argv[2:]
data = datasets.load_dataset(sys.argv[1], config, streaming=True, split=split)
for sample in data:
    image = sample["rgb.png"]
    found.append([sample["__key__"], image.size, int(sample["seg.npy.gz"][0][0]), len(sample["depth.npy.gz"]),
        sample["json"]["instruction"], sample["action.json"]["v_token"]])
print(json.dumps(found))
"""


def run_reader(code: str, *arguments: object) -> list:
    command = [sys.executable, "-c", code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_webdataset_reads_the_shards(dataset, shards):
    data = Dataset(dataset)
    found = run_reader(WEBDATASET_READER, shards / "train_id-000000.tar")
    assert Counter(sample["json"]["episode_id"] for sample in found) == {"ep_000001": 4, "ep_000003": 4}
    for sample in found:
        episode, t = data[sample["json"]["episode_id"]], sample["json"]["step"]
        assert sample["key"].endswith(f"{episode.episode_id}_{t:06d}")
        assert sample["rgb"] == int(episode.rgb(t).astype(int).sum())
        assert (sample["dtype"], sample["shape"]) == ("float32", [640, 640])
        assert sample["depth"] == pytest.approx(float(episode.depth(t).sum()))
        assert sample["ids"] == int(episode.ids(t).astype(int).sum())
        assert sample["json"]["instruction"] == episode.instruction
        mean = episode.actions[t : t + 3].mean(axis=0)
        assert (sample["action"]["v_mps"], sample["action"]["w_rps"]) == pytest.approx(tuple(mean), abs=1e-6)


@pytest.mark.parametrize(("config", "split"), [("default", "train_id"), ("train_id", "train")])
def test_load_dataset_streams_the_shards_through_their_card(shards, config, split):
    found = run_reader(DATASETS_READER, shards, config, split)
    assert len(found) == 8
    assert {tuple(size) for _, size, _, _, _, _ in found} == {(640, 640)}
    assert {corner for _, _, corner, _, _, _ in found} == {0}
    assert {rows for _, _, _, rows, _, _ in found} == {640}


def test_load_dataset_loads_each_split_of_the_paper_tree(dataset, tmp_path):
    out = export(dataset, tmp_path / "out", "paper", split_names="published")
    code = (
        "import json, sys, datasets; loaded = datasets.load_dataset(sys.argv[1], cache_dir=sys.argv[2]); "
        "told = {split: [(row['episode_id'], row['split']) for row in rows] for split, rows in loaded.items()}; "
        "print(json.dumps(told))"
    )
    assert run_reader(code, out, tmp_path / "cache") == {
        "train_id": [["ep_000001", "train_id"], ["ep_000003", "train_id"]],
        "test_id": [["ep_000002", "test_id"]],
    }


def test_shards_are_plain_tar_files_described_by_the_index(dataset, shards):
    listed = json.loads((shards / "shards.json").read_text())["shards"]
    assert [(shard["split"], shard["samples"]) for shard in listed] == [("train_id", 8), ("test_id", 4)]
    for shard in listed:
        with tarfile.open(shards / shard["name"], "r:") as archive:
            members = archive.getmembers()
            assert len(members) == 5 * shard["samples"]
            assert {(member.mtime, member.uid, member.uname, member.mode) for member in members} == {(0, 0, "", 0o644)}
            name = f"{shard['episodes'][0]}_000003"
            ids = gzip.decompress(archive.extractfile(f"{name}.seg.npy.gz").read())
        expected = Dataset(dataset)[shard["episodes"][0]].ids(3)
        np.testing.assert_array_equal(np.load(io.BytesIO(ids)), expected)


def test_shards_are_closed_at_their_size_limit_without_loss(dataset, tmp_path):
    out = export(dataset, tmp_path / "out", "webdataset", shard_mb=1)
    listed = json.loads((out / "shards.json").read_text())["shards"]
    assert sorted(episode for shard in listed for episode in shard["episodes"]) == [
        "ep_000001",
        "ep_000002",
        "ep_000003",
    ]
    assert sum(shard["samples"] for shard in listed) == 36
    assert {shard["name"] for shard in listed} == {path.name for path in out.glob("*.tar")}
    assert all(len(shard["episodes"]) == 1 for shard in listed if shard["member_bytes"] >= 1_000_000)


def test_the_mcap_reader_reads_every_topic_at_its_rate(dataset, mcap):
    for episode in Dataset(dataset):
        with (mcap / f"episodes/{episode.episode_id}.mcap").open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            summary = reader.get_summary()
            topics = {channel.topic: channel.id for channel in summary.channels.values()}
            counts = {topic: summary.statistics.channel_message_counts[number] for topic, number in topics.items()}
            times = [message.log_time for _, channel, message in reader.iter_messages("/odom")]
            (notes,) = list(reader.iter_attachments())
            (facts,) = list(reader.iter_metadata())
        images, motion = (
            ("/camera/rgb", "/camera/depth", "/camera/ids"),
            ("/tf", "/odom", "/action", "/camera/calibration"),
        )
        assert {topic: counts[topic] for topic in (*images, *motion)} == {
            **dict.fromkeys(images, 6),
            **dict.fromkeys(motion, 12),
        }
        assert {"/instruction", "/map", "/target", "/path/driven"} <= counts.keys()
        assert times == [t * 10**9 // 60 for t in range(12)]
        assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
        assert json.loads(notes.data)["episode_id"] == episode.episode_id
        assert facts.metadata["instruction"] == episode.instruction


def test_mcap_images_and_poses_are_those_of_the_episode(dataset, mcap):
    episode = Dataset(dataset)[1]
    seen = Counter()
    with (mcap / f"episodes/{episode.episode_id}.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            t = round(message.log_time * 60 / 1e9)
            seen[channel.topic] += 1
            assert schema.encoding == "protobuf"
            if channel.topic == "/camera/rgb":
                assert (schema.name, decoded.format) == ("foxglove.CompressedImage", "png")
                np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(decoded.data))), episode.rgb(t))
            elif channel.topic == "/camera/depth":
                assert (decoded.width, decoded.height, decoded.encoding, decoded.step) == (640, 640, "32FC1", 2560)
                depth = np.frombuffer(decoded.data, "<f4").reshape(640, 640)
                np.testing.assert_array_equal(depth, episode.depth(t))
            elif channel.topic == "/camera/ids":
                ids = np.frombuffer(decoded.data, "<u2").reshape(640, 640)
                np.testing.assert_array_equal(ids, episode.ids(t))
            elif channel.topic == "/odom":
                assert decoded.pose.position.x == float(episode.poses[t, 0])
            elif channel.topic == "/action":
                assert (decoded.v_mps, decoded.w_rps) == tuple(map(float, episode.actions[t]))
                assert (decoded.v_token, decoded.w_token) == tuple(episode.tokens[t])
    assert seen["/camera/rgb"] == 6


class LoaderTrajectory:
    """Reads a trajectory with the operations of the published data loaders of GNM, ViNT and NoMaD."""

    def __init__(self, data_folder: Path, name: str) -> None:
        with (data_folder / name / "traj_data.pkl").open("rb") as file:
            self.data = pickle.load(file)
        self.folder = data_folder / name

    def image(self, time: int) -> Image.Image:
        return Image.open(self.folder / f"{time}.jpg")

    def actions(self, time: int, predicted: int, spacing: float) -> np.ndarray:
        yaw = self.data["yaw"][time : time + predicted + 1]
        positions = self.data["position"][time : time + predicted + 1]
        assert len(yaw.shape) == 1
        assert positions.shape == (predicted + 1, 2)
        turn = np.array([[np.cos(yaw[0]), -np.sin(yaw[0])], [np.sin(yaw[0]), np.cos(yaw[0])]])
        return (positions - positions[0]).dot(turn)[1:] / spacing


def test_the_export_meets_the_expectations_of_the_gnm_loaders(dataset, gnm):
    data, config = Dataset(dataset), yaml.safe_load((gnm / "data_config.yaml").read_text())["minivla_nav"]
    names = (gnm / "data_splits/minivla_nav/train/traj_names.txt").read_text().split("\n")
    assert names.pop() == ""
    assert names == ["ep_000001", "ep_000003"]
    assert (gnm / "data_splits/minivla_nav/test/traj_names.txt").read_text() == "ep_000002\n"
    for name in names:
        trajectory, episode = LoaderTrajectory(gnm / "minivla_nav", name), data[name]
        for time in range(len(trajectory.data["position"])):
            image = np.asarray(trajectory.image(time), np.float64)
            assert image.shape == (640, 640, 3)
            assert np.abs(image - episode.rgb(time)).mean() < 6
        assert trajectory.data["position"].dtype == trajectory.data["yaw"].dtype == np.float64
        ahead = trajectory.actions(0, 5, config["metric_waypoint_spacing"])
        assert (ahead[:, 0] > 0).all()  # in the frame of the robot: x forward, y left
        assert np.abs(ahead[:, 1]).max() < 1e-6


def test_gnm_waypoints_have_an_average_spacing_of_one(dataset, gnm):
    spacing = yaml.safe_load((gnm / "data_config.yaml").read_text())["minivla_nav"]["metric_waypoint_spacing"]
    steps = [np.linalg.norm(np.diff(episode.poses[:, :2], axis=0), axis=1) for episode in Dataset(dataset)]
    assert spacing == pytest.approx(float(np.concatenate(steps).mean()), abs=1e-6)


def test_gnm_pickles_reference_only_public_numpy_names(gnm):
    data = (gnm / "minivla_nav/ep_000001/traj_data.pkl").read_bytes()
    assert b"numpy.core" not in data  # private numpy modules, old and new name
    assert b"numpy._core" not in data


def test_vlnce_files_have_habitats_schema_and_can_be_converted_back(dataset, vlnce):
    data = Dataset(dataset)
    for split, ids in (("train_id", [1, 3]), ("test_id", [2])):
        with gzip.open(vlnce / f"{split}/{split}.json.gz", "rt") as file:
            found = json.load(file)
        with gzip.open(vlnce / f"{split}/{split}_gt.json.gz", "rt") as file:
            paths = json.load(file)
        words = found["instruction_vocab"]["word_list"]
        assert [entry["episode_id"] for entry in found["episodes"]] == ids
        for entry in found["episodes"]:
            assert set(entry) == {
                *("episode_id", "trajectory_id", "scene_id", "start_position", "start_rotation"),
                *("goals", "reference_path", "instruction", "info"),
            }
            episode = data[entry["info"]["minivla_episode_id"]]
            assert from_habitat(entry["start_position"]) == pytest.approx(tuple(episode.poses[0, :3]))
            locations = [from_habitat(point) for point in paths[str(entry["episode_id"])]["locations"]]
            np.testing.assert_allclose(locations, episode.poses[:, :3], atol=1e-6)
            actions = paths[str(entry["episode_id"])]["actions"]
            track, _ = execute(actions, episode.poses[0, :2].tolist(), float(yaw_of(episode.poses[:1])[0]))
            goals = [from_habitat(goal["position"])[:2] for goal in entry["goals"]]
            assert min(math.dist(track[-1], goal) for goal in goals) <= entry["goals"][0]["radius"]
            assert actions.count(0) == 1
            said = " ".join(words[token] for token in entry["instruction"]["instruction_tokens"] if token)
            assert said.replace(" .", ".") == episode.instruction.lower()
            assert (vlnce / "scene_datasets" / entry["scene_id"]).is_file()


def test_vlnce_scenes_are_binary_gltf_with_every_triangle(vlnce):
    loaded = trimesh.load(vlnce / "scene_datasets/minivla/office/office.glb", process=False)
    scene = decode_scene(io.BytesIO(office_package()))
    (mesh,) = loaded.dump()
    assert mesh.faces.size == scene.part_count.sum()
    points = [from_habitat(point) for point in mesh.vertices[mesh.faces.ravel()].tolist()]
    np.testing.assert_allclose(points, scene.positions, atol=1e-6)

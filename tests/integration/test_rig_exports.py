"""Exports with the sensors of a rig, read back with the reader of each format."""

from __future__ import annotations

import gzip
import io
import json
import subprocess
import sys
import tarfile
from collections import defaultdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from factory.dataset.episode import Episode
from factory.dataset.reader import Dataset
from factory.export.execution.manifest import MANIFEST_FILE
from factory.export.lerobot.features import DepthCode
from factory.export.output import WORK_FOLDER
from factory.export.registry import EXPORTERS, find_exporter
from factory.export.video import read_video
from schemas.errors import InvalidRig, UsageError, WorldError
from schemas.rig import (
    Rig,
)
from schemas.terms import Recording
from tests.builders.driven import CONTROL_HZ
from tests.builders.rig import (
    AROUND,
    CLOUD,
    EYE,
    FORMATS,
    FPS,
    FRONT,
    ID,
    IMU,
    RIG,
    SCAN,
    STRIDE,
    assert_depth_agrees,
    export_rig,
    latest,
    rotation_of,
    seen,
)
from workers.sensors import points_of

pytestmark = pytest.mark.gl


@pytest.fixture(scope="module")
def root(recordings: dict[Recording, Path]) -> Path:
    return recordings[Recording.STATES]


@pytest.fixture(scope="module")
def episode(root: Path) -> Episode:
    return Dataset(root, rig=RIG)[ID]


@pytest.fixture(scope="module")
def exports(root: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    place = tmp_path_factory.mktemp("rigs")
    return {name: export_rig(root, place / name, name, **options) for name, options in FORMATS.items()}


def contents(out: Path) -> dict[str, bytes]:
    files = {path.relative_to(out): path for path in out.rglob("*") if path.is_file()}
    found = {str(file): path.read_bytes() for file, path in files.items() if file.parts[0] != WORK_FOLDER}
    manifest = json.loads(found[MANIFEST_FILE])
    for name in ("run", "record", "dataset_digest"):  # they name the dataset, which is another one
        del manifest["source"][name]
    return {**found, MANIFEST_FILE: json.dumps(manifest).encode()}


def test_formats_that_take_a_rig_are_tested() -> None:
    assert {name for name in EXPORTERS if find_exporter(name).takes_rig} == FORMATS.keys()


@pytest.mark.parametrize("name", ["lerobot", "webdataset", "mcap"])
def test_frames_and_states_give_equal_exports(
    recordings: dict[Recording, Path], exports: dict[str, Path], tmp_path: Path, name: str
) -> None:
    frames = export_rig(recordings[Recording.FRAMES], tmp_path / "out", name, **FORMATS[name])
    ours, theirs = contents(exports[name]), contents(frames)
    assert [file for file in ours.keys() | theirs.keys() if ours.get(file) != theirs.get(file)] == []


def columns_of(path: Path) -> dict[str, Any]:
    table = pq.read_table(path)
    return {name: np.asarray(table[name].to_pylist()) for name in table.column_names if "images" not in name}


@pytest.mark.parametrize(
    ("name", "data"),
    [("lerobot", "data/chunk-000/file-000.parquet"), ("lerobot-v2.1", "data/chunk-000/episode_000000.parquet")],
)
def test_lerobot_rows_have_the_latest_measurements(
    exports: dict[str, Path], episode: Episode, name: str, data: str
) -> None:
    columns, info = columns_of(exports[name] / data), json.loads((exports[name] / "meta/info.json").read_text())
    shapes = {key: tuple(feature["shape"]) for key, feature in info["features"].items()}
    motion = episode.motion()
    for row, t in enumerate(range(0, len(episode), STRIDE)):
        assert np.array_equal(columns["observation.scan"][row], seen(episode, "scan", latest(SCAN, t)).ranges[0])
        assert np.array_equal(columns["observation.cloud"][row], seen(episode, "cloud", latest(CLOUD, t)).ranges)
        wheels, imu = motion["wheels"], motion["imu"]
        state = np.concatenate((wheels.poses[t], wheels.twists[t])).astype(np.float32)
        assert np.array_equal(columns["observation.state"][row], state)
        inertia = np.concatenate((imu.angular_velocity[t // 2], imu.specific_force[t // 2]))
        assert np.array_equal(columns["observation.imu"][row], inertia)
    for key in ("observation.scan", "observation.cloud", "observation.imu", "observation.state"):
        assert columns[key].shape[1:] == shapes[key]
    stats = json.loads((exports[name] / "meta/stats.json").read_text())
    assert np.shape(stats["observation.cloud"]["mean"]) == (1,)
    assert stats["observation.cloud"]["mean"] == pytest.approx([columns["observation.cloud"].mean()])
    assert np.shape(stats["observation.imu"]["std"]) == (6,)
    assert json.loads((exports[name] / "meta/rig.json").read_text())["sensors"][0]["every_steps"] == 3


def images_of(features: dict[str, dict[str, Any]]) -> dict[str, tuple[Any, ...]]:
    images = {key: value for key, value in features.items() if value["dtype"] in ("image", "video")}
    return {key: (value["dtype"], *value["shape"]) for key, value in images.items()}


def test_lerobot_videos_show_every_camera(exports: dict[str, Path], episode: Episode) -> None:
    out = exports["lerobot"]
    features = json.loads((out / "meta/info.json").read_text())["features"]
    extra = json.loads((out / "extra/meta/info.json").read_text())["features"]
    assert images_of(features) == {
        "observation.images.front": ("video", 64, 96, 3),
        "observation.images.eye": ("video", 64, 64, 3),
        "observation.images.around": ("video", 32, 64, 3),
    }
    assert images_of(extra) == {
        "depth.front": ("video", 64, 96, 1),
        "ids.front": ("image", 64, 96, 1),
        "depth.eye": ("video", 64, 64, 1),
        "ids.eye": ("image", 64, 64, 1),
    }
    for camera in (FRONT, EYE, AROUND):
        place = out / f"videos/observation.images.{camera.name}/chunk-000/file-000.mp4"
        shown = list(read_video(place))
        assert [round(time * FPS) for time, _, _ in shown] == list(range(-(-len(episode) // STRIDE)))
        for row in (0, 7, len(shown) - 1):
            truth = seen(episode, camera.name, latest(camera, row * STRIDE)).rgb
            assert np.abs(shown[row][2].astype(int) - truth).mean() < 10
    for camera in (FRONT, EYE):
        info = extra[f"depth.{camera.name}"]["info"]
        place = out / f"extra/videos/depth.{camera.name}/chunk-000/file-000.mp4"
        codes = [image for _, _, image in read_video(place, "gray12le")]
        truth = seen(episode, camera.name, latest(camera, 7 * STRIDE)).depth
        assert info["video.depth_max"] > truth.max()
        step = np.log((info["video.depth_max"] + 3.5) / 3.5) / 4095
        error = np.abs(DepthCode(info["video.depth_max"]).decode(codes[7]) - truth)
        assert (error <= 0.51 * step * (truth + 3.5) + 1e-4).all()
    pictures = pq.read_table(out / "extra/data/chunk-000/file-000.parquet")["ids.eye"].to_pylist()
    ids = np.asarray(Image.open(io.BytesIO(pictures[7]["bytes"])))
    assert np.array_equal(ids, seen(episode, "eye", latest(EYE, 7 * STRIDE)).ids)


def test_gr00ts_modality_names_every_camera_and_sensor(exports: dict[str, Path]) -> None:
    modality = json.loads((exports["lerobot-v2.1"] / "meta/modality.json").read_text())
    assert list(modality["video"]) == ["front", "eye", "around"]
    assert modality["state"]["imu"] == {
        "start": 0,
        "end": 6,
        "dtype": "float32",
        "original_key": "observation.imu",
    }
    assert list((exports["lerobot-v2.1"] / "videos/chunk-000").iterdir())


WEBDATASET_READER = """
import json, sys
import webdataset
found = []
for sample in webdataset.WebDataset(sys.argv[1], shardshuffle=False).decode("rgb8"):
    shapes = {name: list(value.shape) for name, value in sample.items() if hasattr(value, "shape")}
    other = {name: value for name, value in sample.items() if name.endswith("json")}
    found.append({"shapes": shapes, "json": other, "sum": float(sample["cloud.ranges.npy.gz"].sum())})
print(json.dumps(found))
"""


def test_webdataset_reads_a_member_of_each_sensor(exports: dict[str, Path], episode: Episode) -> None:
    shard = exports["webdataset"] / "train_id-000000.tar"
    done = subprocess.run(
        [sys.executable, "-c", WEBDATASET_READER, str(shard)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    samples, motion = json.loads(done.stdout), episode.motion()
    shapes = {
        "front.rgb.png": [64, 96, 3],
        "front.depth.npy.gz": [64, 96],
        "front.ids.npy.gz": [64, 96],
        "front.normals.npy.gz": [64, 96, 3],
        "front.flow.npy.gz": [64, 96, 2],
        "eye.rgb.png": [64, 64, 3],
        "eye.depth.npy.gz": [64, 64],
        "eye.ids.npy.gz": [64, 64],
        "around.rgb.png": [32, 64, 3],
        "scan.ranges.npy.gz": [1, 90],
        "scan.ids.npy.gz": [1, 90],
        "cloud.ranges.npy.gz": [4, 180],
        "cloud.ids.npy.gz": [4, 180],
    }
    steps: dict[str, list[int]] = defaultdict(list)
    for number, sample in enumerate(samples):
        t = number * STRIDE
        assert sample["shapes"] == shapes
        assert sample["json"]["sensors.json"] == {s.name: latest(s, t) for s in (FRONT, EYE, AROUND, SCAN, CLOUD)}
        assert sample["sum"] == pytest.approx(float(seen(episode, "cloud", latest(CLOUD, t)).ranges.sum()))
        for name in ("imu", "wheels"):
            steps[name] += sample["json"][f"{name}.motion.json"]["steps"]
    assert steps["wheels"] == list(range((len(samples) - 1) * STRIDE + 1))  # each measurement occurs once
    assert steps["imu"] == list(range(0, (len(samples) - 1) * STRIDE + 1, 2))
    last = samples[-1]["json"]["wheels.motion.json"]
    assert last["ticks"] == motion["wheels"].ticks[last["steps"]].tolist()
    with tarfile.open(shard) as archive:
        member = archive.extractfile(f"{ID}_000006.front.flow.npy.gz")
        assert member is not None
        flow = np.load(io.BytesIO(gzip.decompress(member.read())))
    assert np.array_equal(flow, seen(episode, "front", 6).flow, equal_nan=True)


def test_the_paper_layout_has_a_folder_for_each_sensor(exports: dict[str, Path], episode: Episode) -> None:
    folder = exports["paper"] / "episodes" / ID
    assert (folder / "rgb_front/000000.png").is_file()
    sensors = folder / "sensors"
    assert {path.name for path in sensors.iterdir()} == {sensor.name for sensor in RIG.sensors}
    for camera in (FRONT, EYE):
        steps = [int(path.stem) for path in sorted((sensors / camera.name / "rgb").iterdir())]
        assert steps == list(range(0, len(episode), camera.stride(CONTROL_HZ)))
        truth = seen(episode, camera.name, steps[5])
        rgb, ids = (
            cv2.imread(str(sensors / camera.name / f"{output}/{steps[5]:06d}.png"), cv2.IMREAD_UNCHANGED)
            for output in ("rgb", "ids")
        )
        assert np.array_equal(cv2.cvtColor(rgb, cv2.COLOR_BGR2RGB), truth.rgb)
        assert (ids.dtype, ids.tolist()) == (np.uint16, truth.ids.tolist())
        assert np.array_equal(np.load(sensors / camera.name / f"depth/{steps[5]:06d}.npy"), truth.depth)
    assert np.load(sensors / "front/normals/000003.npy").shape == (64, 96, 3)
    assert np.isnan(np.load(sensors / f"front/flow/{latest(FRONT, len(episode) - 1):06d}.npy")).all()
    assert np.array_equal(np.load(sensors / "scan/ranges/000005.npy"), seen(episode, "scan", 5).ranges)
    motion = episode.motion()
    assert np.array_equal(np.load(sensors / "imu/specific_force.npy"), motion["imu"].specific_force)
    assert np.array_equal(np.load(sensors / "wheels/ticks.npy"), motion["wheels"].ticks)


def test_the_intrinsics_in_rig_json_are_those_of_opencv(exports: dict[str, Path], episode: Episode) -> None:
    """OpenCV projects the lidar points into an image; the depth there must equal the distance of the points."""
    sensors = {one["name"]: one for one in json.loads((exports["paper"] / "rig.json").read_text())["sensors"]}
    points = points_of(seen(episode, "cloud", 0), CLOUD)
    base = rotation_of(sensors["cloud"]["pose"]).apply(points) + sensors["cloud"]["pose"][:3]
    assert_depth_agrees(sensors["front"], base, seen(episode, "front", 0).depth, is_radial=False)
    assert_depth_agrees(sensors["eye"], base, seen(episode, "eye", 0).depth, is_radial=True)
    assert "camera_matrix" not in sensors["around"]


@pytest.mark.parametrize(
    ("name", "rig", "said"),
    [
        ("gnm", RIG, r"format gnm does not contain sensors of a rig; formats that do: paper, lerobot, .*mcap"),
        ("vlnce", "paper", "format vlnce does not contain sensors"),
        ("mcap", "papr", "did you mean 'paper'"),
        ("lerobot", RIG.model_copy(update={"sensors": (FRONT.model_copy(update={"width": 97}),)}), "97 x 64 pixels"),
        ("lerobot", RIG.model_copy(update={"sensors": (IMU.model_copy(update={"name": "state"}),)}), "rename a sensor"),
        ("mcap", RIG.model_copy(update={"sensors": (IMU.model_copy(update={"name": "base"}),)}), "'base_link' exists"),
    ],
)
def test_a_rig_that_a_format_cannot_contain_is_refused(
    root: Path, tmp_path: Path, name: str, rig: Rig | str, said: str
) -> None:
    with pytest.raises(UsageError, match=said):
        export_rig(root, tmp_path / "out", name, rig)
    assert not (tmp_path / "out").exists()


def test_a_rate_that_does_not_divide_the_control_rate_is_refused(root: Path, tmp_path: Path) -> None:
    slow = RIG.model_copy(update={"sensors": (FRONT.model_copy(update={"rate_hz": 7.0}),)})
    with pytest.raises(InvalidRig, match="rate_hz 7 does not divide the control rate"):
        export_rig(root, tmp_path / "out", "webdataset", slow)


def test_an_export_with_another_rig_is_refused(root: Path, exports: dict[str, Path]) -> None:
    before = contents(exports["webdataset"])
    with pytest.raises(WorldError, match=r"contains another export: options .*rig=all .*, requested fps=5, rig=paper"):
        export_rig(root, exports["webdataset"], "webdataset", "paper", fps=FPS)
    assert contents(exports["webdataset"]) == before

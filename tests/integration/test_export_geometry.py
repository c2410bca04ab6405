"""Unprojects an exported depth image of every format and finds the faces of the known boxes of the room.

Each reader uses only files of the export, at the place where the users of the format look. The check needs no code of
the exporters: visible points of the crate lie on the faces of a box whose corners are written down here.
"""

from __future__ import annotations

import gzip
import io
import json
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from PIL import Image
from scipy.spatial.transform import Rotation

from factory.dataset.episode import Episode
from factory.dataset.reader import Dataset
from factory.export.execution.export_run import ExportOrder, run_export
from factory.export.registry import EXPORTERS, find_exporter
from factory.export.rig.description import intrinsics_of
from factory.export.rig.reader import shown_pinhole
from factory.export.rlds import rlds_metadata, rlds_steps
from factory.export.video import read_video
from schemas.appearance import Appearance, CameraRanges
from schemas.terms import Recording
from tests.builders.driven import make_driven
from tests.builders.tfrecord import depth_of, examples_in, image_of

pytestmark = pytest.mark.gl
BOXES = {"crate": ((2.2, 1.0, 0.0), (2.8, 1.6, 0.6)), "barrel": ((-3.0, -2.2, 0.0), (-2.5, -1.7, 0.9))}
"""Corners of the targets of the room (tests/builders/scene.py), metres."""
FLOOR = 1
"""Id of the floor, whose upper face has the height 0."""
SHIFT = ((0, 0, 0), (0, 0, 20), (0, 0, 0))
"""Change of a camera matrix by 20 pixels."""
FPS = 10
RECORDED_HZ = 30
ROW = 2
"""Exported frame that is examined."""
T = ROW * RECORDED_HZ // FPS
Array = np.ndarray[Any, Any]


class Seen(NamedTuple):
    """A depth image with its camera, as a user of a format reads them."""

    depth: Array
    """(H, W) along the optical axis, metres; 0 without a measurement."""
    matrix: Array
    """(3, 3), pixels; the centre of the first pixel is (0, 0)."""
    pose: Array
    """(7,) optical frame in the world: x, y, z, qw, qx, qy, qz."""
    ids: Array | None = None
    """(H, W) ids, if the format has them."""


def in_webdataset(out: Path) -> Seen:
    with tarfile.open(next(out.glob("*.tar"))) as archive:
        members = {
            name.partition(".")[2]: archive.extractfile(name).read()  # type: ignore[union-attr]
            for name in archive.getnames()
            if name.startswith(f"ep_000001_{T:06d}.")
        }
    camera = json.loads(members["json"])["cameras"]["front"]
    depth, ids = (np.load(io.BytesIO(gzip.decompress(members[f"{name}.npy.gz"]))) for name in ("depth", "seg"))
    return Seen(depth, np.reshape(camera["camera_matrix"], (3, 3)), np.array(camera["pose"]), ids)


def in_lerobot(out: Path) -> Seen:
    extra = out / "extra"
    row = pq.read_table(extra / "data/chunk-000/file-000.parquet").slice(ROW, 1).to_pylist()[0]
    info = json.loads((extra / "meta/info.json").read_text())["features"]["depth.front"]["info"]
    assert (info["depth_unit"], info["video.use_log"]) == ("m", True)
    codes = list(read_video(extra / "videos/depth.front/chunk-000/file-000.mp4", "gray12le"))[ROW][2]
    low, high = (np.log(info[f"video.depth_{end}"] + info["video.shift"]) for end in ("min", "max"))
    depth = np.exp(codes / 4095 * (high - low) + low) - info["video.shift"]
    ids = np.asarray(Image.open(io.BytesIO(row["ids.front"]["bytes"])))
    matrix = np.reshape(row["camera_matrix.front"], (3, 3))
    return Seen(np.where(codes == 0, 0.0, depth), matrix, np.array(row["camera_pose.front"]), ids)


def in_paper(out: Path) -> Seen:
    folder, camera = out / "episodes/ep_000001", json.loads((out / "rig.json").read_text())["sensors"][0]
    depth = np.load(folder / f"depth_front/{T:06d}.npy")
    ids = np.asarray(Image.open(folder / f"seg_front/{T:06d}.png"))
    base, optical = np.load(folder / "poses.npy")[T], json.loads((out / "rig.json").read_text())
    in_base = chained(np.array(camera["pose"]), np.array([0, 0, 0, *optical["optical_quaternion_wxyz"]]))
    return Seen(depth, np.reshape(camera["camera_matrix"], (3, 3)), chained(base, in_base), ids)


def in_navdp(out: Path) -> Seen:
    root = out / "data/minivla/box_room"
    row = pq.read_table(root / "data/chunk-000/episode_000001.parquet").slice(ROW, 1).to_pylist()[0]
    file = root / f"videos/chunk-000/observation.images.depth/ep_000001_{ROW:06d}.png"
    depth = np.asarray(Image.open(file)) / 10_000
    pose = np.array(row["action"]) @ np.diag((1, -1, -1, 1))  # from x right, y up, z backward
    return Seen(depth, np.array(row["observation.camera_intrinsic"]), as_row(pose))


def in_internnav(out: Path) -> Seen:
    (table,) = (out / "data/box_room").rglob("episode_000001.parquet")
    rows = pq.read_table(table).to_pylist()
    pose = next(name for name in rows[0] if name.startswith("pose."))
    camera = json.loads((out / "rig.json").read_text())["sensors"][0]
    depth = np.asarray(Image.open(next((out / "data/box_room").rglob("*depth*/episode_000001_0.png")))) / 1000
    return Seen(depth, np.reshape(camera["camera_matrix"], (3, 3)), as_row(np.array(rows[0][pose])))


def in_mcap(out: Path) -> Seen:
    found: dict[str, Any] = {}
    with (out / "episodes/ep_000001.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            if channel.topic == "/camera/calibration":
                found["matrix"] = np.reshape(decoded.K, (3, 3))
            elif channel.topic in ("/camera/depth", "/camera/ids") and message.log_time == round(T / RECORDED_HZ * 1e9):
                kind = "<f4" if channel.topic == "/camera/depth" else "<u2"
                found[channel.topic] = np.frombuffer(decoded.data, kind).reshape(decoded.height, decoded.width)
            elif channel.topic in ("/tf", "/tf_static"):
                for one in getattr(decoded, "transforms", [decoded]):
                    if one.child_frame_id == "front_optical" or message.log_time == round(T / RECORDED_HZ * 1e9):
                        r, at = one.rotation, one.translation
                        found[one.child_frame_id] = np.array([at.x, at.y, at.z, r.w, r.x, r.y, r.z])
    pose = chained(found["base_link"], found["front_optical"])
    return Seen(found["/camera/depth"], found["matrix"], pose, found["/camera/ids"])


def in_rlds(out: Path) -> Seen:
    for file in sorted(out.rglob("*.tfrecord-*")):
        for found in examples_in(file):
            if found["episode_metadata/episode_id"] == [b"ep_000001"]:
                depth = depth_of(found["steps/observation/depth"][ROW])
                ids = image_of(found["steps/observation/ids"][ROW])
                pose = np.reshape(found["steps/camera_pose"], (-1, 7))[ROW]
                return Seen(depth, np.reshape(found["episode_metadata/camera_matrix"], (3, 3)), pose, ids)
    raise AssertionError("ep_000001 is not in the export")


def in_robomimic(out: Path) -> Seen:
    with h5py.File(out / "dataset.hdf5") as file:
        demo = file["data/demo_1"]
        depth, ids = (demo[f"obs/{name}"][ROW, :, :, 0] for name in ("depth", "ids"))
        return Seen(depth, demo.attrs["camera_matrix"], demo["camera_pose"][ROW], ids)


READERS: dict[str, tuple[dict[str, Any], Callable[[Path], Seen], float]] = {
    "paper": ({}, in_paper, 0.001),
    "lerobot": ({"depth": True, "ids": True, "fps": FPS}, in_lerobot, 0.005),
    "webdataset": ({"fps": FPS}, in_webdataset, 0.001),
    "mcap": ({"fps": FPS}, in_mcap, 0.001),
    "navdp": ({"fps": FPS}, in_navdp, 0.001),
    "internnav": ({}, in_internnav, 0.002),
    "rlds": ({"fps": FPS, "image_px": 640}, in_rlds, 0.001),
    "robomimic": ({"fps": FPS, "image_px": 640}, in_robomimic, 0.001),
}
"""Format with depth -> options, reader, and the largest distance of a point from its face, metres."""
WITHOUT_DEPTH = {"lerobot-v2.1", "gnm", "vlnce", "coco"}
"""Formats that are examined with their images, or that have none."""


def chained(outer: Array, inner: Array) -> Array:
    """Returns the pose of `inner`, which is given in the frame of `outer`, in the frame of `outer`'s parent."""
    turn = turn_of(outer)
    return np.concatenate((outer[:3] + turn.apply(inner[:3]), (turn * turn_of(inner)).as_quat()[[3, 0, 1, 2]]))


def turn_of(pose: Array) -> Rotation:
    return Rotation.from_quat(np.asarray(pose, float)[[4, 5, 6, 3]])


def as_row(matrix: Array) -> Array:
    return np.concatenate((matrix[:3, 3], Rotation.from_matrix(matrix[:3, :3]).as_quat()[[3, 0, 1, 2]]))


def points_of(seen: Seen, mask: Array) -> Array:
    """Returns the (N, 3) points in the world of the pixels of a mask."""
    rows, columns = np.nonzero(mask & (seen.depth > 0))
    rays = np.column_stack([columns, rows, np.ones(len(rows))]) @ np.linalg.inv(seen.matrix).T
    return np.asarray(turn_of(seen.pose).apply(rays * seen.depth[rows, columns][:, None]) + seen.pose[:3])


def distance_to_faces(points: Array, category: str) -> Array:
    """Returns the (N,) distances of points from the surface of a box, metres."""
    low, high = (np.array(corner) for corner in BOXES[category])
    outside = np.linalg.norm(np.maximum(0, np.maximum(low - points, points - high)), axis=1)
    inside = np.minimum(points - low, high - points).min(axis=1)
    return np.where(outside > 0, outside, np.abs(inside))


def exported(root: Path, out: Path, name: str, values: dict[str, Any]) -> Path:
    options = find_exporter(name).options.model_validate(values)
    assert run_export(ExportOrder(root=root, out=out, format=name, options=options)).complete
    return out


@pytest.fixture(scope="module")
def root(recordings: dict[Recording, Path]) -> Path:
    return recordings[Recording.FRAMES]


@pytest.fixture(scope="module")
def episode(root: Path) -> Episode:
    return Dataset(root)["ep_000001"]


def assert_geometry(seen: Seen, episode: Episode, t: int, tolerance_m: float) -> None:
    meta = episode.meta
    ids = episode.ids(t) if seen.ids is None else seen.ids
    mask = np.asarray(ids == meta.target_instance_id)
    assert mask.sum() > 300
    distances = distance_to_faces(points_of(seen, mask), meta.job.category)
    assert np.quantile(distances, 0.99) < tolerance_m
    floor = np.asarray(ids == FLOOR)
    assert np.quantile(np.abs(points_of(seen, floor)[:, 2]), 0.99) < tolerance_m
    for wrong in (seen.matrix @ np.diag((1.1, 1.1, 1)), seen.matrix + np.array(SHIFT)):
        heights = points_of(seen._replace(matrix=wrong), floor)[:, 2]
        assert np.quantile(np.abs(heights), 0.99) > tolerance_m


def test_every_format_is_examined() -> None:
    assert READERS.keys() | WITHOUT_DEPTH == EXPORTERS.keys()


@pytest.mark.parametrize("name", READERS)
def test_exported_depth_leads_to_the_faces_of_the_target(
    root: Path, episode: Episode, tmp_path: Path, name: str
) -> None:
    values, read, tolerance_m = READERS[name]
    seen = read(exported(root, tmp_path / "out", name, values))
    assert_geometry(seen, episode, 0 if name == "internnav" else T, tolerance_m)


@pytest.fixture(scope="module")
def shifted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One drive whose camera is moved, turned and zoomed by the appearance of its plan."""
    camera = CameraRanges(
        x_m=(0.04, 0.05), z_m=(0.08, 0.1), roll_deg=(3, 4), pitch_deg=(4, 5), yaw_deg=(-4, -3), focal=(1.1, 1.15)
    )
    root = tmp_path_factory.mktemp("shifted") / "data"
    make_driven(root, Recording.STATES, episodes=1, appearance=Appearance(camera=camera))
    return root


@pytest.mark.parametrize("name", sorted(READERS.keys() - {"paper"}))
def test_an_appearance_that_moves_the_camera_moves_the_exported_camera(
    shifted: Path, tmp_path: Path, name: str
) -> None:
    """`paper` is not examined: its only description of the camera is that of the plan."""
    values, read, tolerance_m = READERS[name]
    episode = Dataset(shifted)[0]
    seen = read(exported(shifted, tmp_path / "out", name, values))
    if name == "internnav":  # its loader takes one camera for all episodes, so each episode only has its own poses
        seen = seen._replace(matrix=np.reshape(intrinsics_of(shown_pinhole(episode)).matrix, (3, 3)))  # type: ignore[union-attr]
    assert_geometry(seen, episode, 0 if name == "internnav" else T, tolerance_m)


@pytest.mark.parametrize(("side", "tolerance_m"), [(640, 0.001), (256, 0.02)])
def test_rlds_depth_leads_to_the_faces_of_the_target(episode: Episode, side: int, tolerance_m: float) -> None:
    about = rlds_metadata(episode, side)
    step = list(rlds_steps(episode, FPS, side))[ROW]
    chosen = ((np.arange(side) + 0.5) * 640 / side).astype(int)
    seen = Seen(
        step["observation"]["depth"][:, :, 0],
        np.array(about["camera_matrix"]),
        step["camera_pose"],
        episode.ids(T)[chosen[:, None], chosen],
    )
    assert_geometry(seen, episode, T, tolerance_m)
    in_base = chained(episode.poses[T], np.array(about["camera_in_base"]))
    assert in_base == pytest.approx(step["camera_pose"], abs=1e-5) or in_base == pytest.approx(
        step["camera_pose"] * np.array((1, 1, 1, -1, -1, -1, -1)), abs=1e-5
    )


def projected(matrix: Array, pose: Array, point: Array) -> tuple[int, int]:
    """Returns row and column of the pixel that shows a point of the world."""
    x, y, z = matrix @ turn_of(pose).inv().apply(point - pose[:3])
    return round(y / z), round(x / z)


def centre_of_top(category: str) -> Array:
    (x0, y0, _), (x1, y1, z1) = BOXES[category]
    return np.array([(x0 + x1) / 2, (y0 + y1) / 2, z1 - 0.02])


def test_formats_without_depth_have_the_camera_of_their_images(root: Path, episode: Episode, tmp_path: Path) -> None:
    """The centre of the target, projected with the exported camera, is a pixel of the target."""
    target = episode.meta.target_instance_id
    out = exported(root, tmp_path / "v21", "lerobot-v2.1", {"fps": FPS})
    row = pq.read_table(out / "data/chunk-000/episode_000000.parquet").slice(ROW, 1).to_pylist()[0]
    pose, matrix = np.array(row["camera_pose.front"]), np.reshape(row["camera_matrix.front"], (3, 3))
    point = centre_of_top(episode.meta.job.category)
    assert episode.ids(T)[projected(matrix, pose, point)] == target
    config = yaml.safe_load((exported(root, tmp_path / "gnm", "gnm", {}) / "data_config.yaml").read_text())
    camera = config["minivla_nav"]["camera_metrics"]
    assert camera["camera_matrix"] == pytest.approx(
        {"fx": matrix[0, 0], "fy": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2]}
    )
    assert camera["camera_height"] == pytest.approx(pose[2] - episode.poses[T, 2], abs=1e-5)

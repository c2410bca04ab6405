"""Formats `navdp` and `internnav`: training data in the layouts that the loaders of InternNav read.

`navdp` is read by `NavDP_Base_Datset` (internnav/dataset/navdp_lerobot_dataset.py), `internnav` by InternVLA-N1
(`NavPixelGoalDataset` in internnav/dataset/internvla_n1_lerobot_dataset.py) of InternRobotics/InternNav. Files, keys,
units and axes are those of the loaders at commit 7a5c624 (March 2026).
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage
from scipy.spatial.transform import Rotation

from factory.dataset.episode import Episode
from factory.export.base import EpisodeFacts, Exporter, ExportPiece, Finish
from factory.export.card import CARD_FILE, export_card
from factory.export.gnm import encode_jpeg
from factory.export.options import InternNavOptions, NavDpOptions, stride_of
from factory.export.origin import COLUMN, origin_of
from factory.export.output import Output
from factory.export.questions import ask_questions, questions_text
from factory.export.rig.description import intrinsics_of
from factory.export.rig.reader import shown_pinhole
from factory.export.vlnce.actions import FORWARD, LEFT, RIGHT, STEP_M, TURN_RAD
from factory.runs.scene_packages import find_package
from schemas.config import CameraConfig
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.rig import PinholeCamera
from schemas.scene import CompiledScene, read_scene
from schemas.support.geometry import yaw_of
from schemas.support.numpy_types import Floats
from workers.geometry.camera import mount_rotation
from workers.geometry.grid import FREE, OCCUPIED

GROUP = "minivla"
_CHUNK_SIZE = 1000
_ROOT = "data"
_NAVDP_UNITS, _INTERNNAV_UNITS = 10_000, 1_000
"""Units of depth images per metre."""
_LARGEST_DEPTH = 65_535
_OBSTACLE, _FLOOR = (0, 0, 128), (128, 128, 128)
"""Colours of points; NavDP's loader takes points of about (0, 0, 0.5) as obstacles."""
_START = -1
"""Action of the first keyframe, to which none has led."""
_MOST_AHEAD = 24
"""Largest number of keyframes between an image and its pixel goal."""
_LEAST_GOAL_M = 0.5
_DEPTH_MARGIN_M = 0.1
"""A goal that is at most this far behind the surface in its pixel counts as visible, metres."""
_NO_GOAL = -1

_ROBOT_OF_BASE = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Columns: right, forward and up in base_link (x forward, y left, z up); the axes of NavDP's robot frame."""
_USD_OF_ROBOT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Columns: x right, y up and z backward of a level camera, in NavDP's robot frame."""
_OPTICAL_OF_BASE = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Columns: x right, y down and z forward of the optical frame (REP 103), in base_link."""

_NAVDP_CARD = """
Training data for NavDP. Pass `{root}` as `root_dirs` of `NavDP_Base_Datset` of InternRobotics/InternNav.

- `{root}/{group}/<scene>/data/chunk-000/episode_*.parquet`: per frame `action` (4, 4), the pose of the camera in the
  world (x right, y up, z backward; world z up, metres); `observation.camera_intrinsic` (3, 3), pixels;
  `observation.camera_extrinsic` (4, 4), the camera in the frame of the robot (x right, y forward, z up).
- `videos/chunk-000/observation.images.rgb/*.jpg`, `observation.images.depth/*.png`: 16 bit, 1/10000 m, at most 6.55 m;
  0 where nothing was measured. `meta/episodes_stats.jsonl` has the first and last image of each episode.
- `meta/pointcloud.ply`: cells of the occupancy grid in the height band of the robot; edges of obstacles are
  (0, 0, 0.5), the floor is grey.
- `meta/episodes.jsonl`: instruction, split and origin of each episode. The loader reads all splits: export one with
  `--split train_id`.

This export has {fps} frames per second. The loader predicts 24 waypoints, 4 frames apart.
"""
_INTERNNAV_CARD = """
Training data for InternVLA-N1 of InternRobotics/InternNav. Enter in `internvla_n1_lerobot_dataset.py`:

    MINIVLA = {{"data_path": "<here>/{root}", "height": {height}, "pitch_1": 0, "pitch_2": 0}}
    data_dict["minivla"] = MINIVLA

- Frames are keyframes: the recorded {hz} Hz drive is cut where the robot has moved {step} m or turned 15 degrees, the
  actions of VLN-CE. `action`: the action that led to the frame, 1 forward, 2 left, 3 right, -1 at the first.
- `pose.{setting}` (4, 4): the camera in the world, optical axes (x right, y down, z forward), metres.
- `goal.{setting}`: row and column of the farthest later keyframe on the floor that is visible, within {ahead}
  keyframes; `relative_goal_frame_id.{setting}`: its distance in keyframes; both -1 if none is visible.
- `videos/chunk-*/observation.images.rgb.{setting}/episode_*_<frame>.jpg`, and `...depth.{setting}/*.png`: 16 bit,
  millimetres; 0 where nothing was measured.
- `meta/episodes.jsonl`: instruction (`tasks`), length, split and origin. The loader reads all splits: export one with
  `--split train_id`. It skips episodes with fewer than 4 keyframes.

The camera is level: the loader uses one image for both pitches. A model that was trained with a camera that looks down
by 30 degrees needs other data.
"""


class ExportedFacts(EpisodeFacts):
    """Facts of a piece for the tables of its scene."""

    scene: str
    scene_sha256: str


class NavDpExporter(Exporter[NavDpOptions, ExportedFacts]):
    """Exporter of format `navdp`: one folder per scene with camera poses, images and the obstacles as points."""

    name = "navdp"
    about = "camera poses, JPEG, 16-bit depth and obstacle points, for NavDP"
    version = 3
    asks = True
    options = NavDpOptions
    facts = ExportedFacts

    def write_episode(self, episode: Episode, options: NavDpOptions, folder: Path) -> ExportedFacts:
        """Writes the table and the images of one episode."""
        job = episode.meta.job
        place = folder / _ROOT / GROUP / job.scene
        steps = range(0, len(episode), stride_of(options.fps, job.task.control_hz))
        videos = place / "videos/chunk-000"
        rgb, depth = (videos / f"observation.images.{name}" for name in ("rgb", "depth"))
        for each in (rgb, depth):
            each.mkdir(parents=True)
        for number, t in enumerate(steps):
            stem = f"{episode.episode_id}_{number:06d}"
            (rgb / f"{stem}.jpg").write_bytes(encode_jpeg(episode.rgb(t), options.jpeg_quality))
            (depth / f"{stem}.png").write_bytes(encode_depth(episode.depth(t), _NAVDP_UNITS))
        camera = shown_pinhole(episode)
        extrinsic = np.eye(4)
        extrinsic[:3, :3] = _ROBOT_OF_BASE.T @ mount_rotation(camera.mount) @ _ROBOT_OF_BASE @ _USD_OF_ROBOT
        extrinsic[:3, 3] = (-camera.mount.y_m, camera.mount.x_m, camera.mount.z_m)
        poses = camera_poses(episode.poses[:: steps.step], camera, _ROBOT_OF_BASE @ _USD_OF_ROBOT)
        columns = {
            "observation.camera_intrinsic": [intrinsic_of(camera).tolist()] * len(steps),
            "observation.camera_extrinsic": [extrinsic.tolist()] * len(steps),
            "action": poses.tolist(),
        }
        _write_table(place / "data/chunk-000", episode, columns, [t / job.task.control_hz for t in steps])
        pictures = f"{rgb.relative_to(folder)}/{episode.episode_id}"
        questions = ask_questions(episode, steps, lambda n, _: f"{pictures}_{n:06d}.jpg")
        return ExportedFacts(frames=len(steps), scene=job.scene, scene_sha256=job.scene_sha256, questions=questions)

    def finish(self, export: Finish[NavDpOptions, ExportedFacts]) -> None:
        """Writes the tables and the points of each scene, and the card."""
        for scene, pieces in _by_scene(export.pieces):
            meta = f"{_ROOT}/{GROUP}/{scene}/meta"
            export.out.write_text(f"{meta}/episodes.jsonl", _lines(_entry(piece) for piece in pieces))
            export.out.write_text(f"{meta}/episodes_stats.jsonl", _lines(_image_ranges(pieces)))
            _write_points(export.out, f"{meta}/pointcloud.ply", pieces[0])
        fps = export.options.fps or export.dataset.meta.plan.task.control_hz
        text = _NAVDP_CARD.format(root=_ROOT, group=GROUP, fps=fps)
        asked = questions_text(export.questions, self.asks)
        card = export_card(export.dataset.meta, None, len(export.pieces), text, tags=("navdp",), questions=asked)
        export.out.write_text(CARD_FILE, card)


class InternNavExporter(Exporter[InternNavOptions, ExportedFacts]):
    """Exporter of format `internnav`: keyframes with the discrete actions of VLN-CE and pixel goals."""

    name = "internnav"
    about = "keyframes with discrete actions and pixel goals, for InternVLA-N1 of InternNav"
    version = 3
    asks = True
    options = InternNavOptions
    facts = ExportedFacts

    def write_episode(self, episode: Episode, options: InternNavOptions, folder: Path) -> ExportedFacts:
        """Writes the table and the keyframes of one episode."""
        job, number = episode.meta.job, _number(episode.episode_id)
        frames, actions = keyframes(episode.poses)
        place, chunk = folder / _ROOT / job.scene, f"chunk-{number // _CHUNK_SIZE:03d}"
        setting, videos = setting_of(job.camera), place / "videos" / chunk
        rgb, depth = (videos / f"observation.images.{name}.{setting}" for name in ("rgb", "depth"))
        for each in (rgb, depth):
            each.mkdir(parents=True)
        poses = episode.poses[frames]
        camera = shown_pinhole(episode)
        cameras = camera_poses(poses, camera, _OPTICAL_OF_BASE)
        goals = []
        for k, t in enumerate(frames):
            stem, measured = f"episode_{number:06d}_{k}", episode.depth(t)
            (rgb / f"{stem}.jpg").write_bytes(encode_jpeg(episode.rgb(t), options.jpeg_quality))
            (depth / f"{stem}.png").write_bytes(encode_depth(measured, _INTERNNAV_UNITS))
            goals.append(pixel_goal(cameras[k], measured, camera, poses[k : k + _MOST_AHEAD + 1, :3]))
        columns = {
            "action": actions,
            f"pose.{setting}": cameras.tolist(),
            f"goal.{setting}": [[goal.row, goal.column] for goal in goals],
            f"relative_goal_frame_id.{setting}": [goal.ahead for goal in goals],
        }
        _write_table(place / "data" / chunk, episode, columns, [t / job.task.control_hz for t in frames])
        pictures = f"{rgb.relative_to(folder)}/episode_{number:06d}"
        questions = ask_questions(episode, frames, lambda k, _: f"{pictures}_{k}.jpg")
        return ExportedFacts(frames=len(frames), scene=job.scene, scene_sha256=job.scene_sha256, questions=questions)

    def finish(self, export: Finish[InternNavOptions, ExportedFacts]) -> None:
        """Writes the episodes of each scene, and the card."""
        for scene, pieces in _by_scene(export.pieces):
            export.out.write_text(f"{_ROOT}/{scene}/meta/episodes.jsonl", _lines(_entry(piece) for piece in pieces))
        camera = export.dataset.meta.plan.camera
        text = _INTERNNAV_CARD.format(
            root=_ROOT,
            height=_height_cm(camera),
            step=STEP_M,
            setting=setting_of(camera),
            ahead=_MOST_AHEAD,
            hz=export.dataset.meta.plan.task.control_hz,
        )
        asked = questions_text(export.questions, self.asks)
        card = export_card(export.dataset.meta, None, len(export.pieces), text, tags=("internnav",), questions=asked)
        export.out.write_text(CARD_FILE, card)


def setting_of(camera: CameraConfig) -> str:
    """Returns the part of the names of columns and folders that states the height and pitch of the camera."""
    return f"{_height_cm(camera)}cm_0deg"


def _height_cm(camera: CameraConfig) -> int:
    return round(camera.z_m * 100)


def intrinsic_of(camera: PinholeCamera) -> Floats:
    """Returns the (3, 3) camera matrix, pixels; centres of pixels have integer coordinates."""
    intrinsics = intrinsics_of(camera)
    assert intrinsics is not None, "a pinhole camera has intrinsics"
    return np.reshape(np.array(intrinsics.matrix), (3, 3))


def camera_poses(poses: Floats, camera: PinholeCamera, axes: Floats) -> Floats:
    """Returns the (T, 4, 4) poses of the camera in the world, metres.

    Args:
        poses: (T, 7) poses of base_link: x, y, z metres, and a quaternion w, x, y, z.
        camera: camera on base_link.
        axes: (3, 3) the axes of the wanted frame in the frame of the camera (x forward, y left, z up), as columns.
    """
    turns = Rotation.from_quat(poses[:, [4, 5, 6, 3]]).as_matrix()
    result = np.tile(np.eye(4), (len(poses), 1, 1))
    mount = camera.mount
    result[:, :3, :3] = turns @ mount_rotation(mount) @ axes
    result[:, :3, 3] = poses[:, :3] + turns @ np.array((mount.x_m, mount.y_m, mount.z_m))
    return result


def keyframes(poses: Floats) -> tuple[list[int], list[int]]:
    """Returns the frames at which an action of VLN-CE is completed, and the action that led to each.

    An action ends where the robot has moved `STEP_M` from the last keyframe (forward), or turned `TURN_RAD` (left or
    right). The last frame of the episode is always a keyframe.

    Args:
        poses: (T, 7) poses of base_link.
    """
    yaw = np.unwrap(yaw_of(poses))
    frames, actions = [0], [_START]
    for t in range(1, len(poses)):
        moved, turned = float(np.hypot(*(poses[t, :2] - poses[frames[-1], :2]))), float(yaw[t] - yaw[frames[-1]])
        if abs(turned) >= TURN_RAD:
            action = LEFT if turned > 0 else RIGHT
        elif moved >= STEP_M or t == len(poses) - 1:
            action = FORWARD
        else:
            continue
        frames.append(t)
        actions.append(action)
    return frames, actions


class PixelGoal(NamedTuple):
    """Pixel of a later position on the floor; all values are -1 if none is visible."""

    row: int
    column: int
    ahead: int
    """Number of keyframes until the robot is there."""


def pixel_goal(camera_pose: Floats, depth: NDArray[np.float32], camera: PinholeCamera, positions: Floats) -> PixelGoal:
    """Returns the farthest position ahead that is in the image and not hidden, at least `_LEAST_GOAL_M` away.

    Args:
        camera_pose: (4, 4) pose of the camera in the world, optical axes.
        depth: (640, 640) depth along the optical axis, metres; 0 where nothing was measured.
        camera: camera.
        positions: (N, 3) positions of base_link from now on, metres.
    """
    local = (positions - camera_pose[:3, 3]) @ camera_pose[:3, :3]
    for ahead in range(len(positions) - 1, 0, -1):
        x, y, z = local[ahead]
        if z <= 0.0 or np.hypot(*(positions[ahead, :2] - positions[0, :2])) < _LEAST_GOAL_M:
            continue
        column, row, _ = np.rint(intrinsic_of(camera) @ np.array((x / z, y / z, 1.0))).astype(int).tolist()
        if not (0 <= row < FRAME_SIZE_PX and 0 <= column < FRAME_SIZE_PX):
            continue
        surface = float(depth[row, column])
        if surface == 0.0 or z <= surface + _DEPTH_MARGIN_M:
            return PixelGoal(row, column, ahead)
    return PixelGoal(_NO_GOAL, _NO_GOAL, _NO_GOAL)


def encode_depth(depth: NDArray[np.float32], units: int) -> bytes:
    """Returns a 16-bit PNG of depth in metres, with `units` per metre; larger values become the largest."""
    values = np.clip(np.rint(depth.astype(np.float64) * units), 0, _LARGEST_DEPTH).astype(np.uint16)
    buffer = io.BytesIO()
    Image.fromarray(values).save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


def obstacle_points(scene: CompiledScene) -> tuple[Floats, NDArray[np.uint8]]:
    """Returns points of the occupancy grid in the world, (N, 3) metres, and their colours (N, 3).

    Occupied cells at the edge of the free floor are obstacles; distances from the floor to them equal those to all
    occupied cells.
    """
    free = scene.occupancy == FREE
    edge = ~free & ndimage.binary_dilation(free, np.ones((3, 3), bool)) & (scene.occupancy >= OCCUPIED)
    parts, colours = [], []
    for mask, colour in ((edge, _OBSTACLE), (free, _FLOOR)):
        cells = np.argwhere(mask)
        centres = np.array(scene.info.grid_origin_m) + (cells[:, ::-1] + 0.5) * scene.info.grid_resolution_m
        parts.append(np.column_stack([centres, np.full(len(cells), scene.info.floor_height_m)]))
        colours.append(np.tile(np.array(colour, np.uint8), (len(cells), 1)))
    return np.concatenate(parts), np.concatenate(colours)


def _write_points(out: Output, name: str, piece: ExportPiece[ExportedFacts]) -> None:
    if out.has(name):
        return
    facts = piece.facts
    points, colours = obstacle_points(
        read_scene(find_package(piece.dataset.root, facts.scene, facts.scene_sha256).path)
    )
    rows = np.zeros(len(points), [("xyz", "<f4", 3), ("rgb", "u1", 3)])
    rows["xyz"], rows["rgb"] = points, colours
    fields = [*(f"float {axis}" for axis in "xyz"), *(f"uchar {colour}" for colour in ("red", "green", "blue"))]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    header += [*(f"property {field}" for field in fields), "end_header", ""]
    with out.replacing(name) as part:
        part.write_bytes("\n".join(header).encode() + rows.tobytes())


def _write_table(folder: Path, episode: Episode, columns: dict[str, Any], times: Sequence[float]) -> None:
    """Writes the table of an episode; `columns` are values by frame."""
    number, count = _number(episode.episode_id), len(times)
    table = pa.table(
        {
            **columns,
            "timestamp": pa.array(times, pa.float32()),
            "frame_index": list(range(count)),
            "episode_index": [number] * count,
        }
    )
    folder.mkdir(parents=True)
    pq.write_table(table, folder / f"episode_{number:06d}.parquet")


def _number(episode_id: str) -> int:
    return int(episode_id.removeprefix("ep_"))


def _by_scene(
    pieces: Sequence[ExportPiece[ExportedFacts]],
) -> Iterator[tuple[str, list[ExportPiece[ExportedFacts]]]]:
    """Yields the pieces of each scene, in the order of their numbers, as the loaders list files."""
    groups: dict[str, list[ExportPiece[ExportedFacts]]] = {}
    for piece in pieces:
        groups.setdefault(piece.facts.scene, []).append(piece)
    for scene, group in sorted(groups.items()):
        yield scene, sorted(group, key=lambda piece: piece.episode_id)


def _entry(piece: ExportPiece[ExportedFacts]) -> dict[str, Any]:
    """Returns the line of an episode in `episodes.jsonl`."""
    return {
        "episode_index": _number(piece.episode_id),
        "tasks": [piece.episode.instruction],
        "length": piece.facts.frames,
        "split": piece.split,
        COLUMN: origin_of(piece.episode).model_dump(mode="json"),
    }


def _image_ranges(pieces: Sequence[ExportPiece[ExportedFacts]]) -> Iterator[dict[str, Any]]:
    """Yields the first and last image of each episode among the sorted images of a scene."""
    first = 0
    for piece in pieces:
        last = first + piece.facts.frames - 1
        yield {"episode_index": _number(piece.episode_id), "image_index": {"min": first, "max": last}}
        first = last + 1


def _lines(entries: Iterator[dict[str, Any]]) -> str:
    return "".join(json.dumps(entry) + "\n" for entry in entries)

"""Shows an episode in the Rerun viewer: frames, robot on the map, driven and planned track, actions, instruction.

`rerun` is imported here only. Logs recorded data only; writes a recording or opens the viewer.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from factory.dataset.episode import Episode
from factory.visualize.panels import DEPTH_SHOWN_M, describe_error, show_ids
from schemas.config import CameraConfig
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.errors import WorldError
from schemas.measure import Goal
from schemas.scene import CompiledScene
from schemas.storage.disk import replacing
from schemas.support.extras import missing_package

_ROBOT_BOX_M = (
    (-0.607, -0.25, 0.06),
    (0.14, 0.25, 0.556),
)  # corners of the body relative to base_link, as in workers/physics/robot.py
_CAMERA_PATH = "world/robot/camera"
_LINES = {"action/v_mps": (30, 110, 220), "action/w_rps": (240, 160, 30), "distance/planar_m": (255, 40, 40)}
_FREE, _OCCUPIED, _HIDING = (236, 239, 243), (150, 158, 170), (84, 92, 106)
FrameCallback = Callable[[int], None]


class FloorPicture(NamedTuple):
    """Occupancy grid as a textured rectangle on the floor, in the world frame."""

    corners_m: NDArray[np.float32]
    """(4, 3): lower left, lower right, upper right, upper left, metres."""
    uvs: NDArray[np.float32]
    """(4, 2) texture coordinates; v = 0 is the first row of the texture."""
    texture: NDArray[np.uint8]
    """(H, W, 3) sRGB; row 0 is the smallest y."""


def view_episode(
    episode: Episode, scene: CompiledScene, save: Path | None, stride: int = 1, tell: FrameCallback | None = None
) -> None:
    """Logs an episode to the Rerun viewer or to a recording.

    Args:
        episode: Episode to show.
        scene: Scene in which the episode was recorded.
        save: Path of the `.rrd` file to write; `None` opens the viewer.
        stride: Log every n-th frame; poses and actions are logged at every step.
        tell: Progress callback, called with the index of every logged frame.

    Raises:
        UsageError: rerun-sdk is not installed.
        WorldError: The recording cannot be written.
    """
    rerun = _library()
    with nullcontext() if save is None else replacing(save) as part:
        _record(rerun, episode, scene, part, stride, tell)


def _record(
    rerun: ModuleType,
    episode: Episode,
    scene: CompiledScene,
    save: Path | None,
    stride: int,
    tell: FrameCallback | None,
) -> None:
    """Logs an episode; the recording is complete when this function returns."""
    with rerun.RecordingStream("minivla_factory", recording_id=f"{episode.meta.job.run}_{episode.episode_id}") as log:
        _open(rerun, log, save)
        log.send_blueprint(_layout(rerun))
        _log_static(rerun, log, episode, scene)
        for t in range(len(episode)):
            _set_time(log, t, episode.meta.job.task.control_hz)
            _log_motion(rerun, log, episode, t)
            if t % stride == 0:
                _log_frame(rerun, log, episode, t)
                if tell is not None:
                    tell(t)
        if save is not None:
            log.disconnect()


def floor_picture(scene: CompiledScene) -> FloorPicture:
    """Returns the occupancy grid of a scene as a textured rectangle on its floor."""
    info = scene.info
    rows, columns = scene.occupancy.shape
    left, bottom = info.grid_origin_m
    right, top = left + columns * info.grid_resolution_m, bottom + rows * info.grid_resolution_m
    z = info.floor_height_m
    corners = np.array([(left, bottom, z), (right, bottom, z), (right, top, z), (left, top, z)], np.float32)
    uvs = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32)
    palette = np.array([_FREE, _OCCUPIED, _HIDING], np.uint8)
    return FloorPicture(corners, uvs, palette[scene.occupancy])


def _library() -> ModuleType:
    try:
        import rerun
    except ImportError as error:
        raise missing_package("rerun", "`factory view`") from error
    module: ModuleType = rerun
    return module


def _open(rerun: ModuleType, log: Any, save: Path | None) -> None:
    try:
        if save is None:
            log.spawn()
        else:
            save.parent.mkdir(parents=True, exist_ok=True)
            log.save(save)
    except (OSError, RuntimeError) as error:
        raise WorldError(f"rerun {rerun.__version__} cannot open {save or 'its viewer'}: {error}") from error


def _layout(rerun: ModuleType) -> Any:
    views = rerun.blueprint
    images = views.Horizontal(
        views.Spatial2DView(origin=f"{_CAMERA_PATH}/rgb", name="rgb"),
        views.Spatial2DView(origin=f"{_CAMERA_PATH}/depth", name="depth"),
        views.Spatial2DView(origin=f"{_CAMERA_PATH}/ids", name="ids"),
    )
    facts = views.Horizontal(
        views.TextDocumentView(origin="instruction", name="instruction"),
        views.TimeSeriesView(origin="action", name="action"),
        views.TimeSeriesView(origin="distance", name="distance"),
    )
    place = views.Spatial3DView(origin="world", name="world")
    layout = views.Horizontal(place, views.Vertical(images, facts), column_shares=[2, 3])
    return views.Blueprint(layout, collapse_panels=True)


def _set_time(log: Any, t: int, hz: int) -> None:
    log.set_time("step", sequence=t)
    log.set_time("time", duration=t / hz)


def _log_static(rerun: ModuleType, log: Any, episode: Episode, scene: CompiledScene) -> None:
    meta, job = episode.meta, episode.meta.job
    log.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    floor = floor_picture(scene)
    log.log(
        "world/map",
        rerun.Mesh3D(
            vertex_positions=floor.corners_m,
            triangle_indices=[(0, 1, 2), (0, 2, 3)],
            vertex_texcoords=floor.uvs,
            albedo_texture=floor.texture,
        ),
        static=True,
    )
    lift = np.array((0.0, 0.0, 0.02), np.float32)
    log.log("world/driven", rerun.LineStrips3D([episode.poses[:, :3] + lift], colors=[(30, 110, 220)]), static=True)
    if meta.route.planned:
        way = [(x, y, scene.info.floor_height_m + 0.01) for x, y, _ in meta.route.planned]
        log.log("world/planned", rerun.LineStrips3D([way], colors=[(240, 160, 30)]), static=True)
    target = scene.info.target(job.target_id)
    half = [side / 2 for side in target.size_m]
    log.log(
        "world/target",
        rerun.Boxes3D(centers=[target.centroid_m], half_sizes=[half], labels=[job.target_id], colors=[(255, 40, 40)]),
        static=True,
    )
    for name, colour in _LINES.items():
        log.log(name, rerun.SeriesLines(colors=[colour], widths=[2.0]), static=True)
    log.log("instruction", rerun.TextDocument(_describe_episode(episode), media_type="text/markdown"), static=True)
    _log_robot(rerun, log, job.camera)
    instances = episode.instances
    ids = np.array([0, *(instance.id for instance in instances)], np.uint16)
    names = ["nothing", *(_name_of(instance.prim_path, instance.category) for instance in instances)]
    labels = [
        (int(number), name, tuple(map(int, colour)))
        for number, name, colour in zip(ids, names, show_ids(ids, meta.target_instance_id), strict=True)
    ]
    log.log(f"{_CAMERA_PATH}/ids", rerun.AnnotationContext(labels), static=True)


def _log_robot(rerun: ModuleType, log: Any, camera: CameraConfig) -> None:
    low, high = np.array(_ROBOT_BOX_M)
    body = rerun.Boxes3D(centers=[(low + high) / 2], half_sizes=[(high - low) / 2], colors=[(70, 200, 120)])
    log.log("world/robot/body", body, static=True)
    forward_to_optical = rerun.Quaternion(xyzw=(-0.5, 0.5, -0.5, 0.5))  # z forward, x right, y down
    log.log(
        _CAMERA_PATH,
        rerun.Transform3D(translation=(camera.x_m, camera.y_m, camera.z_m), quaternion=forward_to_optical),
        static=True,
    )
    focal = FRAME_SIZE_PX / 2 / math.tan(math.radians(camera.fov_deg) / 2)
    pinhole = rerun.Pinhole(focal_length=focal, width=FRAME_SIZE_PX, height=FRAME_SIZE_PX, image_plane_distance=0.6)
    for kind in ("rgb", "depth", "ids"):
        log.log(f"{_CAMERA_PATH}/{kind}", pinhole, static=True)


def _log_motion(rerun: ModuleType, log: Any, episode: Episode, t: int) -> None:
    x, y, z, qw, qx, qy, qz = (float(value) for value in episode.poses[t])
    log.log(
        "world/robot",
        rerun.Transform3D(translation=(x, y, z), quaternion=rerun.Quaternion(xyzw=(qx, qy, qz, qw))),
    )
    v, w = (float(value) for value in episode.actions[t])
    log.log("action/v_mps", rerun.Scalars(v))
    log.log("action/w_rps", rerun.Scalars(w))
    log.log("distance/planar_m", rerun.Scalars(Goal.of_episode(episode.meta).distance(x, y)))


def _log_frame(rerun: ModuleType, log: Any, episode: Episode, t: int) -> None:
    frame = episode.frame(t)
    log.log(f"{_CAMERA_PATH}/rgb", rerun.Image(frame.rgb).compress(jpeg_quality=90))
    shown = rerun.DepthImage(frame.depth, meter=1.0, depth_range=(0.0, DEPTH_SHOWN_M))
    log.log(f"{_CAMERA_PATH}/depth", shown)
    log.log(f"{_CAMERA_PATH}/ids", rerun.SegmentationImage(frame.ids))


def _name_of(prim_path: str, category: str | None) -> str:
    leaf = prim_path.rpartition("/")[2]
    return f"{category} {leaf}" if category else leaf


def _describe_episode(episode: Episode) -> str:
    meta, job, rollout = episode.meta, episode.meta.job, episode.meta.rollout
    return (
        f"# {episode.instruction}\n\n{episode.episode_id}, {job.scene}, {job.split}, {job.tier}, target "
        f"{job.target_id} "
        f"({job.colour}), template {meta.template_id}, expert {job.expert}\n\n{rollout.num_steps} steps, start "
        f"{rollout.spawn_dist_m:.2f} m, TL {rollout.trajectory_length_m:.2f} m, {describe_error(rollout)}"
    )

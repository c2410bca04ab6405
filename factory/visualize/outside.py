"""Films of an episode from outside: the robot in its scene, beside its camera image and the instruction.

The scene and the robot are rendered by the same camera, each alone, and the nearer surface is shown. The robot is drawn
from the dimensions of the Nova Carter (docs/design/robot.md); the drive does not use this drawing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from factory.dataset.bundle import EpisodeBundle
from schemas.config import CameraConfig, RobotConfig
from schemas.measure import Goal
from schemas.rig import Mount, PinholeCamera
from schemas.scene import CompiledScene, SceneInfo
from schemas.support.numpy_types import Floats
from workers.geometry.camera import mounted_pose
from workers.geometry.pose import Pose
from workers.render import Renderer

_OUTSIDE_PX, _CAMERA_PX = (480, 320), 320
"""Size of the view from outside (width, height) and side of the camera image, pixels."""
_CAPTION_PX = 40
_SAMPLES = 2
"""Samples per pixel along each axis."""
_FOV_DEG = 70.0
_BEHIND_M, _ABOVE_M, _DOWN_DEG = 2.3, 1.65, 22.0
"""Place of the outside camera behind and above the robot, and its pitch."""
_ASIDE_RAD = 0.45
"""Angle by which the outside camera looks past the robot's rear, so its side is visible, radians."""
_NEAREST_M = 0.9
"""Distance behind the robot below which a wall may hide it."""
_SMOOTHING_S = 0.7
"""Time over which the heading of the outside camera is averaged, so it does not shake."""
_SHADOW_M = 0.12
"""Width of the soft edge of the robot's shadow on the floor."""
_SUN = np.array((0.35, 0.25, 0.9)) / math.sqrt(0.35**2 + 0.25**2 + 0.9**2)
_BLACK, _DARK, _GREY, _LIGHT, _ACCENT = (30, 31, 33), (58, 60, 64), (120, 123, 127), (205, 207, 208), (112, 176, 40)
_REAR_M, _FRONT_M, _HALF_WIDTH_M, _TOP_M = -0.607, 0.14, 0.25, 0.556
"""Extent of the body around base_link, as in workers/physics/robot.py."""
_LINE = (255, 60, 60)
"""Colour of the line around the target."""
Rgb = NDArray[np.uint8]
Colour = tuple[int, int, int]


class Solid(NamedTuple):
    """Triangles of one colour."""

    corners: Floats
    """(N, 3, 3) corners, metres in base_link, counter-clockwise seen from outside."""
    colour: Colour
    """sRGB."""


def box(low: tuple[float, float, float], high: tuple[float, float, float], colour: Colour) -> Solid:
    """Returns an axis-aligned box."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    a, b, c, d = (x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0)
    e, f, g, h = (x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1)
    sides = ((a, d, c, b), (e, f, g, h), (a, b, f, e), (c, d, h, g), (b, c, g, f), (d, a, e, h))
    return Solid(np.array([t for p, q, r, s in sides for t in ((p, q, r), (p, r, s))]), colour)


def cylinder(
    centre: tuple[float, float, float], radius: float, length: float, axis: int, colour: Colour, sides: int = 28
) -> Solid:
    """Returns a cylinder along an axis (0, 1 or 2), with its ends."""
    turn = 2 * math.pi * np.arange(sides + 1) / sides
    ring = np.zeros((sides + 1, 3))
    ring[:, (axis + 1) % 3], ring[:, (axis + 2) % 3] = radius * np.cos(turn), radius * np.sin(turn)
    half = np.zeros(3)
    half[axis] = length / 2
    low, high = ring - half, ring + half
    triangles = []
    for i in range(sides):
        triangles += [(low[i], low[i + 1], high[i + 1]), (low[i], high[i + 1], high[i])]
        triangles += [(half, high[i], high[i + 1]), (-half, low[i + 1], low[i])]
    return Solid(np.array(triangles) + np.array(centre), colour)


def robot_solids(robot: RobotConfig, camera: CameraConfig) -> list[Solid]:
    """Returns the body, wheels, casters, camera and lidar of the robot, in base_link."""
    wide, radius, half = _HALF_WIDTH_M, robot.wheel_radius_m, robot.track_m / 2
    solids = [
        box((_REAR_M, -0.16, 0.06), (_FRONT_M, 0.16, 0.305), _DARK),
        box((_REAR_M, -wide, 0.305), (_FRONT_M, wide, 0.50), _LIGHT),
        box((_REAR_M + 0.02, -wide + 0.02, 0.50), (_FRONT_M - 0.02, wide - 0.02, _TOP_M), _BLACK),
        box((_REAR_M - 0.002, -wide - 0.002, 0.395), (_FRONT_M + 0.002, wide + 0.002, 0.42), _ACCENT),
        cylinder((-0.05, 0.0, _TOP_M + 0.04), 0.052, 0.08, 2, _DARK),
        cylinder((-0.05, 0.0, _TOP_M + 0.085), 0.055, 0.012, 2, _GREY),
        box(
            (camera.x_m - 0.03, camera.y_m - 0.05, camera.z_m - 0.018),
            (camera.x_m + 0.004, camera.y_m + 0.05, camera.z_m + 0.018),
            _BLACK,
        ),
    ]
    for side in (-1.0, 1.0):
        solids += [
            cylinder((0.0, side * half, radius), radius, 0.055, 1, _BLACK),
            cylinder((0.0, side * (half + 0.004), radius), 0.6 * radius, 0.055, 1, _GREY),
            cylinder((-0.472, side * 0.1323, 0.0755), 0.0755, 0.04, 1, _BLACK),
        ]
    return solids


def solid_scene(solids: list[Solid]) -> CompiledScene:
    """Returns a scene of solids without textures, shaded from above. Nothing else of the scene is meaningful."""
    corners = np.concatenate([solid.corners for solid in solids])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    shade = 0.62 + 0.38 * np.clip(normals @ _SUN, 0, 1)
    colours = np.concatenate([np.repeat(np.array([solid.colour]), len(solid.corners), axis=0) for solid in solids])
    vertices = corners.reshape(-1, 3).astype(np.float32)
    count, nothing = len(vertices), np.zeros((1, 1), np.uint8)
    low, high = ((float(x), float(y), float(z)) for x, y, z in (vertices.min(axis=0), vertices.max(axis=0)))
    return CompiledScene(
        info=SceneInfo(
            name="solids",
            source="solids",
            source_sha256="0" * 64,
            metres_per_unit=1.0,
            bounds_m=(low, high),
            grid_origin_m=(0.0, 0.0),
            targets=(),
            instances=(),
        ),
        positions=vertices,
        uvs=np.zeros((count, 2), np.float32),
        colours=np.repeat((colours * shade[:, None]).astype(np.uint8), 3, axis=0),
        light_uvs=np.zeros((0, 2), np.float32),
        light_map=np.zeros((0, 0, 3), np.uint8),
        part_first=np.zeros(1, np.int32),
        part_count=np.array([count], np.int32),
        part_instance=np.ones(1, np.uint16),
        part_texture=np.full(1, -1, np.int16),
        textures=(),
        collider_vertices=np.zeros((0, 3), np.float32),
        collider_triangles=np.zeros((0, 3), np.int32),
        occupancy=nothing,
        reachable=nothing,
        spawns=np.zeros((0, 2), np.float32),
        spawn_sees=np.zeros((0, 0), np.uint8),
    )


class OutsideView:
    """Pictures of an episode from a camera that follows the robot.

    Args:
        episode: bundle of the episode.
        scene: scene of the episode, for the walls behind the robot.
        renderer: renderer for the robot; it must stay open.
    """

    def __init__(self, episode: EpisodeBundle, scene: CompiledScene, renderer: Renderer) -> None:
        job = episode.meta.job
        self._episode, self._renderer = episode, renderer
        self._poses = [Pose.of(row) for row in episode.arrays.poses]
        self._yaws = _smooth_headings(self._poses, job.task.control_hz) - _ASIDE_RAD
        self._distances = _smooth(
            np.array([_room_behind(scene, p, y) for p, y in zip(self._poses, self._yaws, strict=True)]),
            job.task.control_hz,
        )
        renderer.load(solid_scene(robot_solids(job.robot, job.camera)), job.camera)

    def draw(self, t: int) -> Rgb:
        """Returns the view (height, width, 3) at step t."""
        robot, yaw, behind = self._poses[t], float(self._yaws[t]), float(self._distances[t])
        base = Pose.planar(robot.x, robot.y, yaw, robot.z)
        camera = _camera(behind)
        scene = self._episode.render_camera(base, camera)
        dx, dy, turn = base.x - robot.x, base.y - robot.y, yaw - robot.yaw
        cos, sin = math.cos(robot.yaw), math.sin(robot.yaw)
        body = self._renderer.render_camera(camera, Pose.planar(cos * dx + sin * dy, cos * dy - sin * dx, turn))
        is_body = (body.depth > 0) & ((scene.depth == 0) | (body.depth < scene.depth))
        shaded = scene.rgb * self._shadow(scene.depth, base, camera, robot)[..., None]
        picture = np.where(is_body[..., None], body.rgb, shaded).astype(np.uint8)
        return np.asarray(Image.fromarray(picture).resize(_OUTSIDE_PX, Image.Resampling.BOX))

    def _shadow(self, depth: NDArray[np.float32], base: Pose, camera: PinholeCamera, robot: Pose) -> Floats:
        """Returns the factor (height, width) of the light on the floor near the robot; 1 elsewhere."""
        optical, (fx, fy), (cx, cy) = mounted_pose(base, camera.mount), camera.focal_px, camera.centre_px
        rows, columns = np.indices(depth.shape)
        rays = np.stack(((columns + 0.5 - cx) / fx, (rows + 0.5 - cy) / fy, np.ones(depth.shape)), axis=-1)
        points = optical.eye + (rays * depth[..., None]) @ optical.rotation.T
        dx, dy = points[..., 0] - robot.x, points[..., 1] - robot.y
        cos, sin = math.cos(robot.yaw), math.sin(robot.yaw)
        along, across = cos * dx + sin * dy, np.abs(cos * dy - sin * dx)
        gap = np.hypot(
            np.maximum(0, np.maximum(_REAR_M - along, along - _FRONT_M)), np.maximum(0, across - _HALF_WIDTH_M)
        )
        is_floor = (depth > 0) & (np.abs(points[..., 2] - robot.z) < 0.03)
        return np.where(is_floor, 1 - 0.55 * np.exp(-((gap / _SHADOW_M) ** 2)), 1.0)


def draw_outside_film(
    episode: EpisodeBundle, scene: CompiledScene, renderer: Renderer, stride: int, instruction: str
) -> Iterator[Rgb]:
    """Yields pictures (360, 800, 3) of every `stride`-th frame and the last one: outside, camera image, instruction.

    Args:
        episode: bundle of the episode.
        scene: scene of the episode.
        renderer: renderer for the robot; it must stay open.
        stride: number of frames from one picture to the next.
        instruction: caption.
    """
    view, last = OutsideView(episode, scene, renderer), episode.length - 1
    goal, target = Goal.of_episode(episode.meta), episode.meta.target_instance_id
    for t in [*range(0, last, stride), last]:
        picture = Image.new("RGB", (_OUTSIDE_PX[0] + _CAMERA_PX, _OUTSIDE_PX[1] + _CAPTION_PX), "white")
        picture.paste(Image.fromarray(view.draw(t)), (0, 0))
        seen = _outlined(episode.rgb(t), episode.ids(t) == target)
        small = Image.fromarray(seen).resize((_CAMERA_PX, _CAMERA_PX), Image.Resampling.BOX)
        picture.paste(small, (_OUTSIDE_PX[0], 0))
        _write_caption(picture, instruction, goal.distance(*episode.arrays.poses[t, :2].tolist()))
        yield np.asarray(picture)


def _write_caption(picture: Image.Image, instruction: str, distance_m: float) -> None:
    """Writes the instruction, as large as it fits, and the distance to the target below the images."""
    pen, middle = ImageDraw.Draw(picture), _OUTSIDE_PX[1] + _CAPTION_PX // 2
    facts = f"{distance_m:.2f} m to the target"
    small = ImageFont.load_default(15)
    pen.text((picture.width - 10, middle), facts, fill=(90, 90, 90), font=small, anchor="rm")
    room = picture.width - 40 - pen.textlength(facts, font=small)
    size = next(
        size
        for size in range(20, 7, -1)
        if size == 8 or pen.textlength(instruction, font=ImageFont.load_default(size)) <= room
    )
    pen.text((10, middle), instruction, fill="black", font=ImageFont.load_default(size), anchor="lm")


def _outlined(rgb: Rgb, mask: NDArray[np.bool_]) -> Rgb:
    """Returns the image with a line around the mask."""
    edge = scipy.ndimage.binary_dilation(mask, iterations=4) & ~mask
    outlined = rgb.copy()
    outlined[edge] = _LINE
    return outlined


def _camera(behind_m: float) -> PinholeCamera:
    width, height = (_SAMPLES * side for side in _OUTSIDE_PX)
    share = behind_m / _BEHIND_M
    mount = Mount(x_m=-0.25 - behind_m, z_m=_ABOVE_M * (0.6 + 0.4 * share), pitch_deg=_DOWN_DEG + 14 * (1 - share))
    return PinholeCamera(name="outside", model="pinhole", width=width, height=height, fov_deg=_FOV_DEG, mount=mount)


def _smooth_headings(poses: list[Pose], hz: int) -> Floats:
    return _smooth(np.unwrap([pose.yaw for pose in poses]), hz)


def _smooth(values: Floats, hz: int) -> Floats:
    """Returns the mean over a window of `_SMOOTHING_S` on both sides; the ends are repeated."""
    reach = round(_SMOOTHING_S * hz)
    padded = np.pad(values, reach, mode="edge")
    return np.convolve(padded, np.full(2 * reach + 1, 1 / (2 * reach + 1)), mode="valid")


def _room_behind(scene: CompiledScene, pose: Pose, yaw: float) -> float:
    """Returns the distance behind the robot at which the camera is in front of walls, metres."""
    resolution, (x0, y0) = scene.info.grid_resolution_m, scene.info.grid_origin_m
    for distance in np.arange(_NEAREST_M, _BEHIND_M + 0.6, resolution / 2):
        column = int((pose.x - distance * math.cos(yaw) - x0) / resolution)
        row = int((pose.y - distance * math.sin(yaw) - y0) / resolution)
        is_inside = 0 <= row < scene.occupancy.shape[0] and 0 <= column < scene.occupancy.shape[1]
        if not is_inside or scene.occupancy[row, column] == 2:
            return float(np.clip(distance - 0.55, _NEAREST_M, _BEHIND_M))
    return _BEHIND_M

"""The simulated place: one robot on a floor among obstacles, in a physics client of its own.

Built afresh for every episode, because restoring a state is not bit-exact; it never draws, renders or decides.
"""

from __future__ import annotations

import functools
import math
import weakref
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Self

from schemas.config import RobotConfig
from schemas.scene import CompiledScene
from schemas.support.closing import Closing
from workers.geometry.pose import Pose
from workers.physics.bullet import BulletClient, ShapePlacement
from workers.physics.mesh_lists import MeshLists, mesh_lists, recycle
from workers.physics.robot import BASE_LINK, CASTERS, LEFT_WHEEL, RIGHT_WHEEL, robot_urdf

__all__ = ["CONTACT_DISTANCE_M", "LEVEL_TILT_RAD", "ColliderMesh", "Pose", "World"]

CONTACT_DISTANCE_M = 0.001
"""Largest gap in metres that counts as a contact."""
LEVEL_TILT_RAD = 1e-4
"""Lean below which base_link is said to stand level: a thirtieth of a pixel. The contact solver leaves a noise of about
1e-6 rad on a robot that drives steadily; from a level camera the rows of a floor and the columns of a wall have one
depth each, which noise would break. Braking leans it by 1e-2 rad, and stays."""

_FLOOR, _OBSTACLE, _ROLLER, _BODY = 1, 2, 4, 8
"""Collision groups: wheels and casters touch the floor only, the body meets floor and obstacles."""
_SETTLE_STEPS = 60
_TYRE_FRICTION = 1.5
"""The casters are frictionless, so that the tyres alone carry the side force of a bend: at 1.0 the robot spins round
(5.6 rad/s) when told 1.0 m/s and 1.5 rad/s, which is a token of the action grid; at 1.5 it turns with 1.51 rad/s."""


@dataclass(frozen=True)
class ColliderMesh:
    """What stands in a scene, in the form physics takes; prepared once a scene and shared by all its worlds."""

    pieces: tuple[MeshLists, ...]

    @classmethod
    def from_scene(cls, scene: CompiledScene) -> Self:
        """Prepares the obstacles of a compiled scene."""
        mesh = cls(mesh_lists(scene.collider_vertices, scene.collider_triangles))
        weakref.finalize(mesh, recycle, mesh.pieces)
        return mesh


class World(Closing):
    """A floor, obstacles and one robot that follows commanded twists; the same calls give the same bits."""

    def __init__(self, scene: CompiledScene, collider: ColliderMesh, robot: RobotConfig, control_hz: int) -> None:
        """Builds the world with the robot at the scene's origin.

        Args:
            scene: the place; gives the height of its floor.
            collider: `ColliderMesh.from_scene(scene)`, which the caller keeps from world to world.
            robot: measures, motor and solver settings.
            control_hz: how many `step` make a second.
        """
        self._hz = control_hz
        self._floor_height = scene.info.floor_height_m
        self._stance = _resting_stance(robot, control_hz)
        self._rig = _Rig(robot, control_hz, collider, self._floor_height)
        self.place(0.0, 0.0, 0.0)

    def close(self) -> None:
        """Frees the physics client; closing twice is harmless."""
        self._rig.client.close()

    def place(self, x: float, y: float, yaw: float) -> None:
        """Puts the robot at rest on the floor, its springs already settled, wherever that is.

        It never refuses: ask `deepest_penetration` whether something else is there.

        Args:
            x: of base_link in the world, metres.
            y: of base_link in the world, metres.
            yaw: heading in radians.
        """
        height = self._floor_height + self._stance.height_m
        self._rig.put(ShapePlacement((x, y, height), _heading_and_pitch(yaw, self._stance.pitch)))
        self._pose = self._previous = self._rig.pose().levelled(LEVEL_TILT_RAD)

    def command(self, v_mps: float, w_rps: float) -> None:
        """Sets the twist the wheels are to turn for from the next step on, without any slew limit."""
        self._rig.drive(v_mps, w_rps)

    def step(self) -> None:
        """Simulates one control period."""
        self._rig.client.step()
        self._previous, self._pose = self._pose, self._rig.pose().levelled(LEVEL_TILT_RAD)

    def pose(self) -> Pose:
        """Returns the pose of base_link in the world, exactly level where it leans by less than `LEVEL_TILT_RAD`."""
        return self._pose

    def speed(self) -> float:
        """Returns the planar speed of base_link over the last step: its displacement times `control_hz`, m/s.

        Taken from the poses, it is what really happened, and as deterministic as they are. Zero after `place`.
        """
        return math.hypot(self._pose.x - self._previous.x, self._pose.y - self._previous.y) * self._hz

    def has_obstacle_contact(self) -> bool:
        """Says whether the robot touches anything but the floor, to within `CONTACT_DISTANCE_M`."""
        return any(distance <= CONTACT_DISTANCE_M for distance in self._rig.obstacle_distances())

    def deepest_penetration(self) -> float:
        """Returns the deepest overlap of the robot with anything but the floor at its present pose, metres, >= 0.

        Moves nothing. Only surfaces count: a robot wholly inside a hollow body overlaps nothing.
        """
        self._rig.client.detect_collisions()
        return max(0.0, -min(self._rig.obstacle_distances(), default=0.0))


def _heading_and_pitch(yaw: float, pitch: float) -> tuple[float, float, float, float]:
    """Returns the quaternion (w, x, y, z) of a turn about z after a turn about y, radians."""
    cos_yaw, sin_yaw = math.cos(yaw / 2), math.sin(yaw / 2)
    cos_pitch, sin_pitch = math.cos(pitch / 2), math.sin(pitch / 2)
    return cos_yaw * cos_pitch, -sin_yaw * sin_pitch, cos_yaw * sin_pitch, sin_yaw * cos_pitch


class _Rig:
    """The bodies in one client, and their wiring."""

    def __init__(self, robot: RobotConfig, control_hz: int, collider: ColliderMesh, floor_height: float) -> None:
        self._robot = robot
        with ExitStack() as undo:
            self.client = undo.enter_context(BulletClient())
            self.client.set_engine(1.0 / control_hz, robot.physics_substeps, robot.solver_iterations)
            self._add_surroundings(collider, floor_height)
            self._add_robot()
            undo.pop_all()

    def _add_surroundings(self, collider: ColliderMesh, floor_height: float) -> None:
        self._floor = self.client.add_plane(floor_height)
        self.client.set_surface(self._floor, -1, friction=1.0)
        self.client.set_collision_group(self._floor, -1, _FLOOR, _ROLLER | _BODY)
        for piece in collider.pieces:
            obstacle = self.client.add_collider(piece)
            self.client.set_collision_group(obstacle, -1, _OBSTACLE, _BODY)

    def _add_robot(self) -> None:
        self._body = self.client.add_urdf(robot_urdf(self._robot))
        links = self.client.links(self._body)
        self._wheels = (links[LEFT_WHEEL], links[RIGHT_WHEEL])
        self._prepare_surfaces({BASE_LINK: -1, **links})
        self.drive(0.0, 0.0)

    def _prepare_surfaces(self, links: dict[str, int]) -> None:
        friction = {BASE_LINK: 0.3, LEFT_WHEEL: _TYRE_FRICTION, RIGHT_WHEEL: _TYRE_FRICTION} | dict.fromkeys(
            CASTERS, 0.0
        )
        for name, link in links.items():
            self.client.set_surface(self._body, link, friction[name])
            group, meets = (_BODY, _FLOOR | _OBSTACLE) if name == BASE_LINK else (_ROLLER, _FLOOR)
            self.client.set_collision_group(self._body, link, group, meets)

    def put(self, placement: ShapePlacement) -> None:
        self.client.place_base(self._body, placement)
        self.drive(0.0, 0.0)

    def drive(self, v_mps: float, w_rps: float) -> None:
        radius, half = self._robot.wheel_radius_m, w_rps * self._robot.track_m / 2
        speeds = ((v_mps - half) / radius, (v_mps + half) / radius)
        self.client.drive_joints(self._body, self._wheels, speeds, self._robot.motor_torque)

    def pose(self) -> Pose:
        position, orientation = self.client.base_placement(self._body)
        return Pose(*position, *orientation)

    def obstacle_distances(self) -> list[float]:
        return [contact.distance_m for contact in self.client.contacts(self._body) if contact.other != self._floor]


@dataclass(frozen=True)
class _Stance:
    """How base_link rests on a flat floor: wheels and casters sink in by a hair."""

    height_m: float
    pitch: float


@functools.cache
def _resting_stance(robot: RobotConfig, control_hz: int) -> _Stance:
    """Lets a robot settle on an empty floor, so that `place` need not step a world with obstacles in it."""
    rig = _Rig(robot, control_hz, ColliderMesh(()), 0.0)
    with rig.client:
        for _ in range(_SETTLE_STEPS):
            rig.client.step()
        pose = rig.pose()
    return _Stance(pose.z, 2 * math.atan2(pose.qy, pose.qw))

"""Simulated world: one robot on a floor with obstacles, in a separate physics client.

Every world has a new robot, because restoring a state is not bit-exact; floor and obstacles are reused. Does not
draw random numbers, render or control the robot.
"""

from __future__ import annotations

import functools
import math
import weakref
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Self

from schemas.config import RobotConfig
from schemas.scene import CompiledScene
from schemas.support.closing import Closing
from workers.geometry.pose import Pose
from workers.physics.bullet import BulletClient, ShapePlacement
from workers.physics.mesh_lists import MeshLists, mesh_lists, recycle
from workers.physics.robot import BASE_LINK, CASTERS, LEFT_WHEEL, RIGHT_WHEEL, robot_urdf

CONTACT_DISTANCE_M = 0.001
"""Largest distance between surfaces that counts as a contact, metres."""
LEVEL_TILT_RAD = 1e-4
"""Tilt below which the pose of base_link is reported as level, radians. This tilt moves the image by a thirtieth of a
pixel. The contact solver causes a tilt noise of about 1e-6 rad while the robot drives at constant speed. In the image
of a level camera, each row of a floor and each column of a wall has one depth, which that noise would change. The
tilt during braking is 1e-2 rad and is kept."""

_FLOOR, _OBSTACLE, _ROLLER, _BODY = 1, 2, 4, 8
"""Collision groups: wheels and casters collide with the floor only, the body with floor and obstacles."""
_SETTLE_STEPS = 60
_MOST_USES = 200
"""Number of worlds after which a physics client is closed, because the client keeps the shapes of removed robots."""
_EXACT_SUBSTEPS = (1, 2, 4, 8, 16)
"""Numbers of substeps after which the clock of a physics client is exactly 0 again; with other numbers, a rounding
error remains and affects the next world."""
_TYRE_FRICTION = 1.5
"""Sliding friction of the drive wheels. The casters are frictionless, so the tyres carry all of the lateral force in a
bend. With 1.0 the robot spins at 5.6 rad/s for the command 1.0 m/s and 1.5 rad/s, which is a point of the action grid;
with 1.5 it turns at 1.51 rad/s."""
# casters that swivel disturb the speed by 4 cm/s


@dataclass(frozen=True)
class ColliderMesh:
    """Obstacles of a scene in the format of the physics engine; prepared once and shared by all worlds of the scene."""

    pieces: tuple[MeshLists, ...]
    """Pieces within the limits of one collision shape."""
    idle: list[_Bodies] = field(default_factory=list, repr=False, compare=False)
    """At most one physics client with these obstacles that no world uses."""

    @classmethod
    def from_scene(cls, scene: CompiledScene) -> Self:
        mesh = cls(mesh_lists(scene.collider_vertices, scene.collider_triangles))
        weakref.finalize(mesh, _discard, mesh.pieces, mesh.idle)
        return mesh


def _discard(pieces: tuple[MeshLists, ...], idle: list[_Bodies]) -> None:
    for bodies in idle:
        bodies.client.close()
    recycle(pieces)


class World(Closing):
    """Simulation of a floor, obstacles and one robot that follows commanded twists; deterministic to the bit."""

    def __init__(self, scene: CompiledScene, collider: ColliderMesh, robot: RobotConfig, control_hz: int) -> None:
        """Builds the world with the robot at the scene's origin.

        Args:
            scene: compiled scene; only the height of its floor is used.
            collider: `ColliderMesh.from_scene(scene)`, which the caller reuses for all worlds of the scene.
            robot: dimensions, motor and solver settings.
            control_hz: control frequency, steps per second.
        """
        self._hz = control_hz
        self._floor_height = scene.info.floor_height_m
        self._stance = _resting_stance(robot, control_hz)
        self._bodies = _take_bodies(robot, control_hz, collider, self._floor_height)
        self._collider = collider
        self._is_open = True
        self.place(0.0, 0.0, 0.0)

    def close(self) -> None:
        """Frees the physics client, or keeps it for the next world of these obstacles; further calls have no effect."""
        if self._is_open:
            self._is_open = False
            _keep_bodies(self._bodies, self._collider)

    def place(self, x: float, y: float, yaw: float) -> None:
        """Places the robot at rest and settled on the floor.

        Does not check for obstacles; `deepest_penetration` returns the overlap with them.

        Args:
            x: x of base_link in the world, metres.
            y: y of base_link in the world, metres.
            yaw: heading, radians.
        """
        height = self._floor_height + self._stance.height_m
        self._bodies.put(ShapePlacement((x, y, height), _heading_and_pitch(yaw, self._stance.pitch)))
        self._pose = self._previous = self._bodies.pose().levelled(LEVEL_TILT_RAD)

    def command(self, v_mps: float, w_rps: float) -> None:
        """Sets the wheel speeds for a twist from the next step on, without slew limit.

        Args:
            v_mps: forward speed, m/s.
            w_rps: yaw rate, rad/s, counter-clockwise positive.
        """
        self._bodies.drive(v_mps, w_rps)

    def step(self) -> None:
        """Simulates one control period."""
        self._bodies.client.step()
        self._previous, self._pose = self._pose, self._bodies.pose().levelled(LEVEL_TILT_RAD)

    def pose(self) -> Pose:
        """Returns the pose of base_link in the world, exactly level if its tilt is less than `LEVEL_TILT_RAD`."""
        return self._pose

    def speed(self) -> float:
        """Returns the planar speed of base_link over the last step: displacement times `control_hz`, m/s.

        It is computed from the poses, so it is the measured speed and as deterministic as they are. Zero after `place`.
        """
        return math.hypot(self._pose.x - self._previous.x, self._pose.y - self._previous.y) * self._hz

    def has_obstacle_contact(self) -> bool:
        """Returns whether the robot is within `CONTACT_DISTANCE_M` of any body other than the floor."""
        return any(distance <= CONTACT_DISTANCE_M for distance in self._bodies.obstacle_distances())

    def deepest_penetration(self) -> float:
        """Returns the largest overlap of the robot with any body other than the floor at its pose, metres, >= 0.

        Simulates no step. Colliders are surfaces, so a robot completely inside a hollow body has no overlap.
        """
        self._bodies.client.detect_collisions()
        return max(0.0, -min(self._bodies.obstacle_distances(), default=0.0))


def _heading_and_pitch(yaw: float, pitch: float) -> tuple[float, float, float, float]:
    """Returns the quaternion (w, x, y, z) of a rotation about y by `pitch`, then about z by `yaw`, radians."""
    cos_yaw, sin_yaw = math.cos(yaw / 2), math.sin(yaw / 2)
    cos_pitch, sin_pitch = math.cos(pitch / 2), math.sin(pitch / 2)
    return cos_yaw * cos_pitch, -sin_yaw * sin_pitch, cos_yaw * sin_pitch, sin_yaw * cos_pitch


class _Bodies:
    """Bodies of a world in one physics client, with collision groups and motors."""

    def __init__(self, robot: RobotConfig, control_hz: int, collider: ColliderMesh, floor_height: float) -> None:
        self.key = (robot, control_hz, floor_height)
        self.uses = 1
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

    def renew(self) -> None:
        """Replaces the robot by a new one; the rest of the client has no state that affects it."""
        self.client.remove(self._body)
        self._add_robot()
        self.uses += 1

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


def _take_bodies(robot: RobotConfig, control_hz: int, collider: ColliderMesh, floor_height: float) -> _Bodies:
    """Returns the idle bodies of a collider with a new robot, or new bodies."""
    if collider.idle and collider.idle[0].key == (robot, control_hz, floor_height):
        bodies = collider.idle.pop()
        bodies.renew()
        return bodies
    return _Bodies(robot, control_hz, collider, floor_height)


def _keep_bodies(bodies: _Bodies, collider: ColliderMesh) -> None:
    """Keeps bodies for the next world; frees them if other bodies are already kept, or if they cannot be used again."""
    robot, _, _ = bodies.key
    if collider.idle or bodies.uses >= _MOST_USES or robot.physics_substeps not in _EXACT_SUBSTEPS:
        bodies.client.close()
    else:
        collider.idle.append(bodies)


@dataclass(frozen=True)
class _Stance:
    """Rest pose of base_link on a flat floor, into which wheels and casters sink slightly."""

    height_m: float
    """Height of base_link above the floor, metres."""
    pitch: float
    """Pitch of base_link, radians."""


@functools.cache
def _resting_stance(robot: RobotConfig, control_hz: int) -> _Stance:
    """Simulates a robot on an empty floor until it settles, so `place` needs no steps among obstacles."""
    bodies = _Bodies(robot, control_hz, ColliderMesh(()), 0.0)
    with bodies.client:
        for _ in range(_SETTLE_STEPS):
            bodies.client.step()
        pose = bodies.pose()
    return _Stance(pose.z, 2 * math.atan2(pose.qy, pose.qw))

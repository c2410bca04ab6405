"""Typed wrapper of PyBullet, with one private DIRECT client per object; the only module that imports PyBullet.

Quaternions of this interface are (w, x, y, z). Does not decide what is simulated; worlds and renderers do.
"""

from __future__ import annotations

import ctypes
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.errors import WorldError
from schemas.support.closing import Closing
from schemas.support.extras import require_package
from workers.physics.mesh_lists import MeshLists, as_lists, take_back

_UNLIT = {"shadow": 0, "lightAmbientCoeff": 1.0, "lightDiffuseCoeff": 0.0, "lightSpecularCoeff": 0.0}

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@contextmanager
def _silence() -> Iterator[None]:
    """Redirects stdout and stderr to the null device, because PyBullet's C code prints its build time."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [os.dup(1), os.dup(2)]
    try:
        with Path(os.devnull).open("wb") as nothing:
            os.dup2(nothing.fileno(), 1)
            os.dup2(nothing.fileno(), 2)
        yield
    finally:
        ctypes.CDLL(None).fflush(None)  # flushes the buffer of the C library while output is redirected
        for descriptor, copy in enumerate(kept, 1):
            os.dup2(copy, descriptor)
            os.close(copy)


def _import_pybullet() -> ModuleType:
    require_package("pybullet", "simulation")
    with _silence():
        import pybullet
    return pybullet  # type: ignore[no-any-return]


_p = _import_pybullet()


class Contact(NamedTuple):
    """Contact point of a body."""

    other: int
    """Id of the other body."""
    distance_m: float
    """Distance between the surfaces, metres; negative if they overlap."""


class ShapePlacement(NamedTuple):
    """Pose of a frame in the world."""

    position: Vector
    """x, y, z, metres."""
    orientation: Quaternion
    """Quaternion (w, x, y, z)."""


def bullet_version() -> str:
    return version("pybullet")


class BulletClient(Closing):
    """Physics server within this process; it owns its bodies, shapes and textures and frees them when it is closed."""

    def __init__(self) -> None:
        self._id: int = _p.connect(_p.DIRECT)
        if self._id < 0:
            raise WorldError("PyBullet returned no physics client; close worlds that are no longer used")
        self._inertial: dict[int, tuple[Vector, tuple[float, float, float, float]]] = {}

    def close(self) -> None:
        """Frees the client; further calls have no effect."""
        if self._id >= 0:
            _p.disconnect(physicsClientId=self._id)
            self._id = -1

    # Physics ---------------------------------------------------------------------------------------------------

    def set_engine(self, period_s: float, substeps: int, iterations: int) -> None:
        """Sets gravity, the period of one `step` in seconds, its substeps, and the iterations of the solver."""
        _p.setGravity(0, 0, -9.81, physicsClientId=self._id)
        _p.setPhysicsEngineParameter(
            fixedTimeStep=period_s,
            numSubSteps=substeps,
            numSolverIterations=iterations,
            deterministicOverlappingPairs=1,
            enableConeFriction=1,
            physicsClientId=self._id,
        )

    def add_plane(self, height_m: float) -> int:
        """Adds an infinite floor at a height in metres and returns its body id."""
        shape = _p.createCollisionShape(_p.GEOM_PLANE, physicsClientId=self._id)
        return self._add_static(height_m, collision=shape)

    def add_collider(self, mesh: MeshLists) -> int:
        """Adds a static concave mesh in world coordinates, metres, and returns its body id.

        Raises:
            WorldError: PyBullet rejects the mesh.
        """
        try:
            shape = _p.createCollisionShape(
                _p.GEOM_MESH,
                vertices=mesh.vertices,
                indices=mesh.indices,
                flags=_p.GEOM_FORCE_CONCAVE_TRIMESH,
                physicsClientId=self._id,
            )
        except _p.error as error:
            size = f"{len(mesh.vertices)} vertices, {len(mesh.indices) // 3} triangles"
            raise WorldError(f"PyBullet rejects a collider of {size}; rebuild the scene: {error}") from error
        return self._add_static(0.0, collision=shape)

    def add_urdf(self, urdf: str) -> int:
        """Adds the body of a URDF text, with its root link at the origin, and returns its body id."""
        with tempfile.NamedTemporaryFile("w", suffix=".urdf", encoding="utf-8") as file:
            file.write(urdf)
            file.flush()
            body: int = _p.loadURDF(file.name, flags=_p.URDF_USE_INERTIA_FROM_FILE, physicsClientId=self._id)
        info = _p.getDynamicsInfo(body, -1, physicsClientId=self._id)
        self._inertial[body] = (info[3], info[4])
        return body

    def remove(self, body: int) -> None:
        """Removes a body with its joints, motors and contacts."""
        _p.removeBody(body, physicsClientId=self._id)
        self._inertial.pop(body, None)

    def links(self, body: int) -> dict[str, int]:
        """Returns the index of every link by name, except the root link, whose index is -1."""
        count = _p.getNumJoints(body, physicsClientId=self._id)
        infos = (_p.getJointInfo(body, joint, physicsClientId=self._id) for joint in range(count))
        return {info[12].decode(): info[0] for info in infos}

    def set_surface(self, body: int, link: int, friction: float) -> None:
        """Sets the sliding friction of a link, and sets damping, restitution and rolling resistance to zero."""
        _p.changeDynamics(
            body,
            link,
            lateralFriction=friction,
            spinningFriction=0,
            rollingFriction=0,
            restitution=0,
            linearDamping=0,
            angularDamping=0,
            jointDamping=0,
            physicsClientId=self._id,
        )

    def set_collision_group(self, body: int, link: int, group: int, meets: int) -> None:
        """Assigns a link to a collision group; two links collide if each `meets` contains the other's group."""
        _p.setCollisionFilterGroupMask(body, link, group, meets, physicsClientId=self._id)

    def drive_joints(self, body: int, joints: Sequence[int], speeds_rps: Sequence[float], torque_nm: float) -> None:
        """Sets the target speeds of joints, rad/s, and the largest torque of their motors, N m."""
        _p.setJointMotorControlArray(
            body,
            joints,
            _p.VELOCITY_CONTROL,
            targetVelocities=speeds_rps,
            forces=[torque_nm] * len(joints),
            physicsClientId=self._id,
        )

    def place_base(self, body: int, placement: ShapePlacement) -> None:
        """Moves the root link frame of a URDF body to a pose, with zero velocity and all joints at zero."""
        w, x, y, z = placement.orientation
        position, rotation = _p.multiplyTransforms(placement.position, (x, y, z, w), *self._inertial[body])
        _p.resetBasePositionAndOrientation(body, position, rotation, physicsClientId=self._id)
        _p.resetBaseVelocity(body, (0, 0, 0), (0, 0, 0), physicsClientId=self._id)
        for joint in range(_p.getNumJoints(body, physicsClientId=self._id)):
            _p.resetJointState(body, joint, 0, 0, physicsClientId=self._id)

    def base_placement(self, body: int) -> ShapePlacement:
        """Returns the pose of the root link frame of a URDF body, not of its centre of mass."""
        centre = _p.getBasePositionAndOrientation(body, physicsClientId=self._id)
        position, (x, y, z, w) = _p.multiplyTransforms(*centre, *_p.invertTransform(*self._inertial[body]))
        return ShapePlacement(position, (w, x, y, z))

    def step(self) -> None:
        """Simulates one control period."""
        _p.stepSimulation(physicsClientId=self._id)

    def detect_collisions(self) -> None:
        """Computes the contacts of the current poses without a simulation step."""
        _p.performCollisionDetection(physicsClientId=self._id)

    def contacts(self, body: int) -> list[Contact]:
        """Returns the contacts of a body with all other bodies, at the last step or detection."""
        points = _p.getContactPoints(bodyA=body, physicsClientId=self._id)
        return [Contact(point[2], point[8]) for point in points]

    # TinyRenderer ----------------------------------------------------------------------------------------------

    def add_visual(self, positions: NDArray[np.float32], uvs: NDArray[np.float32], rgb: Vector) -> int:
        """Adds a visual body: at most `MESH_TRIANGLES` triangles of one colour that share no vertices.

        Args:
            positions: (3n, 3) corners, metres, counter-clockwise seen from outside.
            uvs: (3n, 2) texture coordinates.
            rgb: colour that multiplies the texture, 0 to 1.

        Returns:
            The body id, as in the camera image.
        """
        lists = [as_lists(each) for each in (positions, _corner_normals(positions), uvs)]
        indices = list(range(len(positions)))
        shape = _p.createVisualShape(
            _p.GEOM_MESH,
            vertices=lists[0],
            indices=indices,
            normals=lists[1],
            uvs=lists[2],
            rgbaColor=(*rgb, 1.0),
            physicsClientId=self._id,
        )
        indices.clear()
        for each in lists:
            take_back(each)
        return self._add_static(0.0, visual=shape)

    def load_texture(self, path: Path) -> int:
        """Loads an 8-bit PNG and returns its texture id; its first row is v = 1."""
        texture: int = _p.loadTexture(str(path), physicsClientId=self._id)
        return texture

    def set_texture(self, body: int, texture: int) -> None:
        _p.changeVisualShape(body, -1, textureUniqueId=texture, physicsClientId=self._id)

    def camera_image(
        self,
        width: int,
        height: int,
        view: NDArray[np.float64],
        projection: NDArray[np.float64],
        *,
        is_lit: bool = False,
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.int32]]:
        """Renders an image with the TinyRenderer.

        Args:
            width: width, pixels.
            height: height, pixels.
            view: (4, 4) OpenGL view matrix for column vectors.
            projection: (4, 4) OpenGL projection matrix for column vectors.
            is_lit: whether PyBullet's light and shadow are applied.

        Returns:
            Colour (height, width, 4); OpenGL window depth (height, width), from 0 at the near plane to 1 at the far
            plane; body of each pixel (height, width), -1 for none. Rows from the top.
        """
        _, _, rgba, depth, bodies = _p.getCameraImage(
            width,
            height,
            view.T.ravel().tolist(),
            projection.T.ravel().tolist(),
            **({} if is_lit else _UNLIT),
            renderer=_p.ER_TINY_RENDERER,
            physicsClientId=self._id,
        )
        return (
            np.asarray(rgba, np.uint8).reshape(height, width, 4),
            np.asarray(depth, np.float32).reshape(height, width),
            np.asarray(bodies, np.int32).reshape(height, width),
        )

    def _add_static(self, height_m: float, collision: int = -1, visual: int = -1) -> int:
        body: int = _p.createMultiBody(0, collision, visual, (0, 0, height_m), physicsClientId=self._id)
        return body


def _corner_normals(positions: NDArray[np.float32]) -> NDArray[np.float32]:
    corners = positions.reshape(-1, 3, 3)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return np.repeat(normals, 3, axis=0)
